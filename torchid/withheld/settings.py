"""Defaults of the check on one's own arm, for the function and, without torch, for the command."""

PLANTED = ("coulomb_friction", "load_dependent_friction", "cogging")
"""Effects that are planted: a step, one that scales with load, a periodic one."""
