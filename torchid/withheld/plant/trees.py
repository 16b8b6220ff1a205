"""Robots of our own making that branch, their base held in the air: a quadruped, two arms with
grippers, and the upper body of a humanoid.

Their motors are as people have them: quasi-direct drives with a rotor that is felt through a small
gear, friction, less torque at speed, and commands that come late over a bus. Rotors and friction
are in the maker's data; what a case plants comes on top.
"""

from torchid.errors import TorchidError
from torchid.withheld.plant.arms import ARMS, Arm, Joint, Solid, Triple
from torchid.withheld.plant.bodies import Box, Cylinder

BUS = 0.002
"""How late a command reaches a motor over the bus [s]: two cycles of 1 kHz."""

_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_LEVEL = (0.0, 0.0, 0.0)


def _driven(
    parent: int,
    xyz: Triple,
    axis: Triple,
    reach: tuple[float, float],
    motor: tuple[float, float, float, float],
    *solids: Solid,
) -> Joint:
    """A joint of a link, its range [rad], and its motor: velocity limit and speed without torque
    [rad/s], effort [N m], rotor [kg m^2]."""
    velocity, free, effort, rotor = motor
    return Joint(xyz, _LEVEL, axis, *reach, velocity, effort, solids, parent, rotor, free)


_LEG_MOTOR = (9.0, 24.0, 30.0, 0.012)


def _leg(first: int, x: float, side: float) -> tuple[Joint, ...]:
    """A leg of hip, thigh and shank; `side` 1 on the left, -1 on the right."""
    hip = _driven(
        -1, (x, 0.05 * side, 0.0), _X, (-0.8, 0.8), _LEG_MOTOR,
        Cylinder(1900.0, 0.045, 0.07, (0.0, 0.02 * side, 0.0), "y"),
        Box(900.0, (0.06, 0.05, 0.08), (-0.01, 0.045 * side, 0.005)),
    )  # fmt: skip
    thigh = _driven(
        first, (0.0, 0.085 * side, 0.0), _Y, (-1.4, 1.4), _LEG_MOTOR,
        Cylinder(1900.0, 0.045, 0.07, (0.0, -0.02 * side, 0.0), "y"),
        Box(1100.0, (0.045, 0.035, 0.21), (0.004, 0.0, -0.1)),
    )  # fmt: skip
    shank = _driven(
        first + 1, (0.0, 0.0, -0.21), _Y, (-2.5, -0.4), (11.0, 28.0, 30.0, 0.014),
        Cylinder(1500.0, 0.012, 0.2, (0.006, 0.0, -0.1)),
        Box(1100.0, (0.04, 0.035, 0.035), (0.0, 0.0, -0.205)),
    )  # fmt: skip
    return hip, thigh, shank


_QUADRUPED = Arm(
    "quadruped",
    (*_leg(0, 0.19, 1.0), *_leg(3, 0.19, -1.0), *_leg(6, -0.19, 1.0), *_leg(9, -0.19, -1.0)),
    (0.0, 0.0, -0.22),
    BUS,
)


def _limb(
    parent: int, first: int, shoulder: Triple, side: float, jaw: bool, size: float = 1.0
) -> tuple[Joint, ...]:
    """An arm of seven joints that hangs from a shoulder, with the jaw of a gripper or without."""
    strong, middle, weak = (5.0, 16.0, 60.0, 0.08), (6.0, 18.0, 30.0, 0.04), (7.0, 20.0, 12.0, 0.01)

    def hub(radius: float, length: float, axis: str, at: Triple) -> Cylinder:
        return Cylinder(1800.0, radius, length, at, axis)

    joints = [
        _driven(
            parent, shoulder, _Y, (-2.0, 1.4), strong,
            hub(0.05, 0.09, "y", (0.0, 0.03 * side, 0.0)),
            Box(1000.0, (0.07, 0.06, 0.07), (0.0, 0.07 * side, -0.01)),
        ),
        _driven(
            first, (0.0, 0.08 * side, 0.0), _X, (-1.2, 1.2), strong,
            hub(0.045, 0.09, "x", (0.01, 0.0, 0.0)),
            Box(1000.0, (0.06, 0.07, 0.1), (0.0, 0.01 * side, -0.05)),
        ),
        _driven(
            first + 1, (0.0, 0.0, -0.12), _Z, (-1.6, 1.6), middle,
            Cylinder(1300.0, 0.04, 0.16 * size, (0.0, 0.0, -0.06)),
            Box(1100.0, (0.06, 0.05, 0.05), (0.01, 0.0, -0.14)),
        ),
        _driven(
            first + 2, (0.0, 0.0, -0.16 * size), _Y, (-2.0, 0.3), middle,
            hub(0.04, 0.08, "y", (0.0, 0.01 * side, 0.0)),
            Box(1000.0, (0.05, 0.05, 0.1), (0.005, 0.0, -0.05)),
        ),
        _driven(
            first + 3, (0.0, 0.0, -0.11 * size), _Z, (-1.6, 1.6), weak,
            Cylinder(1300.0, 0.032, 0.14 * size, (0.0, 0.0, -0.05)),
            Box(1100.0, (0.05, 0.04, 0.04), (-0.008, 0.0, -0.12)),
        ),
        _driven(
            first + 4, (0.0, 0.0, -0.14 * size), _Y, (-1.1, 1.1), weak,
            hub(0.03, 0.06, "y", (0.0, 0.0, 0.0)),
            Box(1000.0, (0.04, 0.04, 0.05), (0.0, 0.006 * side, -0.02)),
        ),
        _driven(
            first + 5, (0.0, 0.0, -0.06), _X, (-1.1, 1.1), weak,
            hub(0.028, 0.05, "x", (0.0, 0.0, -0.01)),
            Box(1200.0, (0.06, 0.08, 0.09), (0.01, 0.0, -0.06)),
        ),
    ]  # fmt: skip
    if jaw:
        joints.append(
            _driven(
                first + 6, (0.02, 0.025 * side, -0.11), _X, (-0.5, 0.9), (6.0, 18.0, 4.0, 0.004),
                Box(1500.0, (0.03, 0.02, 0.08), (0.0, 0.004 * side, -0.04)),
            )
        )  # fmt: skip
    return tuple(joints)


_TWO_ARMS = Arm(
    "two_arms",
    (
        *_limb(-1, 0, (0.0, 0.2, 0.5), 1.0, jaw=True),
        *_limb(-1, 8, (0.0, -0.2, 0.5), -1.0, jaw=True),
    ),
    (0.0, 0.0, -0.08),
    BUS,
)

_TORSO = Arm(
    "torso",
    (
        _driven(
            -1, (0.0, 0.0, 0.1), _Z, (-1.2, 1.2), (4.0, 12.0, 90.0, 0.15),
            Box(700.0, (0.2, 0.32, 0.4), (-0.01, 0.0, 0.22)),
        ),
        _driven(
            0, (0.0, 0.0, 0.44), _Z, (-1.2, 1.2), (5.0, 16.0, 10.0, 0.01),
            Cylinder(1500.0, 0.03, 0.07, (0.004, 0.0, 0.03)),
        ),
        _driven(
            1, (0.0, 0.0, 0.07), _Y, (-0.7, 0.7), (5.0, 16.0, 10.0, 0.01),
            Box(700.0, (0.15, 0.13, 0.16), (0.03, 0.0, 0.08)),
        ),
        *_limb(0, 3, (0.0, 0.2, 0.36), 1.0, jaw=False, size=1.1),
        *_limb(0, 10, (0.0, -0.2, 0.36), -1.0, jaw=False, size=1.1),
    ),
    (0.0, 0.0, -0.1),
    BUS,
)  # fmt: skip

TREES: dict[str, Arm] = {arm.name: arm for arm in (_QUADRUPED, _TWO_ARMS, _TORSO)}

ROBOTS = {"arms": tuple(ARMS), "tree": tuple(TREES)} | {name: (name,) for name in TREES}
"""What a set's robots are, by what is asked for: arms, robots that branch, or one of these."""


def arm_named(name: str) -> Arm:
    """One of the arms, or of the robots that branch.

    Raises:
        TorchidError: there is none of that name.
    """
    known = ARMS | TREES
    if name not in known:
        raise TorchidError(f"unknown withheld robot '{name}'.", available=list(known))
    return known[name]
