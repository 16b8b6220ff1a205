"""The end of a population search: the set of nearly the least loss next to each run's.

Where the loss leaves a choice, runs stay as different as the search left them. Each end is a
semidefinite program or a few: bounds of barycentric inertias are linearised about the last centres
of mass, so that every answer is within them (the convex-concave procedure).
"""

from dataclasses import replace

import numpy as np
import torch

from torchid.design.bodies import triangle
from torchid.extraction.convex.atlas import least_loss_region
from torchid.extraction.convex.certificate import INSIDE_SHARE, STRICT_EIGENVALUE
from torchid.extraction.convex.conic import Rows, minimise
from torchid.extraction.convex.sets import AskedSets, sets_of
from torchid.extraction.problem import Problem
from torchid.feasibility.sets import coefficient_reasons
from torchid.robot.inertia import second_moment
from torchid.typing import Float, Tensor


def finished(
    problem: Problem, p: Float[Tensor, "R D"], *, conditions: bool = True
) -> Float[Tensor, "R D"]:
    """The ends of runs.

    Args:
        problem: loss, bounds, and conditions, of which those that the bounds exclude do not count.
        p: (R, D) search vectors within the bounds.
        conditions: whether physics and conditions count beside the bounds.

    Returns:
        (R, D) within the bounds. A run with a value that is not finite is returned as it came,
        and so are all where there is no such set (masses that must be negative).
    """
    within, excluded = attainable(problem)
    low, high = problem.box.unbind(-1)
    if conditions:
        com = slice(problem.n, 4 * problem.n)
        low, high = low.clone(), high.clone()
        low[com], high[com] = torch.from_numpy(AskedSets(within).box).reshape(-1, 2).to(low).T
    physics = [f"inertia_{k + 1}" for k in range(problem.n)]
    without = [name for name in physics if name in excluded or not conditions]
    ends = [_end(within, one, conditions, without) for one in p]
    return torch.stack([one if end is None else torch.clamp(end, low, high)
                        for one, end in zip(p, ends, strict=True)])  # fmt: skip


def _end(
    problem: Problem, p: Float[Tensor, " D"], conditions: bool, without: list[str]
) -> Float[Tensor, " D"] | None:
    """The end of a run; None where there is none."""
    if not bool(torch.isfinite(p).all()):
        return None
    start, best, least = problem.vector(p).numpy(), None, np.inf
    # Near in units of the bounds' spans, as p is; of m c, with the largest mass.
    n, span = problem.n, (problem.box[:, 1] - problem.box[:, 0]).double().cpu().numpy()
    span[n : 4 * n] *= np.repeat(problem.box[:n, 1].abs().double().cpu().numpy(), 3)
    nearness = np.diag(1 / np.maximum(span, 1e-9 * span.max()))
    com: np.ndarray | None = problem.split(p)[1].numpy()
    asked, margin = AskedSets(problem, conditions), STRICT_EIGENVALUE if conditions else 0.0
    # 30: linearisations of the bounds at most
    for _ in range(30):
        body = asked.body(margin, com).without(without).tightened(INSIDE_SHARE)
        # 1e-3: share of the least loss that nearness to the search's end may cost beside it
        region = least_loss_region(problem, body, 1e-3)
        nearest = region.sets.least_norm(nearness, -nearness @ start)
        if not nearest.solution.usable and com is not None and least == np.inf:
            # No set near the run's centres of mass: those of the relaxed bounds may do.
            com = None
            continue
        if not nearest.solution.usable:
            break
        sets = sets_of(nearest.x[None], problem.n, problem.target.effects, ["end"])
        phi = float(problem.residual_of_vector(sets.vector).square().sum())
        # 1e-3: relative decrease of the loss for which the bounds of inertias are linearised anew
        if phi >= (1 - 1e-3) * least:
            break
        if com is not None:
            best, least = sets.search_vector[0], phi
        if com is not None and region.kind == "exact":
            break
        com = sets.parameters.com[0].numpy()
    return best


def attainable(problem: Problem) -> tuple[Problem, tuple[str, ...]]:
    """The problem with conditions that some point of the bounds meets, one by one; and the names
    of those that none does, e.g. com_7z.

    Of a centre of mass the nearest face of the bounds then counts, a shape and the total mass do
    not. In p (masses, centres of mass, barycentric inertias, coefficients) each condition concerns
    some entries alone, but the total mass.
    """
    n, asked = problem.n, problem.conditions
    box = problem.box.clone()
    names = coefficient_reasons(problem.target.effects)
    signed = [(i, f"mass_{i + 1}") for i in range(n)]
    signed += [(10 * n + k, names[k]) for k in problem.non_negative.nonzero().flatten().tolist()]
    against = [name for k, name in signed if box[k, 1] <= 0]
    box[:n] = box[:n].clamp(min=0.0)
    own, wanted = box[n : 4 * n], asked.com_box.reshape(-1, 2).to(box)
    below, above = own[:, 0] >= wanted[:, 1], own[:, 1] <= wanted[:, 0]
    # 1e-6: share of a bound's span left where bounds and conditions exclude each other: a set then
    # keeps to the face of the bounds that is nearest to the condition
    sliver = 1e-6 * (own[:, 1] - own[:, 0])
    low = torch.where(below, own[:, 0], torch.where(above, own[:, 1] - sliver, wanted[:, 0]))
    high = torch.where(below, own[:, 0] + sliver, torch.where(above, own[:, 1], wanted[:, 1]))
    missed = (below | above).nonzero().flatten().tolist()
    against += [f"com_{k // 3 + 1}{'xyz'[k % 3]}" for k in missed]
    total = asked.total_mass.to(box)
    if torch.maximum(total[0], box[:n, 0].sum()) >= torch.minimum(total[1], box[:n, 1].sum()):
        against.append("total_mass")
        total = torch.tensor([-torch.inf, torch.inf], dtype=box.dtype)
    com = torch.stack([low, high], -1).reshape(n, 3, 2)
    centre, axes, radius = (
        x.to(box) for x in (asked.round_centre, asked.round_axes, asked.round_radius)
    )
    # The point of the box that is nearest to the shape's centre.
    least, most = torch.maximum(com, own.reshape(n, 3, 2)), torch.minimum(com, own.reshape(n, 3, 2))
    nearest = torch.clamp(centre, least[..., 0], most[..., 1])
    outside = ((nearest - centre) * axes).norm(dim=-1) >= radius
    against += [f"shape_{i + 1}" for i in outside.nonzero().flatten().tolist()]
    against += [
        f"inertia_{i + 1}"
        for i, bounds in enumerate(box[4 * n : 10 * n].reshape(n, 6, 2))
        if not _physical(bounds)
    ]
    kept = replace(
        asked,
        com_box=com,
        round_radius=torch.where(outside, torch.inf, radius),
        total_mass=total,
    )
    return replace(problem, conditions=kept), tuple(against)


def _physical(bounds: Float[Tensor, "6 2"]) -> bool:
    """Whether some inertia within the bounds has positive definite second moments S: the largest
    smallest eigenvalue of S is that of a semidefinite program."""
    low, high = (end.double().cpu().numpy() for end in bounds.unbind(-1))
    size = max(float(np.abs(bounds.double().numpy()).max()), 1e-300)
    moments = triangle(second_moment(torch.eye(6, dtype=torch.float64)).numpy()).T
    definite = np.hstack([moments, -triangle(np.eye(3))[:, None]])
    ends = np.hstack([np.vstack([np.eye(6), -np.eye(6)]), np.zeros((12, 1))])
    offset, none = np.concatenate([-low, high]) / size, np.zeros(12)
    solution = minimise(
        -np.eye(7)[6],
        [
            Rows("definite", "semidefinite", definite, np.zeros(6), np.zeros(6)),
            Rows("bounds", "nonnegative", ends, offset, none),
        ],
    )
    # 1e-9: smallest eigenvalue of second moments that inertias within bounds must allow, over their
    # size
    return solution.usable and -solution.value > 1e-9
