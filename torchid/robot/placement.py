"""Constant poses: DH rows, roll-pitch-yaw, quaternions, the rotation that takes z to an axis.

Right angles are kept exact: an entry within 1e-15 of -1, 0 or 1 is that number, so that cos(pi/2)
does not leave 6e-17 behind in every later product.
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor


def exact(matrix: Tensor) -> Tensor:
    """Entries within rounding of -1, 0, 1 made exactly that."""
    nearest = matrix.round().clamp(-1, 1)
    # 1e-15: rounding of a sine or cosine
    return torch.where((matrix - nearest).abs() < 1e-15, nearest, matrix)


def pose(rotation: Tensor | None = None, position: Sequence[float] | Tensor = (0, 0, 0)) -> Tensor:
    """(4, 4) pose from a rotation (3, 3) and a position (3)."""
    out = torch.eye(4, dtype=torch.float64)
    if rotation is not None:
        out[:3, :3] = exact(rotation)
    out[:3, 3] = torch.as_tensor(position, dtype=torch.float64)
    return out


def _rotation(axis: int, angle: float) -> Tensor:
    c = torch.cos(torch.tensor(angle, dtype=torch.float64))
    s = torch.sin(torch.tensor(angle, dtype=torch.float64))
    out = torch.eye(3, dtype=torch.float64)
    i, j = [k for k in range(3) if k != axis]
    sign = -1.0 if axis == 1 else 1.0
    out[i, i], out[j, j] = c, c
    out[i, j], out[j, i] = -sign * s, sign * s
    return exact(out)


def rotation_x(angle: float) -> Tensor:
    """Rotation about x by an angle [rad] (3, 3)."""
    return _rotation(0, angle)


def rotation_y(angle: float) -> Tensor:
    """Rotation about y by an angle [rad] (3, 3)."""
    return _rotation(1, angle)


def rotation_z(angle: float) -> Tensor:
    """Rotation about z by an angle [rad] (3, 3)."""
    return _rotation(2, angle)


def roll_pitch_yaw(rpy: Sequence[float]) -> Tensor:
    """Rz(yaw) Ry(pitch) Rx(roll), URDF's convention (3, 3)."""
    roll, pitch, yaw = (float(v) for v in rpy)
    return exact(rotation_z(yaw) @ rotation_y(pitch) @ rotation_x(roll))


def quaternion(wxyz: Sequence[float] | np.ndarray) -> Tensor:
    """Rotation (3, 3) of a unit quaternion (w, x, y, z); it is normalised first."""
    q = torch.as_tensor(wxyz, dtype=torch.float64)
    w, x, y, z = (q / q.norm()).tolist()
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return exact(torch.tensor(rows, dtype=torch.float64))


def align_z(axis: Sequence[float] | Tensor) -> Tensor:
    """A rotation Q (3, 3) with Q z = axis / |axis|; a signed permutation for a coordinate axis."""
    a = torch.as_tensor(axis, dtype=torch.float64)
    a = exact(a / a.norm())
    # The coordinate axis least along `a`, so that the cross product is well conditioned. The order
    # of preference makes +z give the identity.
    order = [0, 1, 2]
    k = min(order, key=lambda i: (round(abs(float(a[i])), 12), i))
    helper = torch.zeros(3, dtype=torch.float64)
    helper[k] = 1.0
    x = helper - (helper @ a) * a
    x = x / x.norm()
    y = torch.linalg.cross(a, x)
    return exact(torch.stack([x, y, a], dim=1))


def dh_classical(a: float, alpha: float, d: float, theta: float) -> Tensor:
    """Rz(theta) Tz(d) Tx(a) Rx(alpha): what follows joint i's motion about z_{i-1} (4, 4)."""
    return pose(rotation_z(theta), (0, 0, d)) @ pose(rotation_x(alpha), (a, 0, 0))


def dh_modified(a: float, alpha: float) -> Tensor:
    """Rx(alpha) Tx(a): what precedes joint i's motion about z_i (4, 4)."""
    return pose(rotation_x(alpha)) @ pose(None, (a, 0, 0))
