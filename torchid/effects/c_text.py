"""Words of the C statements that effects write.

A statement adds to `tau[j]` and reads `q`, `dq`, `ddq`, the torque `loaded` that effects of the
torque need, and `sign`. The export declares them, and puts its own names for the two below.
"""

RIGID = "RIGID"
"""Stands for the C function of the rigid body's torque: RIGID(q, dq, ddq, out)."""

JOINTS = "JOINTS"
"""Stands for the number of joints."""


def add(joint: int, expression: str) -> list[str]:
    """The statement that adds an expression to a joint's torque."""
    return [f"tau[{joint}] += {expression};"]
