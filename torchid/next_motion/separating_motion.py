"""The motion that best tells explanations of a gap apart.

With r what a motion tells of a pair, relative to what decides (see `separation`), the design
maximises the mean of 1 - exp(-r), about the share of pairs that are decided, over all pairs, both
ways. Directions of friction and the like jump, so there is no gradient to follow: CMA-ES (Hansen
2016) moves what `excitation.search` does, joints' shares of their limits too, for slow motion tells
as much as fast.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from torchid.errors import TorchidError
from torchid.excitation.clearance import Clearance
from torchid.excitation.design import Designed
from torchid.excitation.fourier import FourierTrajectory, stacked
from torchid.excitation.limits import motion_limits
from torchid.excitation.restriction import AllOf
from torchid.excitation.search import LONGER, POPULATION, Evolution, Progress, search
from torchid.excitation.torque import CORRECTED, TorqueLimits
from torchid.excitation.trajectories import random_trajectory
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


@dataclass(frozen=True, eq=False, kw_only=True)
class Separation(Designed):
    """A motion and what it separates.

    Attributes:
        trajectory, warnings, torque: see `Designed`; torque by the corrected model.
        plain: what it is compared with, of the same length.
        rivals: the pairs, in order.
        with_plain, after: of each pair for the two motions.
        hopeless: rivals that no motion tried separates, not part of the design.
        kind: `ambiguity`, or `not_testable`: effects that the log could not have shown.
        notes: what is no matter of motion, sentences for the user.
    """

    plain: FourierTrajectory
    rivals: tuple[Rival, ...]
    with_plain: tuple[Discrimination, ...]
    after: tuple[Discrimination, ...]
    hopeless: tuple[Rival, ...]
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
    torque = TorqueLimits.of(setting.robot, setting.given, CORRECTED, usage)
    kept = AllOf.of(setting.robot, usage, torque, clearance)
    drawn = _random(setting.robot, plain, seed, usage, evaluations)
    plain, *tried = [kept.within(x) for x in (plain, *drawn)]
    # The plain motion and five more are tried before a pair is given up.
    first = [plain, *tried[:5]]
    seen = list(zip(*(separations(setting, rivals, x) for x in first), strict=True))
    decided = [
        k
        for k, differences in enumerate(seen)
        if max(t.difference for t in differences) > SAME_DIFFERENCE
    ]
    if not decided:
        raise TorchidError(
            "no motion settles what this diagnosis leaves open.",
            got=name_pairs(rivals) or "no rival acts on this arm",
            hint=other_means(r.truth.effect.name for r in rivals),
        )
    wanted = tuple(rivals[k] for k in decided)
    asked = [_pruned(setting, rivals[k], first) for k in _promising(decided, seen)]
    of_plain = separations(setting, asked, plain)

    def cost(batch: FourierTrajectory, pairs: Sequence[Rival]) -> Tensor:
        every = (separations(setting, pairs, batch.select(k)) for k in range(len(batch.q0)))
        return torch.tensor([-_score(differences) for differences in every], dtype=torch.float64)

    def say(done: int) -> None:
        if progress is not None:
            progress(min(done, evaluations), evaluations)

    costs = []
    for x in (plain, *tried):
        costs.append(float(kept.penalty(x)) - _score(separations(setting, asked, x)))
        say(len(costs))
    start = stacked([plain, (plain, *tried)[int(np.argmin(costs))]])
    steps = max(0, -((len(costs) - evaluations) // POPULATION))
    # The search looks at some pairs and forms; what counts is all of them.
    _, best, _ = search(
        start, motion_limits(setting.robot, usage=usage),
        lambda x: cost(x, asked), lambda x: cost(x, wanted),
        0 if all(t.reached >= 1 for t in of_plain) else steps,
        lambda done, _: say(len(costs) + POPULATION * done), kept=kept, way=Evolution,
        seed=seed, hardly=lambda x, _: _hardly(separations(setting, asked, x), of_plain),
    )  # fmt: skip
    return Separation(
        trajectory=best,
        plain=plain,
        rivals=wanted,
        with_plain=tuple(separations(setting, wanted, plain)),
        after=tuple(separations(setting, wanted, best)),
        hopeless=tuple(r for k, r in enumerate(rivals) if k not in decided),
        warnings=plain.warnings,
        torque=torque,
    )


def _promising(kept: Sequence[int], seen: Sequence[Sequence[Discrimination]]) -> list[int]:
    """Pairs that the search looks at: those that the plain motion leaves in doubt, the easiest
    first, then those that it does not, the hardest first."""

    def order(k: int) -> tuple[bool, float]:
        # 5.0: times what decides: beyond it a pair needs no more
        sure = seen[k][0].reached >= 5.0
        return sure, seen[k][0].reached if sure else -max(t.reached for t in seen[k])

    # 16: pairs that the search looks at
    return sorted(kept, key=order)[:16]


def _pruned(setting: Setting, rival: Rival, tried: Sequence[FourierTrajectory]) -> Rival:
    """The pair with the forms of the other that come nearest along some motions."""
    # Forms of the other effect that the search looks at, of each motion tried first
    nearest_forms = 2
    if len(rival.others) <= nearest_forms:
        return rival
    near: dict[int, None] = {}
    for x in tried:
        rows = Rows(setting, x)
        own = rows.beside(torque_of(rival.truth, rows, rival.leaving), rival.leaving)
        near |= dict.fromkeys(left_by_forms(rows, rival, own).argsort()[:nearest_forms].tolist())
    return replace(rival, others=tuple(rival.others[k] for k in near))


def _hardly(differences: Sequence[Discrimination], of_plain: Sequence[Discrimination]) -> bool:
    """Whether a plain motion, driven a tenth longer, comes as near to deciding all pairs."""
    longer = sum(min(t.reached * LONGER, 1.0) for t in of_plain)
    return sum(min(t.reached, 1.0) for t in differences) <= longer


def _score(differences: Sequence[Discrimination]) -> float:
    """About how many pairs are decided; and, where all or none are, how far they are from it."""
    reached = np.array([max(t.reached, 1e-12) for t in differences])
    # 0.02: weight of the mean logarithm beside the share of decided pairs
    return float(np.mean(1 - np.exp(-reached)) + 0.02 * np.mean(np.log(reached)))


def _random(
    robot: Robot, plain: FourierTrajectory, seed: int, usage: float, evaluations: int
) -> list[FourierTrajectory]:
    """Random trajectories, every joint of each with its own share of the limits."""
    # 0.2: of the evaluations, before the search
    count = max(4, round(0.2 * evaluations))
    drawn = random_trajectory(
        robot, seed, count=count, fill=True, usage=usage, harmonics=plain.harmonics,
        duration=plain.duration, ramp=plain.ramp,
    )  # fmt: skip
    generator = torch.Generator().manual_seed(seed)
    # 0.03: share of the limits that a joint uses at least
    share = 0.03 ** (torch.rand(count, robot.n, generator=generator, dtype=torch.float64) ** 2)
    mixed = drawn.scaled(share)
    return [drawn.select(k) if k % 2 else mixed.select(k) for k in range(count)]
