"""The sets with one torque as an affine space, and the conditions of section 2.3 in it as linear
and matrix inequalities: see equal_torque."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.extraction.equal_torque.hit_and_run import Region
from torchid.feasibility.bounds import Bounds
from torchid.feasibility.conditions import Conditions
from torchid.feasibility.sets import ParameterSets
from torchid.identification.base_parameters import BaseParameters
from torchid.robot.inertia import InertialParameters
from torchid.typing import Float, Tensor


@dataclass(frozen=True, eq=False)
class Limits:
    """What each of K regions allows: with s = sign, s m in `mass`, c in `com`, and so on.

    Attributes:
        sign: (K, n) 1, or -1 for a link with a negative mass.
        mass: (K, n, 2) of sign * m [kg].
        com: (K, n, 3, 2) [m].
        radius: (K, n) of the cylinders and spheres, infinite for none [m].
        second: (K, n) smallest second moments about the CoM [kg m^2].
        total: (K, 2) of the sum of the masses [kg].
        firm: (K,) smallest degrees of masses and of second moments.
    """

    sign: Tensor
    mass: Tensor
    com: Tensor
    radius: Tensor
    second: Tensor
    total: Tensor
    firm: Tensor


@dataclass(frozen=True, eq=False)
class EqualTorqueSpace:
    """A reference, the directions that keep its torque, and the conditions' scales.

    Attributes:
        reference: one set.
        x: (P,) its rigid-body parameters in the paper's stacking.
        directions: (P, D) orthonormal.
        conditions, outer: as given.
        inertia: (n, 6) limits of |J|.
        scale: (n,) mean second moment of each link of the reference [kg m^2].
    """

    reference: ParameterSets
    x: Tensor
    directions: Tensor
    conditions: Conditions
    outer: Bounds
    inertia: Tensor
    scale: Tensor

    @property
    def n(self) -> int:
        """Number of links."""
        return self.scale.shape[0]

    @property
    def heaviest(self) -> Tensor:
        """Upper limits (n,) of the masses."""
        return self.outer.mass[:, 1]

    @property
    def mass_scale(self) -> Tensor:
        """Mean mass of the reference's links [kg]."""
        return self.x[: self.n].abs().mean()

    @property
    def widest(self) -> Tensor:
        """(n, 3, 2) the smallest box around the conditions' and the outer one."""
        box, outer = self.conditions.com_box, self.outer.com
        known = torch.isfinite(box)
        low = torch.where(known[..., 0], torch.minimum(box[..., 0], outer[..., 0]), outer[..., 0])
        high = torch.where(known[..., 1], torch.maximum(box[..., 1], outer[..., 1]), outer[..., 1])
        return torch.stack([low, high], -1)

    def limits(self, k: int) -> Limits:
        """What a feasible set must meet, k times."""
        box = self.conditions.com_box
        com = torch.where(torch.isfinite(box), box, self.outer.com)
        mass = torch.stack([self.outer.mass[:, 0].clamp(min=0.0), self.heaviest], -1)
        zeros = torch.zeros_like(self.scale)
        radius, total = self.conditions.round_radius, self.conditions.total_mass
        full = Limits(zeros + 1, mass, com, radius, zeros, total, self.x.new_zeros(()))
        return Limits(*(v.expand(k, *v.shape).clone() for v in vars(full).values()))

    def region(self, limits: Limits) -> Region:
        """The regions of the limits, in coordinates z of x = reference + directions z."""
        a, f = self._linear(self.directions.T.unsqueeze(1), limits)
        b, c = self._linear(self.x.unsqueeze(0), limits)
        row, block = self._constants(limits)
        a, f = (x.permute(1, 2, 0).contiguous() for x in (a, f))
        return Region(a, b + row, f, c + block)

    def _linear(self, x: Tensor, limits: Limits) -> tuple[Tensor, Tensor]:
        """Homogeneous parts (..., K, R) and (..., K, 16 L) for x (..., 1 or K, P)."""
        pi = InertialParameters.from_paper_order(x)
        sign = limits.sign.unsqueeze(-1)
        m, h = pi.mass.unsqueeze(-1) * sign, pi.first_moment * sign
        j = pi.inertia_about_link_frame.flatten(-2).expand(*h.shape[:-2], -1)
        total = pi.mass.sum(-1, keepdim=True).expand(*h.shape[:-2], 1)
        total = total * torch.isfinite(limits.total)
        m1 = m.squeeze(-1)
        rows = [
            torch.cat([m1 - limits.firm.unsqueeze(-1) * m1.mean(-1, keepdim=True), -m1], -1),
            (h - m * limits.com[..., 0]).flatten(-2),
            (m * limits.com[..., 1] - h).flatten(-2),
            torch.cat([j, -j], -1),
            total * total.new_tensor([1.0, -1.0]),
        ]
        # A negative link: S and -m on the diagonal, without the first moments.
        keep = torch.ones(*limits.sign.shape, 4, 4, dtype=x.dtype)
        keep[..., 3, 3] = limits.sign
        keep[..., :3, 3] = keep[..., 3, :3] = (limits.sign.unsqueeze(-1) + 1) / 2
        # S - firm tr(S)/3 E: positive definite only where the smallest second moment about the CoM
        # is at least that share of their mean, which is at most tr(S)/3.
        pseudo = pi.pseudo_inertia
        mean = pseudo[..., :3, :3].diagonal(dim1=-2, dim2=-1).mean(-1, keepdim=True)
        less = limits.firm[:, None, None] * mean
        pseudo = pseudo - torch.diag_embed(torch.cat([less, less, less, 0 * less], -1))
        blocks = [(pseudo * keep).flatten(-3)]
        if bool(torch.isfinite(limits.radius).any()):
            blocks.append(self._round(m, h, limits).flatten(-3))
        return torch.cat(rows, -1), torch.cat(blocks, -1)

    def _round(self, m: Tensor, h: Tensor, limits: Limits) -> Tensor:
        """[[m r E, v], [v', m r]] (..., K, n, 4, 4), zero for links without a shape."""
        known = torch.isfinite(limits.radius)
        away = (h - m * self.conditions.round_centre) * self.conditions.round_axes
        reach = m * torch.where(known, limits.radius, 0.0).unsqueeze(-1)
        arrow = torch.diag_embed(reach.expand(*reach.shape[:-1], 4))
        arrow[..., :3, 3] = arrow[..., 3, :3] = away * known.unsqueeze(-1)
        return arrow

    def _constants(self, limits: Limits) -> tuple[Tensor, Tensor]:
        """Constant parts (K, R) and (K, 16 L)."""
        k = limits.sign.shape[0]
        j = self.inertia.flatten().expand(k, -1)
        total = torch.where(
            torch.isfinite(limits.total), limits.total * limits.total.new_tensor([-1.0, 1.0]), 1.0
        )
        boxes = torch.zeros(k, 6 * self.n, dtype=self.x.dtype)
        rows = torch.cat([-limits.mass[..., 0], limits.mass[..., 1], boxes, j, j, total], -1)
        shift = torch.zeros(k, self.n, 4, dtype=self.x.dtype)
        shift[..., :3] = -limits.second.unsqueeze(-1)
        blocks = [torch.diag_embed(shift).flatten(1)]
        known = torch.isfinite(limits.radius)
        if bool(known.any()):
            free = (~known).to(self.x.dtype)
            blocks.append(torch.diag_embed(free.unsqueeze(-1).expand(-1, -1, 4)).flatten(1))
        return rows, torch.cat(blocks, -1)

    def sets(self, z: Float[Tensor, "K D"], ids: Sequence[str]) -> ParameterSets:
        """The sets at coordinates z."""
        x = self.x + z @ self.directions.T
        return ParameterSets(
            tuple(ids),
            InertialParameters.from_paper_order(x),
            self.reference.effects,
            self.reference.coefficients.expand(len(z), -1).clone(),
        )


def equal_torque_space(
    reference: ParameterSets, base: BaseParameters, conditions: Conditions, outer: Bounds
) -> EqualTorqueSpace:
    """The space of a reference (K = 1), whose effects are those of the base parameters."""
    rigid = base.n_rigid_parameters
    own = reference.parameters
    scale = own.inertia_about_com[0].abs()[:, [0, 3, 5]].sum(-1) / 6
    return EqualTorqueSpace(
        reference,
        own.to_paper_order()[0],
        # Effects' coefficients stay: only changes of the rigid body's own parameters.
        kernel(base.grouping[:, :rigid]),
        conditions,
        outer,
        outer.inertia.abs().amax(-1),
        scale,
    )


def kernel(matrix: Tensor) -> Tensor:
    """Orthonormal basis of {x : matrix x = 0}, as columns."""
    _, singular, right = torch.linalg.svd(matrix)
    rank = int((singular > 1e-9 * singular[0]).sum())
    return right[rank:].T.contiguous()
