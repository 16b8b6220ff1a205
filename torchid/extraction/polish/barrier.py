"""Logarithmic barrier of bounds and conditions in x = (m, m c, J) per link, and coefficients.

Layout of x: the ten parameters of link 1 in torchid's order, those of link 2, ..., coefficients.
All values and derivatives are for R points in one batch.
"""

from typing import NamedTuple

import torch

from torchid.extraction.polish.region import Region
from torchid.extraction.problem import Problem
from torchid.robot.inertia import InertialParameters, pseudo_inertia_basis, second_moment
from torchid.typing import Float, Tensor

_STARTS = (0.0, 0.01, 0.03, 0.1, 0.3, 0.6, 0.9, 0.99, 1.0)
"""Shares of the way to the interior point; the last is that point, which is always inside."""
_EDGE = 1e-7
"""Share of a span, or of a link's second moments, that a start keeps from the boundary."""


class _Slacks(NamedTuple):
    """Slacks that are numbers; pairs are those of the lower and of the upper bound.

    Attributes:
        linear: (R, n, 8) of masses and centres of mass.
        inertia: (R, n, 6) twice, of the barycentric inertias.
        rest: (R, E) twice, of the coefficients.
        total: (R, 2) of the total mass, or None where it is not asked for.
        round: (R, L) of the links with a cylinder or a sphere, or None.
    """

    linear: Tensor
    inertia: tuple[Tensor, Tensor]
    rest: tuple[Tensor, Tensor]
    total: Tensor | None
    round: Tensor | None

    def all(self) -> list[Tensor]:
        """Every slack there is."""
        every = [self.linear, *self.inertia, *self.rest, self.total, self.round]
        return [slack for slack in every if slack is not None]


class Barrier:
    """Minus the sum of logarithms of all slacks.

    Attributes:
        count: number of slacks, counting an m x m matrix as m.
        weight: (R, P) of the loss, columns in the layout of x.
    """

    def __init__(self, problem: Problem, region: Region):
        n = problem.n
        self._problem, self._region, self._n = problem, region, n
        box = region.box
        self._inertia = box[4 * n : 10 * n].reshape(n, 6, 2)
        self._rest = box[10 * n :]
        self._linear, self._constant = _linear_slacks(box, n)
        # The pseudo-inertia is a sum over a link's ten parameters of these matrices.
        self._basis = pseudo_inertia_basis()
        self._round = region.round_links & torch.tensor(region.physical)
        # r^2 m^2 - |A (m c - m c0)|^2 of the links with a cylinder or a sphere, in (m, m c).
        c, forms = problem.conditions, []
        for i in self._round.nonzero().flatten().tolist():
            a = torch.cat([-c.round_centre[i].unsqueeze(-1), torch.eye(3, dtype=torch.float64)], -1)
            a = a * c.round_axes[i].unsqueeze(-1)
            form = -a.T @ a
            form[0, 0] += c.round_radius[i] ** 2
            forms.append(form)
        self._forms = torch.stack(forms) if forms else None
        self._total = region.physical and bool(torch.isfinite(region.total_mass).all())
        self.weight = problem.target.matrix_by_link
        physical = 4 * n + 2 * int(self._round.sum()) + 2 * self._total if region.physical else 0
        self.count = 2 * len(box) + physical

    def point(self, p: Float[Tensor, "R D"]) -> Float[Tensor, "R P"]:
        """x of search vectors."""
        rigid = self._problem.parameters(p).pi.flatten(-2)
        return torch.cat([rigid, self._problem.split(p)[3]], -1)

    def search_vector(self, x: Float[Tensor, "R P"]) -> Float[Tensor, "R D"]:
        """Search vectors of x, inside the region's box whatever the rounding."""
        own = InertialParameters(self._links(x))
        parts = [own.mass, own.com.flatten(-2), own.inertia_about_com.flatten(-2)]
        p = torch.cat([*parts, x[:, 10 * self._n :]], -1)
        return torch.clamp(p, self._region.box[:, 0].to(p), self._region.box[:, 1].to(p))

    def entered(self, p: Float[Tensor, "R D"], inward: float = 0.0) -> Float[Tensor, "R P"]:
        """x after moving p towards the interior point until all slacks are positive, and then by
        the share `inward` of what is left. (In p the region is convex: the segment stays in.)"""
        low, high = self._region.box.to(p).unbind(-1)
        edge = _EDGE * (high - low)
        p = torch.clamp(p, low, high)
        centre = self._region.inside.to(p)
        out = p + _STARTS[-1] * (centre - p)
        for share in reversed(_STARTS[:-1]):
            tried = p + share * (centre - p)
            inside = ((tried > low + edge) & (tried < high - edge)).all(-1)
            inside &= torch.isfinite(self.value(self.point(tried)))
            if self._region.physical:
                second = second_moment(self._problem.split(tried)[2])
                smallest = torch.linalg.eigvalsh(second)[..., 0]
                size = second.diagonal(dim1=-2, dim2=-1).sum(-1).abs()
                inside &= (smallest > _EDGE * size).all(-1)
            out = torch.where(inside.unsqueeze(-1), tried, out)
        return self.point(out + inward * (centre - out))

    def _links(self, x: Tensor) -> Float[Tensor, "R n 10"]:
        return x[:, : 10 * self._n].unflatten(-1, (self._n, 10))

    def _slacks(self, x: Tensor) -> _Slacks:
        links = self._links(x)
        inertia = InertialParameters(links).inertia_about_com
        low, high = self._inertia.to(x).unbind(-1)
        rest, (least, most) = x[:, 10 * self._n :], self._rest.to(x).unbind(-1)
        total = round_ = None
        if self._total:
            sum_of_masses = links[..., 0].sum(-1)
            lower, upper = self._region.total_mass.to(x).unbind(-1)
            total = torch.stack([sum_of_masses - lower, upper - sum_of_masses], -1)
        if self._forms is not None:
            own = links[:, self._round, :4]
            round_ = torch.einsum("rnk,nkl,rnl->rn", own, self._forms.to(own), own)
        return _Slacks(
            linear=self._linear_slack(links),
            inertia=(inertia - low, high - inertia),
            rest=(rest - least, most - rest),
            total=total,
            round=round_,
        )

    def _linear_slack(self, links: Tensor) -> Float[Tensor, "R n 8"]:
        constant = self._constant.to(links)
        return torch.einsum("njk,rnk->rnj", self._linear.to(links), links) + constant

    def value(self, x: Float[Tensor, "R P"]) -> Float[Tensor, " R"]:
        """The barrier (R,); infinite outside."""
        value = torch.zeros_like(x[:, 0])
        for slack in self._slacks(x).all():
            value = value - slack.clamp(min=0.0).log().flatten(1).sum(-1)
        if self._region.physical:
            factor, info = torch.linalg.cholesky_ex(self._pseudo_inertia(x))
            logs = 2 * factor.diagonal(dim1=-2, dim2=-1).clamp(min=1e-300).log().sum(-1)
            value = value - torch.where(info == 0, logs, -torch.inf).sum(-1)
        return torch.where(value.isnan(), torch.inf, value)

    def _pseudo_inertia(self, x: Tensor) -> Float[Tensor, "R n 4 4"]:
        return torch.einsum("rnk,kij->rnij", self._links(x), self._basis.to(x))

    def derivatives(self, x: Float[Tensor, "R P"]) -> tuple[Tensor, Tensor]:
        """Gradient (R, P), and the positive semidefinite Hessian (R, P, P)."""
        n, slacks = self._n, self._slacks(x)
        c, inverse = self._linear.to(x), 1 / slacks.linear
        scaled = c * inverse.unsqueeze(-1)
        slope = -torch.einsum("njk,rnj->rnk", c, inverse)
        curve = scaled.transpose(-1, -2) @ scaled
        more, extra = self._of_inertias(x, *slacks.inertia)
        slope, curve = slope + more, curve + extra
        if self._region.physical:
            inverse = torch.linalg.inv_ex(self._pseudo_inertia(x))[0]
            turned = torch.einsum("rnij,kjl->rnkil", inverse, self._basis.to(x))
            slope = slope - turned.diagonal(dim1=-2, dim2=-1).sum(-1)
            curve = curve + turned.flatten(-2) @ turned.mT.flatten(-2).mT
        if slacks.round is not None and self._forms is not None:
            forms, slack = self._forms.to(x), slacks.round.unsqueeze(-1)
            push = 2 * torch.einsum("nkl,rnl->rnk", forms, self._links(x)[:, self._round, :4])
            push, rows = push / slack, self._round.nonzero().flatten()
            slope[:, rows, :4] -= push
            own = push.unsqueeze(-1) * push.unsqueeze(-2) - 2 * forms / slack.unsqueeze(-1)
            curve[:, rows, :4, :4] += own
        gradient = torch.zeros_like(x)
        hessian = x.new_zeros(*x.shape, x.shape[-1])
        gradient[:, : 10 * n] = slope.flatten(1)
        for i in range(n):
            hessian[:, 10 * i : 10 * i + 10, 10 * i : 10 * i + 10] = curve[:, i]
        below, above = slacks.rest
        gradient[:, 10 * n :] = 1 / above - 1 / below
        hessian.diagonal(dim1=-2, dim2=-1)[:, 10 * n :] = below.pow(-2) + above.pow(-2)
        if slacks.total is not None:
            below, above = slacks.total.unbind(-1)
            masses = slice(0, 10 * n, 10)
            gradient[:, masses] += (1 / above - 1 / below).unsqueeze(-1)
            hessian[:, masses, masses] += (below.pow(-2) + above.pow(-2))[:, None, None]
        return gradient, hessian

    def _of_inertias(self, x: Tensor, below: Tensor, above: Tensor) -> tuple[Tensor, Tensor]:
        """Bounds on the barycentric inertias: I = J - u(mc)/m, u the parallel-axis terms.

        Beside the slopes' outer products, diagonal entries have curvature: the lower bound's slack
        is concave in x and the upper one's convex; what remains positive of the two is kept.
        """
        links = self._links(x)
        com, mass = InertialParameters(links).com, links[..., 0]
        slopes = _barycentric_slopes(com)
        slope = torch.einsum("rnjk,rnj->rnk", slopes, 1 / above - 1 / below)
        weight = below.pow(-2) + above.pow(-2)
        curve = slopes.transpose(-1, -2) @ (slopes * weight.unsqueeze(-1))
        bend = (1 / below - 1 / above)[..., [0, 3, 5]].clamp(min=0.0)
        # I_xx loses (mc_y^2 + mc_z^2)/m: each axis counts for the two other entries.
        per_axis = (bend.sum(-1, keepdim=True) - bend) * 2 / mass.unsqueeze(-1)
        w = torch.zeros(*com.shape, 10, dtype=x.dtype, device=x.device)
        w[..., 0] = -com
        for axis in range(3):
            w[..., axis, 1 + axis] = 1.0
        curve = curve + w.transpose(-1, -2) @ (w * per_axis.unsqueeze(-1))
        return slope, curve

    def reach(self, x: Float[Tensor, "R P"], step: Float[Tensor, "R P"]) -> Float[Tensor, " R"]:
        """How far along `step` the linear slacks and the pseudo-inertias stay positive (R,)."""
        move = self._links(step)
        slack = self._linear_slack(self._links(x))
        change = torch.einsum("njk,rnk->rnj", self._linear.to(x), move)
        ratios = [torch.where(change < 0, -slack / change, torch.inf).flatten(1)]
        rest, moved = x[:, 10 * self._n :], step[:, 10 * self._n :]
        low, high = self._rest.to(x).unbind(-1)
        edge = torch.where(moved > 0, high - rest, rest - low)
        ratios.append(torch.where(moved != 0, edge / moved.abs(), torch.inf))
        if self._region.physical:
            factor = torch.linalg.cholesky_ex(self._pseudo_inertia(x))[0]
            change = torch.einsum("rnk,kij->rnij", move, self._basis.to(x))
            half = torch.linalg.solve_triangular(factor, change, upper=False)
            whole = torch.linalg.solve_triangular(factor, half.transpose(-1, -2), upper=False)
            finite = torch.isfinite(whole).all(-1).all(-1)
            safe = torch.where(finite[..., None, None], whole, 0.0)
            smallest = torch.linalg.eigvalsh(safe)[..., 0]
            ratios.append(torch.where(smallest < 0, -1 / smallest, torch.inf))
        return torch.cat(ratios, -1).amin(-1)


def _linear_slacks(box: Tensor, n: int) -> tuple[Float[Tensor, "n 8 10"], Float[Tensor, "n 8"]]:
    """m - LB, UB - m, and m c - m c_min, m c_max - m c, as rows over a link's ten parameters."""
    rows = box.new_zeros(n, 8, 10)
    constant = box.new_zeros(n, 8)
    com = box[n : 4 * n].reshape(n, 3, 2)
    rows[:, 0, 0], constant[:, 0] = 1.0, -box[:n, 0]
    rows[:, 1, 0], constant[:, 1] = -1.0, box[:n, 1]
    for axis in range(3):
        rows[:, 2 + axis, 1 + axis], rows[:, 2 + axis, 0] = 1.0, -com[:, axis, 0]
        rows[:, 5 + axis, 1 + axis], rows[:, 5 + axis, 0] = -1.0, com[:, axis, 1]
    return rows, constant


def _barycentric_slopes(com: Float[Tensor, "R n 3"]) -> Float[Tensor, "R n 6 10"]:
    """Derivative of the barycentric inertia's six entries with respect to (m, m c, J)."""
    x, y, z = com.unbind(-1)
    o, one = torch.zeros_like(x), torch.ones_like(x)
    of_mass = (y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y)
    of_moment = (
        (o, -2 * y, -2 * z),
        (y, x, o),
        (z, o, x),
        (-2 * x, o, -2 * z),
        (o, z, y),
        (-2 * x, -2 * y, o),
    )
    rows = []
    for k in range(6):
        of_inertia = [one if j == k else o for j in range(6)]
        rows.append(torch.stack([of_mass[k], *of_moment[k], *of_inertia], -1))
    return torch.stack(rows, -2)
