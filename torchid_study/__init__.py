"""The studies of the report, and internal wrenches of parameter sets by reason and degree."""
