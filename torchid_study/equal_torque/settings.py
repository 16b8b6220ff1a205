"""Defaults of the study of sets with equal torque, without torch for the command line."""

MARGIN = 1e-3
"""Smallest eigenvalue of the pseudo-inertias [kg m^2, kg] of a reference that has to be found. With
nearly none, all sets of its torque lie on the edge of feasibility."""
