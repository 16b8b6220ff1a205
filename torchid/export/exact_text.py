"""Numbers as text that reads back as the same float64; poses and inertias as XML has them."""

from collections.abc import Iterable

import torch
from torch import Tensor

from torchid.digits import number
from torchid.robot.inertia import InertialParameters, symmetric
from torchid.robot.placement import exact
from torchid.typing import Float


def text(values: Iterable[float] | Tensor) -> str:
    """Numbers separated by blanks, each with the digits that give the same float64."""
    return " ".join(number(v) for v in values)


def roll_pitch_yaw_of(rotation: Float[Tensor, "3 3"]) -> list[float]:
    """Angles with Rz(yaw) Ry(pitch) Rx(roll) = rotation [rad].

    Roll and pitch are read off Rz(-yaw) rotation, so that near pitch = 90 deg, where yaw is
    arbitrary, the product is still exact to rounding.
    """
    r = rotation.double()
    yaw = torch.atan2(r[1, 0], r[0, 0])
    c, s = torch.cos(yaw), torch.sin(yaw)
    x, y = c * r[0] + s * r[1], c * r[1] - s * r[0]
    return [float(torch.atan2(-y[2], y[1])), float(torch.atan2(-r[2, 0], x[0])), float(yaw)]


def quaternion_of(rotation: Float[Tensor, "3 3"]) -> Float[Tensor, "4"]:
    """Unit quaternion (w, x, y, z), w >= 0, from its largest component (Shepperd 1978)."""
    r = rotation.double()
    trace = r.trace()
    largest = int(torch.stack([trace, *r.diagonal()]).argmax())
    if largest == 0:
        own = [1 + trace, r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]
    else:
        i = largest - 1
        j, k = (i + 1) % 3, (i + 2) % 3
        own = [r[k, j] - r[j, k]] + [r[i, a] + r[a, i] for a in range(3)]
        own[1 + i] = 1 + r[i, i] - r[j, j] - r[k, k]
    q = torch.stack(own)
    q = q / q.norm()
    return exact(-q if q[0] < 0 else q)


def principal(
    parameters: InertialParameters, link: int
) -> tuple[Float[Tensor, "3"], Float[Tensor, "4"]]:
    """Principal moments (3,) of a link about its centre of mass [kg m^2], and the quaternion of
    their axes in the link frame; the link's own axes where these are principal."""
    tensor = symmetric(parameters.inertia_about_com[link])
    if not (tensor - torch.diag(tensor.diagonal())).any():
        return tensor.diagonal(), torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    values, axes = torch.linalg.eigh(tensor)
    axes[:, 2] *= torch.linalg.det(axes).sign()
    return values, quaternion_of(axes)
