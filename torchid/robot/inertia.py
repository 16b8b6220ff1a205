"""Inertial parameters of links, and the one place that converts their orders and conventions.

torchid's order, per link and in the axes of the link frame, about the link frame's origin:

    pi = (m, m cx, m cy, m cz, Jxx, Jxy, Jxz, Jyy, Jyz, Jzz)

Others:
- the paper stacks all masses, then all first moments, then all inertias (eq. 2.3-2.5);
- Pinocchio keeps our per-link grouping but orders the inertia Ixx, Ixy, Iyy, Ixz, Iyz, Izz;
- URDF and MJCF give the inertia about the centre of mass, in axes of an `inertial` frame.
"""

from dataclasses import dataclass
from functools import cache

import torch
from torch import Tensor

from torchid.tensors import as_tensor
from torchid.typing import Float, Inertia6, Matrix3, Pi, Transforms, Vector3

PARAMETERS_PER_LINK = 10
_PINOCCHIO_FROM_OURS = (0, 1, 2, 3, 4, 5, 7, 6, 8, 9)


@dataclass(frozen=True)
class InertialParameters:
    """Inertial parameters of one robot, or of a batch of candidate robots.

    Attributes:
        pi: (..., n, 10) m [kg], m c [kg m] (3), J [kg m^2] (xx, xy, xz, yy, yz, zz), with the
            first moment and the inertia tensor about the origin of the link frame, in its axes.
            An array or lists may be given.

    >>> import torch
    >>> mass, com = torch.tensor([2.0]), torch.tensor([[0.5, 0.0, 0.0]])
    >>> body = InertialParameters.from_com(mass, com, torch.zeros(1, 6))
    >>> body.pi.tolist()  # 2 kg half a metre away: 0.5 kg m^2 about y and z
    [[2.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.5]]
    """

    pi: Pi

    def __post_init__(self) -> None:
        object.__setattr__(self, "pi", as_tensor(self.pi, "the inertial parameters"))

    @classmethod
    def from_com(cls, mass: Tensor, com: Tensor, inertia_about_com: Tensor) -> "InertialParameters":
        """From mass (..., n) [kg], centre of mass (..., n, 3) [m] and barycentric inertia
        (..., n, 6) [kg m^2], all in axes of the link frame; tensors, arrays or lists."""
        mass, com = as_tensor(mass, "mass"), as_tensor(com, "centres of mass")
        inertia_about_com = as_tensor(inertia_about_com, "inertias")
        inertia = inertia_about_com + parallel_axis(mass, com)
        return cls.from_link_frame(mass, com, inertia)

    @classmethod
    def from_link_frame(
        cls, mass: Tensor, com: Tensor, inertia_about_link_frame: Tensor
    ) -> "InertialParameters":
        """From mass (..., n), centre of mass (..., n, 3) and the inertia (..., n, 6) about the
        link frame's origin (the paper's J); tensors, arrays or lists."""
        mass, com = as_tensor(mass, "mass"), as_tensor(com, "centres of mass")
        inertia_about_link_frame = as_tensor(inertia_about_link_frame, "inertias")
        m = mass.unsqueeze(-1)
        return cls(torch.cat([m, m * com, inertia_about_link_frame], dim=-1))

    @classmethod
    def from_paper_order(cls, pi: Float[Tensor, "*batch P"]) -> "InertialParameters":
        """From the paper's stacking (..., 10 n): masses | first moments | inertias (eq. 2.5)."""
        n = pi.shape[-1] // PARAMETERS_PER_LINK
        stacks = pi.split([n, 3 * n, 6 * n], dim=-1)
        return cls(torch.cat([stack.unflatten(-1, (n, -1)) for stack in stacks], dim=-1))

    @classmethod
    def from_pinocchio_order(cls, pi: Pi) -> "InertialParameters":
        """From Pinocchio's `toDynamicParameters()` order (..., n, 10)."""
        inverse = [_PINOCCHIO_FROM_OURS.index(k) for k in range(PARAMETERS_PER_LINK)]
        return cls(pi[..., inverse])

    def to_paper_order(self) -> Float[Tensor, "*batch P"]:
        """The paper's stacking (..., 10 n): masses | first moments | inertias (eq. 2.5)."""
        return torch.cat(
            [self.pi[..., 0], self.pi[..., 1:4].flatten(-2), self.pi[..., 4:].flatten(-2)], dim=-1
        )

    def to_pinocchio_order(self) -> Pi:
        """Pinocchio's order (..., n, 10): m, mc, Ixx, Ixy, Iyy, Ixz, Iyz, Izz."""
        return self.pi[..., list(_PINOCCHIO_FROM_OURS)]

    @property
    def mass(self) -> Float[Tensor, "*batch"]:
        """Masses (..., n) [kg]."""
        return self.pi[..., 0]

    @property
    def first_moment(self) -> Vector3:
        """First moments m c (..., n, 3) [kg m]."""
        return self.pi[..., 1:4]

    @property
    def com(self) -> Vector3:
        """Centres of mass (..., n, 3) [m] in the link frame; 0 for a massless link."""
        m = self.pi[..., :1]
        safe = torch.where(m == 0, torch.ones_like(m), m)
        return torch.where(m == 0, torch.zeros_like(m), self.pi[..., 1:4] / safe)

    @property
    def inertia_about_link_frame(self) -> Inertia6:
        """Inertia tensors (..., n, 6) [kg m^2] about the link frame's origin (the paper's J)."""
        return self.pi[..., 4:]

    @property
    def inertia_about_com(self) -> Inertia6:
        """Barycentric inertia tensors (..., n, 6) [kg m^2], in axes of the link frame (I)."""
        return self.pi[..., 4:] - parallel_axis(self.mass, self.com)

    @property
    def pseudo_inertia(self) -> Transforms:
        """Pseudo-inertia matrices [[S, m c], [m c', m]] with S = tr(J)/2 E - J.

        Positive definite exactly when the link is physically consistent: positive mass, positive
        definite barycentric inertia that meets the triangle inequality (Wensing et al. 2018).
        """
        s = second_moment(self.pi[..., 4:])
        h = self.first_moment.unsqueeze(-1)
        top = torch.cat([s, h], dim=-1)
        bottom = torch.cat([h.transpose(-1, -2), self.mass[..., None, None]], dim=-1)
        return torch.cat([top, bottom], dim=-2)

    def consistency_margin(self) -> Float[Tensor, "*batch"]:
        """Smallest eigenvalue of each link's pseudo-inertia; negative means no body can have it."""
        return torch.linalg.eigvalsh(self.pseudo_inertia)[..., 0]

    def to(
        self, device: torch.device | str | None = None, dtype: torch.dtype | None = None
    ) -> "InertialParameters":
        """A copy on another device or of another dtype."""
        return InertialParameters(self.pi.to(device=device, dtype=dtype))


@cache
def pseudo_inertia_basis() -> Float[Tensor, "10 4 4"]:
    """Pseudo-inertias of the ten parameters, of which a body's is the sum; not to be changed."""
    return InertialParameters(torch.eye(PARAMETERS_PER_LINK, dtype=torch.float64)).pseudo_inertia


def symmetric(inertia: Inertia6) -> Matrix3:
    """Symmetric 3x3 matrices (..., 3, 3) from (xx, xy, xz, yy, yz, zz)."""
    xx, xy, xz, yy, yz, zz = inertia.unbind(-1)
    rows = [torch.stack(r, -1) for r in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))]
    return torch.stack(rows, -2)


def six(matrix: Matrix3) -> Inertia6:
    """(xx, xy, xz, yy, yz, zz) of symmetric matrices (..., 3, 3)."""
    rows, columns = (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)
    return matrix[..., rows, columns]


def second_moment(inertia: Inertia6) -> Matrix3:
    """S = tr(I)/2 E - I (..., 3, 3): the second moments of the mass about the same point [kg m^2].

    A body has them positive definite, which is the triangle inequality of its inertia tensor.
    """
    tensor = symmetric(inertia)
    half_trace = tensor.diagonal(dim1=-2, dim2=-1).sum(-1) / 2
    eye = torch.eye(3, dtype=tensor.dtype, device=tensor.device)
    return half_trace[..., None, None] * eye - tensor


def parallel_axis(mass: Float[Tensor, "*batch"], com: Vector3) -> Inertia6:
    """m (c'c E - c c'): what moving the reference point by c adds to a barycentric inertia."""
    x, y, z = com.unbind(-1)
    terms = [y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y]
    return mass.unsqueeze(-1) * torch.stack(terms, -1)


def move(
    parameters: Float[Tensor, "*#batch 10"], transform: Float[Tensor, "*#batch 4 4"]
) -> Float[Tensor, "*batch 10"]:
    """A body as it is seen from another frame.

    Args:
        parameters: (..., 10) in frame B.
        transform: (..., 4, 4) pose of frame B in frame A.

    Returns:
        (..., 10) in frame A: R h + m p for the first moment, and for the second-moment matrix
        S' = R S R' + R h p' + p h'R' + m p p', read back as an inertia tensor.
    """
    rotation, p = transform[..., :3, :3], transform[..., :3, 3]
    m = parameters[..., :1]
    second = second_moment(parameters[..., 4:])
    h = (rotation @ parameters[..., 1:4].unsqueeze(-1)).squeeze(-1)
    hp = h.unsqueeze(-1) * p.unsqueeze(-2)
    pp = p.unsqueeze(-1) * p.unsqueeze(-2)
    second = (
        rotation @ second @ rotation.transpose(-1, -2)
        + hp
        + hp.transpose(-1, -2)
        + m.unsqueeze(-1) * pp
    )
    trace = second.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    eye = torch.eye(3, dtype=second.dtype, device=second.device)
    # The mass alone has not been broadcast against a batch of transforms.
    mass = m.expand(*h.shape[:-1], 1)
    return torch.cat([mass, h + m * p, six(trace * eye - second)], dim=-1)


def parameter_names(n: int) -> list[str]:
    """Names of the 10 n parameters in the paper's order: m1.., m1c1x.., J1xx.. ."""
    axes, entries = "xyz", ("xx", "xy", "xz", "yy", "yz", "zz")
    links = range(1, n + 1)
    return (
        [f"m{i}" for i in links]
        + [f"m{i}c{i}{a}" for i in links for a in axes]
        + [f"J{i}{e}" for i in links for e in entries]
    )


def parameter_units(n: int) -> list[str]:
    """Units of the 10 n parameters in the paper's order."""
    return ["kg"] * n + ["kg m"] * (3 * n) + ["kg m^2"] * (6 * n)


def paper_order(n: int) -> Tensor:
    """Index that takes the flattened (n, 10) order to the paper's order (10 n,)."""
    flat = torch.arange(PARAMETERS_PER_LINK * n, dtype=torch.float64).reshape(n, -1)
    return InertialParameters(flat).to_paper_order().long()
