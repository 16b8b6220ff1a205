"""Defaults of designed motions, for the functions and, without torch, for the command line."""

DURATION = 20.0
"""[s]"""
HARMONICS = 5
"""L of the report."""
RESTARTS = 8
"""Random starts of a design."""
USAGE = 0.7
"""Share of the limits that a first motion on a real arm uses."""
CLEARANCE = 0.02
"""Distance that is kept unless another is asked for [m]: links are drawn, and followed by their
controllers, to some millimetres."""
