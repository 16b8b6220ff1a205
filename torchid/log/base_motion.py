"""The measured motion of a robot's base, as the six coordinates that come before its joints' (see
`torchid.robot.floating`).

    base_x, base_y, base_z                position of the base link's origin in the world [m]
    base_qx, base_qy, base_qz, base_qw    its orientation: a quaternion from base to world axes
    base_vx, base_vy, base_vz             velocity of that origin in axes of the world [m/s]
    base_wx, base_wy, base_wz             angular velocity in axes of the base, as its gyroscope
                                          has it [rad/s]

The pose is needed; velocities count where the log has the joints', too. Accelerations come of
them as those of the joints do: what differs between the two would be taken for a torque. World and
gravity go together: z is up.
"""

from collections.abc import Iterable, Mapping
from itertools import pairwise

import numpy as np

from torchid.errors import LogError

POSITION = tuple(f"base_{a}" for a in "xyz")
QUATERNION = tuple(f"base_q{a}" for a in "xyzw")
TWIST = (*(f"base_v{a}" for a in "xyz"), *(f"base_w{a}" for a in "xyz"))
NAMES = (*POSITION, *QUATERNION, *TWIST)
"""Columns of the base's motion."""

COORDINATES = 6

STEEPEST = 1.4
"""Pitch beyond which yaw and roll are not told apart well enough [rad]: 80 degrees. There the
rates of the two are six times the base's own."""


def has_base(names: Iterable[str], label: str) -> bool:
    """Whether columns hold the base's pose.

    Raises:
        LogError: they hold a part of it.
    """
    pose = (*POSITION, *QUATERNION)
    there = [name for name in pose if name in set(names)]
    if there and len(there) < len(pose):
        raise LogError(
            f"{label} has a part of the base's pose only.",
            got=", ".join(there),
            expected=", ".join(pose),
        )
    return bool(there)


def coordinates_of(position: np.ndarray, quaternion: np.ndarray, label: str) -> np.ndarray:
    """The six coordinates of poses of the base.

    Args:
        position: (T, 3) of its origin in the world [m].
        quaternion: (T, 4) x, y, z, w, from base axes to the world's; a length of 1.
        label: of the log, for the messages.

    Returns:
        (T, 6): x, y, z [m], yaw, pitch, roll [rad]; angles without jumps by whole turns.

    Raises:
        LogError: a quaternion of another length, or a pitch steeper than `STEEPEST`.
    """
    length = np.linalg.norm(quaternion, axis=1, keepdims=True)
    wrong = ~(np.abs(length[:, 0] - 1) < 0.05)  # rounding and filters change it by less
    if wrong.any():
        row = int(wrong.argmax())
        raise LogError(
            f"{label}: the base's orientation is no unit quaternion.",
            got=f"length {float(length[row, 0]):.3g} in row {row + 1}",
            expected="base_qx, base_qy, base_qz, base_qw with a length of 1",
        )
    x, y, z, w = (quaternion / length).T
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    steep = np.abs(pitch) > STEEPEST
    if steep.any():
        raise LogError(
            f"{label}: the base pitches too far for yaw, pitch and roll.",
            got=f"{float(np.abs(pitch).max()):.3g} rad at most, first in row "
            f"{int(steep.argmax()) + 1}",
            expected=f"at most {STEEPEST:g} rad",
            hint="leave that stretch out",
        )
    yaw = np.unwrap(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    roll = np.unwrap(np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)))
    return np.column_stack([position, yaw, pitch, roll])


def rates_of(coordinates: np.ndarray, linear: np.ndarray, angular: np.ndarray) -> np.ndarray:
    """Rates (T, 6) of the coordinates [m/s, rad/s] from a measured twist of the base.

    Args:
        coordinates: (T, 6), from `coordinates_of`.
        linear: (T, 3) velocity of the base's origin in axes of the world [m/s].
        angular: (T, 3) velocity in axes of the base [rad/s].
    """
    pitch, roll = coordinates[:, 4], coordinates[:, 5]
    yaw = (np.sin(roll) * angular[:, 1] + np.cos(roll) * angular[:, 2]) / np.cos(pitch)
    up = np.cos(roll) * angular[:, 1] - np.sin(roll) * angular[:, 2]
    about = angular[:, 0] + np.sin(pitch) * yaw
    return np.column_stack([linear, yaw, up, about])


def base_signals(
    columns: Mapping[str, np.ndarray], starts: np.ndarray, label: str
) -> dict[str, np.ndarray | None]:
    """Positions and rates (T, 6) of the base's coordinates; rates None where no twist is there.

    Args:
        columns: those of `NAMES` that the log has, (T,) each.
        starts: rows at which trajectories begin.
        label: of the log, for the messages.
    """
    position = np.column_stack([columns[name] for name in POSITION])
    quaternion = np.column_stack([columns[name] for name in QUATERNION])
    bounds = [*starts.tolist(), len(position)]
    # Angles go on without jumps within a trajectory, and start anew with the next.
    parts = [coordinates_of(position[a:b], quaternion[a:b], label) for a, b in pairwise(bounds)]
    q = np.concatenate(parts)
    if not all(name in columns for name in TWIST):
        return {"q": q, "dq": None}
    twist = np.column_stack([columns[name] for name in TWIST])
    return {"q": q, "dq": rates_of(q, twist[:, :3], twist[:, 3:])}
