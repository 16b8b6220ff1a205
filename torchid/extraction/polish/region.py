"""The region a polished set must stay in, and a point well inside it.

In the search variables p (masses, centres of mass, barycentric inertias, coefficients) every
condition is convex: boxes and the total mass are linear, cylinders and spheres are quadratic, and
the triangle inequality says that S = tr(I)/2 E - I, which is linear in I, is positive definite.
So the region is convex, has an interior or is empty, and the segment from any point of the bounds
to an interior point enters it and stays.
"""

from dataclasses import dataclass

import torch
from scipy.optimize import linprog

from torchid.extraction.problem import Problem
from torchid.feasibility.sets import coefficient_reasons
from torchid.robot.inertia import second_moment
from torchid.typing import Bool, Float, Tensor

_SLIVER = 1e-6
"""Share of a bound's span left where bounds and conditions exclude each other: the search then
keeps to the face of the bounds that is nearest to the condition."""
_ASCENT = 400


@dataclass(frozen=True, eq=False)
class Region:
    """Bounds of p with the conditions put into them.

    Attributes:
        box: (D, 2) of p: the bounds, narrowed by the CoM boxes and by m >= 0 when conditions count.
        physical: whether S must be positive definite and the round shapes and total mass hold;
            false for the bounds alone, and where some link's inertia cannot be a body's within
            them.
        inside: (D,) a point strictly inside.
        contradictions: names of conditions that no point of the bounds meets, e.g. com_7z.
        round_links: (n,) links whose cylinder or sphere counts.
        total_mass: (2,) interval of the total mass within the bounds; infinite where not asked for.
    """

    box: Float[Tensor, "D 2"]
    physical: bool
    inside: Float[Tensor, " D"]
    contradictions: tuple[str, ...]
    round_links: Bool[Tensor, " n"]
    total_mass: Float[Tensor, "2"]


def region(problem: Problem, *, conditions: bool) -> Region:
    """The region of the full loss (`conditions`) or of the partial one (the bounds alone).

    Contradictions do not raise: the condition in question is left out of the region, or, for a
    centre of mass, replaced by the nearest face of the bounds. The caller decides.
    """
    n = problem.n
    no_total = torch.tensor([-torch.inf, torch.inf], dtype=problem.box.dtype)
    if not conditions:
        none = torch.zeros(n, dtype=torch.bool)
        middle = problem.box.mean(-1)
        return Region(problem.box, False, middle, (), none, no_total)
    box, contradictions = _narrowed(problem)
    # Masses inside their bounds whose sum is inside the total mass's interval.
    asked = problem.conditions.total_mass.to(box)
    low = torch.maximum(asked[0], box[:n, 0].sum())
    high = torch.minimum(asked[1], box[:n, 1].sum())
    mass, total = box[:n].mean(-1), no_total
    if low < high:
        span = box[:n, 1] - box[:n, 0]
        mass = box[:n, 0] + ((low + high) / 2 - box[:n, 0].sum()) / span.sum() * span
        total = torch.stack([low, high]) if bool(torch.isfinite(asked).any()) else asked
    else:
        contradictions.append("total_mass")
    com, round_links, outside = _centres(problem, box[n : 4 * n].reshape(n, 3, 2))
    # Inertias (n, 6) inside their bounds with S as positive definite as the bounds allow.
    inertia = torch.stack([_best_inertia(own) for own in box[4 * n : 10 * n].reshape(n, 6, 2)])
    impossible = [f"inertia_{i + 1}" for i in range(n) if float(second_moments(inertia[i])[0]) <= 0]
    inside = torch.cat([mass, com.flatten(), inertia.flatten(), box[10 * n :].mean(-1)])
    return Region(
        box,
        not impossible,
        inside,
        (*contradictions, *outside, *impossible),
        round_links,
        total,
    )


def _narrowed(problem: Problem) -> tuple[Tensor, list[str]]:
    """The bounds of p, narrowed by m >= 0, by the signs of the effects' coefficients and by the
    boxes of the centres of mass."""
    n = problem.n
    box = problem.box.clone()
    names = coefficient_reasons(problem.target.effects)
    signed = [(i, f"mass_{i + 1}") for i in range(n)]
    signed += [(10 * n + k, names[k]) for k in problem.non_negative.nonzero().flatten().tolist()]
    found = [name for k, name in signed if box[k, 1] <= 0]
    for k in [k for k, name in signed if name not in found]:
        box[k, 0] = box[k, 0].clamp(min=0.0)
    asked = problem.conditions.com_box.reshape(-1, 2).to(box)
    own = box[n : 4 * n]
    low, high = torch.maximum(own[:, 0], asked[:, 0]), torch.minimum(own[:, 1], asked[:, 1])
    span = own[:, 1] - own[:, 0]
    below, above = own[:, 0] >= asked[:, 1], own[:, 1] <= asked[:, 0]
    low = torch.where(below, own[:, 0], torch.where(above, own[:, 1] - _SLIVER * span, low))
    high = torch.where(below, own[:, 0] + _SLIVER * span, torch.where(above, own[:, 1], high))
    found += [
        f"com_{k // 3 + 1}{'xyz'[k % 3]}" for k in (below | above).nonzero().flatten().tolist()
    ]
    box[n : 4 * n] = torch.stack([low, high], -1)
    return box, found


def _centres(problem: Problem, box: Tensor) -> tuple[Tensor, Tensor, list[str]]:
    """Centres of mass inside their boxes and shapes, and which links' shapes can be met."""
    c = problem.conditions
    centre, axes, radius = (x.to(box) for x in (c.round_centre, c.round_axes, c.round_radius))
    com = box.mean(-1)
    nearest = torch.clamp(centre, box[..., 0], box[..., 1])
    asked = torch.isfinite(radius)
    reach = ((nearest - centre) * axes).norm(dim=-1)
    possible = reach < radius
    # Towards the shape's axis until it is inside, keeping away from the box's faces if possible.
    point, out = com, asked & possible
    for share in (0.0, 0.5, 0.9, 0.99, 0.999, 0.9999):
        tried = com + share * (nearest - com)
        point = torch.where(out.unsqueeze(-1), tried, point)
        out &= ((point - centre) * axes).norm(dim=-1) >= radius
    # What overlaps by less than that leaves no room to search in.
    met = asked & possible & ~out
    missed = (asked & ~met).nonzero().flatten().tolist()
    return point, met, [f"shape_{i + 1}" for i in missed]


def _best_inertia(box: Float[Tensor, "6 2"]) -> Float[Tensor, "6"]:
    """Off-diagonal entries as near zero as the bounds allow, where the smallest eigenvalue of S is
    largest, and the diagonal that makes it large; ascent on that eigenvalue where zero is not
    allowed."""
    low, high = box.unbind(-1)
    diagonal = [0, 3, 5]
    # Maximise t with tr(I)/2 - I_k >= t, well inside the bounds.
    a = torch.tensor([[1.0, -1, -1, 2], [-1, 1, -1, 2], [-1, -1, 1, 2]], dtype=torch.float64)
    shrunk = (0.25 * (high - low))[diagonal]
    limits = [
        *zip((low[diagonal] + shrunk).tolist(), (high[diagonal] - shrunk).tolist(), strict=True),
        (None, None),
    ]
    found = linprog([0, 0, 0, -1], A_ub=a.numpy(), b_ub=[0, 0, 0], bounds=limits)
    inertia = torch.clamp(torch.zeros_like(low), low, high)
    inertia[diagonal] = torch.tensor(found.x[:3], dtype=low.dtype)
    best, value = inertia, float(second_moments(inertia)[0])
    if bool((inertia[[1, 2, 4]] == 0).all()) and value > 0:
        # Strictly inside: a bound may be 0 exactly.
        inside = inertia.clone()
        inside[[1, 2, 4]] = torch.clamp(inside[[1, 2, 4]], *_shrunk(low, high)[:, [1, 2, 4]])
        return inside if float(second_moments(inside)[0]) > 0 else inertia
    low, high = _shrunk(low, high)
    for k in range(_ASCENT):
        values, vectors = torch.linalg.eigh(second_moment(inertia))
        if float(values[0]) > value:
            best, value = inertia, float(values[0])
        v = vectors[:, 0]
        outer = v.unsqueeze(-1) * v
        slope = torch.stack(
            [0.5 - outer[0, 0], -2 * outer[0, 1], -2 * outer[0, 2],
             0.5 - outer[1, 1], -2 * outer[1, 2], 0.5 - outer[2, 2]]
        )  # fmt: skip
        step = (high - low).max() / (k + 2)
        inertia = torch.clamp(inertia + step * slope, low, high)
    return best


def _shrunk(low: Tensor, high: Tensor) -> Tensor:
    margin = 1e-3 * (high - low)
    return torch.stack([low + margin, high - margin])


def second_moments(inertia: Float[Tensor, "*batch 6"]) -> Float[Tensor, "*batch 3"]:
    """Eigenvalues of S (..., 3), ascending."""
    return torch.linalg.eigvalsh(second_moment(inertia))
