"""The motion that best tells explanations of a gap apart.

With r what a motion tells of a pair, relative to what decides (see `separation`), the design
maximises the mean of 1 - exp(-r), about the share of pairs that are decided, over all pairs, both
ways. Directions of friction and the like jump, so there is no gradient to follow: CMA-ES (Hansen
2016) moves the trajectory's coefficients, its centre, and how much of the limits each joint uses,
for slow motion tells as much as fast.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cma
import numpy as np
import torch

from torchid.errors import TorchidError
from torchid.excitation.clearance import Clearance
from torchid.excitation.descent import LONGER
from torchid.excitation.fourier import FourierTrajectory
from torchid.excitation.limits import MotionLimits, largest_scale, motion_limits
from torchid.excitation.restriction import restricted
from torchid.excitation.torque import CORRECTED, TorqueLimits
from torchid.excitation.trajectories import Designed, random_trajectory
from torchid.next_motion.rows import Rows, Setting
from torchid.next_motion.separation import (
    SAME_DIFFERENCE,
    Discrimination,
    Rival,
    left_by_forms,
    name_pairs,
    other_means,
    separations,
    torque_of,
)
from torchid.robot.model import Robot
from torchid.typing import Tensor

SLOWEST = 0.03
"""Share of the limits that a joint uses at least."""

MOST_PAIRS = 16
"""Pairs that the search looks at."""
DECIDED_TIMES = 5.0
"""Times what decides: beyond it a pair needs no more."""
FIRST_MOTIONS = 6
"""Motions tried before a pair is given up."""
NEAREST_FORMS = 2
"""Forms of the other effect that the search looks at, of each motion tried first."""
LOGARITHM_WEIGHT = 0.02
"""Weight of the mean logarithm beside the share of decided pairs."""

POPULATION = 16
_SPREAD = 0.3
_FULL = -4.0  # where the search of the joints' shares starts: nearly the whole of the limits
_RANDOM_SHARE = 0.2  # of the evaluations, before the search

Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class Separation(Designed):
    """A motion and what it separates.

    Attributes:
        trajectory: the best found.
        plain: what it is compared with, of the same length.
        rivals: the pairs, in order.
        with_plain, after: of each pair for the two motions.
        hopeless: rivals that no motion tried separates, not part of the design.
        warnings: sentences for the user.
        torque: the torque limits kept, by the corrected model; None if there are none.
        kind: `ambiguity`, or `not_testable`: effects that the log could not have shown.
        notes: what is no matter of motion, sentences for the user.
    """

    trajectory: FourierTrajectory
    plain: FourierTrajectory
    rivals: tuple[Rival, ...]
    with_plain: tuple[Discrimination, ...]
    after: tuple[Discrimination, ...]
    hopeless: tuple[Rival, ...]
    warnings: tuple[str, ...]
    torque: TorqueLimits | None = None
    kind: str = "ambiguity"
    notes: tuple[str, ...] = ()

    @property
    def hardly(self) -> bool:
        """Whether the plain motion, driven a tenth longer, comes as near to deciding all."""
        return _hardly(self.after, self.with_plain)


def design_separation(
    setting: Setting,
    rivals: Sequence[Rival],
    plain: FourierTrajectory,
    *,
    seed: int,
    evaluations: int = 600,
    usage: float = 1.0,
    clearance: Clearance | None = None,
    progress: Progress | None = None,
) -> Separation:
    """The motion, of the length and harmonics of `plain`, that separates most pairs.

    There is no search where the plain motion decides all that the search would look at, and half
    of one where it hardly beats the plain motion by then.

    Args:
        setting: model and noise.
        rivals: pairs to separate.
        plain: where the search starts, and what the result is compared with.
        seed: of the search.
        evaluations: trajectories tried.
        usage: share of the limits that may be used.
        clearance: distances to keep.
        progress: called with (evaluations done, all).

    Raises:
        RobotError: the limits are incomplete, no motion keeps torque limits and clearance, or
            the robot has no parameters.
        TorchidError: no motion tried separates any pair.
    """
    limits = motion_limits(setting.robot, usage=usage)
    torque = TorqueLimits.of(setting.robot, setting.given, CORRECTED, usage)
    kept_by = restricted(torque, clearance)
    tried = [plain, *_random(setting.robot, plain, seed, usage, evaluations)]
    if kept_by is not None:
        tried = [kept_by.within(x) for x in tried]
        plain = tried[0]
    seen = list(zip(*(separations(setting, rivals, x) for x in tried[:FIRST_MOTIONS]), strict=True))
    kept = [k for k, told in enumerate(seen) if max(t.difference for t in told) > SAME_DIFFERENCE]
    if not kept:
        raise TorchidError(
            "no motion settles what this diagnosis leaves open.",
            got=name_pairs(rivals) or "no rival acts on this arm",
            hint=other_means(r.truth.effect.name for r in rivals),
        )
    asked = [_pruned(setting, rivals[k], tried[:FIRST_MOTIONS]) for k in _promising(kept, seen)]

    def score(x: FourierTrajectory) -> float:
        value = _score(separations(setting, asked, x))
        return value if kept_by is None else value - float(kept_by.penalty(x))

    scores = []
    for x in tried:
        scores.append(score(x))
        if progress is not None:
            progress(len(scores), evaluations)
    start = tried[int(np.argmax(scores))]
    of_plain = separations(setting, asked, plain)

    def hardly(x: FourierTrajectory) -> bool:
        return _hardly(separations(setting, asked, x), of_plain)

    found = start
    if not all(t.reached >= 1 for t in of_plain):
        found = _search(start, limits, score, hardly, seed, evaluations, progress)
    if kept_by is not None:
        found = kept_by.within(found)
    wanted = [rivals[k] for k in kept]
    # The search looks at some pairs and forms; what counts is all of them.
    told = {x: separations(setting, wanted, x) for x in (found, start, plain)}
    best = max(told, key=lambda x: _score(told[x]))
    return Separation(
        best,
        plain,
        tuple(wanted),
        tuple(told[plain]),
        tuple(told[best]),
        tuple(r for k, r in enumerate(rivals) if k not in kept),
        limits.warnings,
        torque,
    )


def _promising(kept: Sequence[int], seen: Sequence[Sequence[Discrimination]]) -> list[int]:
    """Pairs that the search looks at: those that the plain motion leaves in doubt, the easiest
    first, then those that it does not, the hardest first."""

    def order(k: int) -> tuple[bool, float]:
        sure = seen[k][0].reached >= DECIDED_TIMES
        return sure, seen[k][0].reached if sure else -max(t.reached for t in seen[k])

    return sorted(kept, key=order)[:MOST_PAIRS]


def _pruned(setting: Setting, rival: Rival, tried: Sequence[FourierTrajectory]) -> Rival:
    """The pair with the forms of the other that come nearest along some motions."""
    if len(rival.others) <= NEAREST_FORMS:
        return rival
    near: dict[int, None] = {}
    for x in tried:
        rows = Rows(setting, x)
        own = rows.beside(torque_of(rival.truth, rows, rival.leaving), rival.leaving)
        near |= dict.fromkeys(left_by_forms(rows, rival, own).argsort()[:NEAREST_FORMS].tolist())
    return replace(rival, others=tuple(rival.others[k] for k in near))


def _hardly(told: Sequence[Discrimination], of_plain: Sequence[Discrimination]) -> bool:
    """Whether a plain motion, driven a tenth longer, comes as near to deciding all pairs."""
    longer = sum(min(t.reached * LONGER, 1.0) for t in of_plain)
    return sum(min(t.reached, 1.0) for t in told) <= longer


def _score(told: Sequence[Discrimination]) -> float:
    """About how many pairs are decided; and, where all or none are, how far they are from it."""
    reached = np.array([max(t.reached, 1e-12) for t in told])
    return float(np.mean(1 - np.exp(-reached)) + LOGARITHM_WEIGHT * np.mean(np.log(reached)))


def _random(
    robot: Robot, plain: FourierTrajectory, seed: int, usage: float, evaluations: int
) -> list[FourierTrajectory]:
    """Random trajectories, every joint of each with its own share of the limits."""
    count = max(4, round(_RANDOM_SHARE * evaluations))
    drawn = random_trajectory(
        robot, seed, count=count, fill=True, usage=usage, harmonics=plain.harmonics,
        duration=plain.duration, ramp=plain.ramp,
    )  # fmt: skip
    generator = torch.Generator().manual_seed(seed)
    share = SLOWEST ** (torch.rand(count, robot.n, generator=generator, dtype=torch.float64) ** 2)
    mixed = drawn.scaled(share)
    return [drawn.select(k) if k % 2 else mixed.select(k) for k in range(count)]


def _search(
    start: FourierTrajectory,
    limits: MotionLimits,
    score: Callable[[FourierTrajectory], float],
    hardly: Callable[[FourierTrajectory], bool],
    seed: int,
    evaluations: int,
    progress: Progress | None,
) -> FourierTrajectory:
    """CMA-ES on the score; the start competes too. It stops half-way if the best hardly beats a
    plain motion."""
    n = start.n
    reach = 0.9 * limits.half_range
    size = torch.linalg.vector_norm(start.coefficients, dim=-1, keepdim=True).clamp(min=1e-12)
    shape = (start.coefficients / size * start.harmonics**0.5).flatten()
    place = torch.atanh(((start.q0 - limits.middle) / reach).clamp(-0.95, 0.95))
    first = torch.cat([shape, place, torch.full((n,), _FULL, dtype=torch.float64)])

    def trajectory(x: Tensor) -> FourierTrajectory:
        a, b = x[: -2 * n].reshape(n, -1).chunk(2, -1)
        q0 = limits.middle + reach * torch.tanh(x[-2 * n : -n])
        raw = replace(start, a=a, b=b, q0=q0)
        share = torch.exp(math.log(SLOWEST) * torch.sigmoid(x[-n:]))
        return raw.scaled(largest_scale(raw, limits) * share)

    best, highest, done = start, score(start), round(_RANDOM_SHARE * evaluations)
    options = {"seed": seed + 1, "popsize": POPULATION, "verbose": -9, "CMA_diagonal": True}
    asks_halfway = True
    search = cma.CMAEvolutionStrategy(first.numpy(), _SPREAD, options)
    while done < evaluations and not search.stop():
        asked = search.ask()
        costs = []
        for x in asked:
            candidate = trajectory(torch.from_numpy(np.asarray(x)))
            value = score(candidate)
            costs.append(-value)
            if value > highest:
                best, highest = candidate, value
        search.tell(asked, costs)
        done += len(asked)
        if progress is not None:
            progress(min(done, evaluations), evaluations)
        if asks_halfway and 2 * done >= evaluations:
            asks_halfway = False
            if hardly(best):
                break
    return best
