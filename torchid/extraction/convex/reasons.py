"""Why a convex problem is infeasible, and which conditions hold its minimum up."""

import numpy as np

from torchid.extraction.convex.conic import Solution, minimise
from torchid.extraction.convex.sets import ConvexSets, Nearest

NEARLY_ZERO = 1e-3
"""Share of a least loss that counts as none."""
_ACTIVE = 1e-7
"""Multipliers below this share of the largest are zero."""
NOTHING = 1e-6
"""A least norm below this share of the offset's needs no explanation."""


def conflict_of(body: ConvexSets) -> tuple[str, ...]:
    """Conditions that no x meets together, none of which can be left out; () if some x does.

    The solver's proof of infeasibility (Farkas) names candidates; each that is not needed for the
    contradiction is then dropped.
    """
    nothing = np.zeros(body.basis.shape[1])
    found = minimise(nothing, body.rows)
    if found.usable:
        return ()
    kept = _active(body, found)
    everything = set(body.names)
    for name in list(kept):
        rest = set(kept) - {name}
        if rest and minimise(nothing, body.without(everything - rest).rows).status == "infeasible":
            kept.remove(name)
    return tuple(kept)


def forcing_conditions(
    body: ConvexSets, matrix: np.ndarray, offset: np.ndarray, found: Nearest
) -> tuple[dict[str, float], tuple[str, ...]]:
    """What holds a least norm up.

    Args:
        body: the sets.
        matrix, offset: of the norm ||matrix x + offset||.
        found: its minimum over the sets.

    Returns:
        The squared minimum without each active condition (without any other it stays), and a small
        group of conditions, found greedily, without which it is nearly zero; () if there is none
        or the minimum is zero.
    """
    if found.bound <= NOTHING * float(np.linalg.norm(offset)):
        return {}, ()
    first: dict[str, float] = {}
    goal, group, left = NEARLY_ZERO * found.value**2, list[str](), found
    while left.value**2 > goal:
        rest = body.without(group)
        trials = {
            name: rest.without([name]).least_norm(matrix, offset)
            for name in _active(rest, left.solution)
        }
        trials = {name: t for name, t in trials.items() if t.solution.usable}
        first = first or {name: t.bound**2 for name, t in trials.items()}
        if not trials:
            break
        best = min(trials, key=lambda name: trials[name].value)
        group.append(best)
        left = trials[best]
    if left.value**2 > goal:
        return first, ()
    for name in list(group):
        rest = body.without(set(group) - {name})
        if len(group) > 1 and rest.least_norm(matrix, offset).value ** 2 <= goal:
            group.remove(name)
    return first, tuple(group)


def _active(body: ConvexSets, found: Solution) -> list[str]:
    """Conditions whose multipliers are not zero: without any other, the optimum stays."""
    sizes = [float(np.linalg.norm(z)) for z in found.multipliers[: len(body.rows)]]
    least = _ACTIVE * max(sizes)
    # Not "s > least": a multiplier that is not a number counts.
    names = [r.name for r, s in zip(body.rows, sizes, strict=True) if not s <= least]
    return list(dict.fromkeys(names))
