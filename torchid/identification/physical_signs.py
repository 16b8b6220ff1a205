"""Which sums of parameters have a sign, whatever the bodies.

A body's mass, first moment h and second moment Sigma = tr(J)/2 E - J make up its pseudo-inertia
[[Sigma, h], [h', m]], which is positive semidefinite for every body, and can be any such matrix
(P. Wensing, S. Kim, J.-J. Slotine, IEEE RA-L 3(1), 2018). A sum a m + b'h + sum c_ij J_ij is
therefore never negative if, and only if, the matrix D of the same sum, <D, pseudo-inertia>, is
positive semidefinite as well: the cone is its own dual. E.g. J1zz + J2yy + Ia1 is never negative,
and J2xx - J2yy - J2zz, minus twice the second moment along x, never positive.
"""

import torch

from torchid.effects.base import Effect
from torchid.identification.base_parameters import BaseParameters, visible
from torchid.robot.inertia import InertialParameters, symmetric
from torchid.typing import Float, Int, Tensor

_ROUNDING = 1e-6


def physical_signs(base: BaseParameters, effects: tuple[Effect, ...]) -> Int[Tensor, " B"]:
    """(B,) 1 for base parameters that are never negative, -1 for those that are never positive, 0
    where bodies with either sign exist. Entries of the grouping that its names do not show do not
    count.

    >>> from torchid import load_robot
    >>> from torchid.identification.base_parameters import base_parameters
    >>> base = base_parameters(load_robot("3r"))
    >>> int(physical_signs(base, ())[base.names.index("J3zz")])
    1
    """
    rows = torch.where(visible(base.grouping), base.grouping, 0.0)
    bounded = torch.tensor([c.non_negative for e in effects for c in e.coefficients]).bool()
    never_negative, never_positive = (_dual(s * rows, base, bounded) for s in (1, -1))
    return never_negative.int() - never_positive.int()


def _dual(rows: Float[Tensor, "B P"], base: BaseParameters, bounded: Tensor) -> Tensor:
    """(B,) whether a sum is non-negative for all bodies and coefficients."""
    rigid, rest = rows.split([base.n_rigid_parameters, rows.shape[1] - base.n_rigid_parameters], 1)
    a, b, c = InertialParameters.from_paper_order(rigid).pi.split([1, 3, 6], -1)
    # J_xx = Sigma_yy + Sigma_zz and J_xy = -Sigma_xy, the latter twice in <D, pseudo-inertia>.
    j = symmetric(c * c.new_tensor([1, 0.5, 0.5, 1, 0.5, 1]))
    trace = j.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    second = trace * torch.eye(3).to(j) - j
    upper = torch.cat([second, b.unsqueeze(-1) / 2], -1)
    lower = torch.cat([b / 2, a], -1).unsqueeze(-2)
    least = torch.linalg.eigvalsh(torch.cat([upper, lower], -2))[..., 0].amin(-1)
    coefficients = torch.where(bounded, rest >= 0, rest == 0).all(-1)
    return (least >= -_ROUNDING * rows.abs().amax(-1)) & coefficients
