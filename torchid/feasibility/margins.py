"""Whether a set of parameters can belong to a real arm, by how much, and why not (section 2.3).

Every condition has a signed margin, in its own unit, positive inside, and a *degree*: the margin
over a scale of its own, so that conditions, links and arms can be compared. A set is feasible when
masses and inertias have positive margins and no other margin is negative; its degree is the
smallest of its conditions', so a firmly feasible set has a large one, a set on the boundary 0, and
an infeasible one a negative one. A link of zeros among others is a frame, not a body, and has no
conditions.

| condition   | margin                                | equation | scale of the degree            |
|-------------|---------------------------------------|----------|--------------------------------|
| mass        | m_i                                   | 2.22     | mean of the set's abs(m)       |
| eigenvalue  | smallest eigenvalue of I_i            | 2.24     | mean abs second moment of i    |
| triangle    | tr(I_i)/2 - largest eigenvalue        | 2.26     | the same                       |
| com_x, y, z | distance of c_i to its box's faces    | 2.27     | half the box's side            |
| shape       | distance to the cylinder or sphere    | -        | its radius                     |
| total mass  | distance to the interval's ends       | 2.31     | half the interval              |
| coefficient | itself, where physics says >= 0       | -        | mean abs of its kind in the set |

The second moments of a link are the eigenvalues of S = tr(I)/2 E - I; a body has them positive,
which is the triangle inequality, and then I's eigenvalues are positive too. So `triangle` is the
stronger condition, and a violated `eigenvalue` says that I is not even positive definite.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.feasibility.conditions import Conditions
from torchid.feasibility.sets import ParameterSets
from torchid.robot.inertia import InertialParameters, symmetric
from torchid.typing import Bool, Float, Tensor

LINK_CONDITIONS = ("mass", "eigenvalue", "triangle", "com_x", "com_y", "com_z", "shape")
"""Columns of the margins of a link."""

_STRICT = torch.tensor([True, True, True, False, False, False, False])


@dataclass(frozen=True, eq=False)
class Feasibility:
    """Signed margins and degrees of K sets; a condition that was not asked for is infinite.

    Attributes:
        ids: (K,) of the sets.
        margins, degrees: (K, n, C) per link and condition, in the order of `LINK_CONDITIONS`.
        total_mass, total_mass_degree: (K,) [kg], [-].
        coefficients, coefficient_degrees: (K, E) of the effects; infinite where any sign will do.
        coefficient_names, coefficient_reasons: (E,) e.g. Fv6, and Fv_6 as in the reasons.
        violated: (K, n, C), violated_total (K,), violated_coefficients (K, E).
    """

    ids: tuple[str, ...]
    margins: Float[Tensor, "K n C"]
    degrees: Float[Tensor, "K n C"]
    total_mass: Float[Tensor, " K"]
    total_mass_degree: Float[Tensor, " K"]
    coefficients: Float[Tensor, "K E"]
    coefficient_degrees: Float[Tensor, "K E"]
    coefficient_names: tuple[str, ...]
    coefficient_reasons: tuple[str, ...]
    violated: Bool[Tensor, "K n C"]
    violated_total: Bool[Tensor, " K"]
    violated_coefficients: Bool[Tensor, "K E"]

    @property
    def feasible(self) -> Bool[Tensor, " K"]:
        """(K,) whether no condition is violated."""
        any_link = self.violated.flatten(1).any(-1)
        return ~(any_link | self.violated_total | self.violated_coefficients.any(-1))

    @property
    def degree(self) -> Float[Tensor, " K"]:
        """(K,) smallest degree of the set's conditions; negative outside, 0 on the boundary."""
        total = self.total_mass_degree.unsqueeze(-1)
        return torch.cat([self.degrees.flatten(1), total, self.coefficient_degrees], -1).amin(-1)

    def reasons(self, k: int) -> tuple[str, ...]:
        """Why set k is infeasible, named as the report's tables do: inertia_3, com_7z, mass_2,
        shape_1, total_mass, Fv_6. Empty if it is feasible."""
        names = []
        for link, row in enumerate(self.violated[k].tolist(), start=1):
            mass, eigenvalue, triangle, *com, shape = row
            names += [f"mass_{link}"] if mass else []
            names += [f"inertia_{link}"] if eigenvalue or triangle else []
            names += [f"com_{link}{axis}" for axis, out in zip("xyz", com, strict=True) if out]
            names += [f"shape_{link}"] if shape else []
        names += ["total_mass"] if bool(self.violated_total[k]) else []
        out = self.violated_coefficients[k].tolist()
        names += [n for n, bad in zip(self.coefficient_reasons, out, strict=True) if bad]
        return tuple(names)

    def inertia_violation(self, k: int, link: int) -> str | None:
        """How link `link` (from 0) of set k violates inertia: `eigenvalue` (not positive
        definite), `triangle` (positive definite, but no body), or None."""
        if bool(self.violated[k, link, 1]):
            return "eigenvalue"
        return "triangle" if bool(self.violated[k, link, 2]) else None


def feasibility(sets: ParameterSets, conditions: Conditions) -> Feasibility:
    """Margins, degrees and violations of all sets in one batch.

    A set with a number that is not finite violates every condition that cannot be computed.
    """
    margins, scales = link_margins(sets.parameters, conditions)
    low, high = conditions.total_mass.to(sets.parameters.pi).unbind(-1)
    mass = sets.parameters.mass.sum(-1)
    total, total_scale = torch.minimum(mass - low, high - mass), _half(low, high)
    # Coefficients of effects, where physics forbids a sign: their size against those of their kind.
    kinds = [(c.name, c.non_negative) for e in sets.effects for c in e.coefficients]
    finite = torch.isfinite(sets.coefficients)
    coefficients = torch.where(finite, sets.coefficients, torch.nan)
    coefficient_scale = torch.ones_like(coefficients)
    for k, (kind, non_negative) in enumerate(kinds):
        if non_negative:
            same = [j for j, (other, _) in enumerate(kinds) if other == kind]
            coefficient_scale[:, k] = sets.coefficients[:, same].abs().mean(-1)
        else:
            coefficients[:, k] = torch.where(finite[:, k], torch.inf, torch.nan)
            coefficient_scale[:, k] = torch.inf
    strict = _STRICT.to(margins.device)
    # Share of a scale by which a closed condition (a box) may be missed: c = (m c) / m rounds
    rounding = 1e-9
    tolerance = torch.where(strict, 0.0, -rounding) * scales
    # Not "margin < 0": nan must count as violated.
    kept = torch.where(strict, margins > 0, margins >= tolerance)
    return Feasibility(
        ids=sets.ids,
        margins=margins,
        degrees=_over(margins, scales),
        total_mass=total,
        total_mass_degree=_over(total, total_scale),
        coefficients=coefficients,
        coefficient_degrees=_over(coefficients, coefficient_scale),
        coefficient_names=sets.coefficient_names(),
        coefficient_reasons=sets.coefficient_reasons(),
        violated=~kept,
        violated_total=~(total >= -rounding * total_scale),
        violated_coefficients=~(coefficients >= 0),
    )


def link_margins(
    parameters: InertialParameters, conditions: Conditions
) -> tuple[Float[Tensor, "*batch n C"], Float[Tensor, "*batch n C"]]:
    """Margins (..., n, C) of the links' conditions and the scales of their degrees."""
    mass, com = parameters.mass, parameters.com
    eigenvalues = inertia_eigenvalues(parameters)
    half_trace = eigenvalues.sum(-1) / 2
    second = half_trace.unsqueeze(-1) - eigenvalues
    box = conditions.com_box.to(com)
    below, above = com - box[..., 0], box[..., 1] - com
    centre, axes = conditions.round_centre.to(com), conditions.round_axes.to(com)
    radius = conditions.round_radius.to(com)
    inside = (radius - ((com - centre) * axes).norm(dim=-1)).unsqueeze(-1)
    of_mass, of_com = mass.unsqueeze(-1), torch.minimum(below, above)
    margins = torch.cat([of_mass, eigenvalues[..., :1], second[..., 2:], of_com, inside], -1)
    mass_scale = mass.abs().mean(-1, keepdim=True).expand_as(mass)
    second_scale = second.abs().mean(-1)
    com_scale = _half(box[..., 0], box[..., 1]).expand_as(com)
    of_body = torch.stack([mass_scale, second_scale, second_scale], -1)
    # A frame between two joints is no body, of which nothing is asked.
    frame = (parameters.pi == 0).all(-1, keepdim=True) & (mass_scale > 0).unsqueeze(-1)
    margins = torch.where(frame, torch.inf, margins)
    return margins, torch.cat([of_body, com_scale, radius.expand_as(mass).unsqueeze(-1)], -1)


def inertia_eigenvalues(parameters: InertialParameters) -> Float[Tensor, "*batch n 3"]:
    """Eigenvalues (..., n, 3) of the barycentric inertias, ascending; nan where not finite."""
    tensors = symmetric(parameters.inertia_about_com)
    finite = torch.isfinite(tensors).all(-1).all(-1)
    values = torch.linalg.eigvalsh(torch.where(finite[..., None, None], tensors, 0.0))
    return torch.where(finite.unsqueeze(-1), values, torch.nan)


def _half(low: Tensor, high: Tensor) -> Tensor:
    """Half of intervals; of one that is open to one side, the size of its end."""
    half = (high - low) / 2
    end = torch.where(torch.isfinite(low), low, high).abs()
    return torch.where(torch.isfinite(half), half, end)


def _over(margins: Tensor, scales: Tensor) -> Tensor:
    """margins / scales; infinite where the condition was not asked for, 0 where both are 0."""
    ratio = margins / scales
    ratio = torch.where(margins == 0, 0.0, ratio)
    return torch.where(margins == torch.inf, torch.inf, ratio)


def kinds(reasons: Sequence[str]) -> frozenset[str]:
    """Kinds of reasons without links: {"inertia", "com"} for inertia_3, com_7z."""
    return frozenset("total_mass" if r == "total_mass" else r.rsplit("_", 1)[0] for r in reasons)
