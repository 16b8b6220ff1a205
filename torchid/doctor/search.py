"""Which faults make the torque explainable: greedy, one clear win at a time."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from torchid.doctor.cone import MODEL
from torchid.doctor.hypothesis import Hypothesis, Judge, Score
from torchid.doctor.moves import Group, Move, all_moves, alternatives, invisible_groups, joint_sign
from torchid.doctor.push import pushed_loss
from torchid.statistics.criteria import (
    AGREEING_BLOCKS,
    CLEAR_GAIN,
    EXPLAINED,
    TIED_GAIN,
    UNEXPLAINED,
)

_LOOK = CLEAR_GAIN + 0.1
"""Moves that are not worse by more with another fit's weights are fitted properly."""


@dataclass(frozen=True, eq=False)
class FoundFault:
    """A fault whose mending explains the torque best.

    Attributes:
        move: the fault.
        before, after: (n,) held-out errors of each joint, as shares of the torque's spread.
        gain: by how much the sum of log errors fell.
        blocks: blocks of time in which it fell, and of how many.
        rivals: moves that do as well.
    """

    move: Move
    before: np.ndarray
    after: np.ndarray
    gain: float
    blocks: tuple[int, int]
    rivals: tuple[Move, ...]

    @property
    def helped(self) -> np.ndarray:
        """(n,) whether mending lowers the error of each joint."""
        # 1.1: ratio of errors from which on a fault's mending has helped a joint
        return self.before > 1.1 * self.after

    @property
    def needed(self) -> bool:
        """Whether bodies explain a joint that it helps badly without it: of what they explain
        well, the arm's own gears and friction make as much."""
        return bool(self.before[self.helped].max(initial=0.0) > EXPLAINED)


@dataclass(frozen=True)
class Search:
    """Faults that a search ended with, and the errors that they leave.

    Attributes:
        faults: in the order in which they were found.
        final: the fit with all of them mended.
        held_out: (B, n) its held-out errors.
        costs: by how much the sum of log errors rises with each move from there, in sample.
    """

    faults: tuple[FoundFault, ...]
    final: Score
    held_out: np.ndarray
    costs: tuple[tuple[float, Move], ...]

    @property
    def left(self) -> np.ndarray:
        """(n,) held-out errors with all of them mended, as shares of the torque's spread."""
        return rms(self.held_out)

    @property
    def explained(self) -> bool:
        """Whether bodies explain the torque of more than half of the joints; of torque that they do
        not, every hypothesis is as wrong, and one that wins means nothing."""
        live = np.isfinite(self.held_out).any(0)
        return bool(2 * (self.left[live] < UNEXPLAINED).sum() > live.sum())


def search(
    judge: Judge, start: Hypothesis, fixes: Collection[str] = (), *, first: bool = False
) -> Search:
    """Mend one fault after the other as long as one wins clearly on time held out.

    Half a turn of one joint may do what axes turned around do, and an axis that is not vertical any
    more has a pendulum's torque where a cable bends: another zero is said only where the log is not
    explained as well without one, nor by joints that have springs.

    Args:
        judge: of the log.
        start: the log at its word.
        fixes: names of moves that are taken where others do as well.
        first: leave out what every move would cost, where nothing can win: bodies explain the log
            so well already that no fault's mending could gain enough.
    """
    if first:
        base = judge.score(start)
        if base.loss - len(base.errors) * np.log(MODEL) < CLEAR_GAIN:
            return Search((), base, judge.held_out(start), ())
    result = _greedy(judge, start, fixes)
    zeros = [f.move for f in result.faults if f.move.kind == "zero"]
    if zeros:
        plain = _greedy(judge, start, fixes, zeros=False)
        sprung = Judge(judge.robot, judge.samples, springs=True)
        gains = (_loss(sprung.held_out(m.before)) - _loss(sprung.held_out(m.after)) for m in zeros)
        as_well = _loss(plain.held_out) < _loss(result.held_out) + CLEAR_GAIN
        return plain if as_well or min(gains) < CLEAR_GAIN else result
    return result


def _greedy(
    judge: Judge, start: Hypothesis, fixes: Collection[str], *, zeros: bool = True
) -> Search:
    now = start
    held = judge.held_out(now)
    faults: list[FoundFault] = []
    while True:
        base = judge.score(now)
        # Moves of one motion after another, whose regressors are the same.
        motions: dict[tuple, list[Move]] = {}
        for move in all_moves(judge, now):
            if zeros or move.kind != "zero":
                motions.setdefault(move.after.moved, []).append(move)
        tried = [move for moves in motions.values() for move in moves]
        judge.expect(m.after for m in tried)
        looked = []
        for m in tried:
            # Most are out of the question whatever bodies there may be.
            if (bound := judge.lower_bound(m.after) - base.loss) >= CLEAR_GAIN:
                looked.append((bound, m))
                continue
            # With the weights of the present fit, then properly where it is near that or below.
            loss = judge.score(m.after, base.fit.weights).loss
            loss = judge.score(m.after).loss if loss < base.loss + _LOOK else loss
            looked.append((loss - base.loss, m))
        costs = tuple(sorted(looked, key=lambda x: x[0]))
        best = _best(judge, held, costs, fixes)
        # 6: faults of one log at most
        if best is None or len(faults) == 6:
            merged = _turned_together(judge, start, faults, fixes)
            end = merged[-1].move.after if merged else now
            return Search(tuple(merged), judge.score(end), held, costs)
        faults.append(best[0])
        now, held = best[0].move.after, best[1]


def _turned_together(
    judge: Judge, start: Hypothesis, faults: Sequence[FoundFault], fixes: Collection[str]
) -> Sequence[FoundFault]:
    """The faults with all turned axes as one, of the fewest axes or as chosen; its rivals are the
    groups that mirrored bodies explain as well."""
    turned = [f for f in faults if f.move.kind == "joint sign"]
    if not turned or any("order" in f.move.kind or f.move.kind == "zero" for f in faults):
        return faults
    joints: Group = frozenset()
    for f in turned:
        joints = joints ^ frozenset(f.move.joints)
    groups = invisible_groups(judge.robot, faults[-1].move.after.gravity)
    first, *others = (joint_sign(judge, start, sorted(g)) for g in alternatives(joints, groups))
    chosen = next((m for m in others if m.name in fixes), first)
    rivals = tuple(m for m in (first, *others) if m is not chosen)
    gain, last = sum(f.gain for f in turned), turned[-1]
    out = [FoundFault(chosen, turned[0].before, last.after, gain, last.blocks, rivals)]
    # The others follow from there.
    for f in faults:
        if f not in turned:
            out.append(replace(f, move=replace(f.move, before=out[-1].move.after)))
    return out


def _best(
    judge: Judge, held: np.ndarray, costs: Sequence[tuple[float, Move]], fixes: Collection[str]
) -> tuple[FoundFault, np.ndarray] | None:
    # In sample too: held out alone, a short log punishes the freer of two hypotheses.
    clear = ((cost, m) for cost, m in costs if cost < -CLEAR_GAIN and _stands(judge, m))
    tried = []
    # 5: best moves that are looked at closely
    for cost, m in islice(clear, 5):
        errors = judge.held_out(m.after)
        gains = _log(held) - _log(errors)
        tried.append((_loss(errors), m, errors, gains, cost))
    if not tried:
        return None
    tried.sort(key=lambda x: x[0])
    # Of those as good, the chosen one, or one that concerns fewest joints, and of these fewest
    # signals: a mirrored arm on the ceiling moves as one on the floor does, and nobody negates
    # every joint; one that is its own mirror image moves alike with q or with tau negated.
    tied = [x for x in tried if x[0] < tried[0][0] + TIED_GAIN]
    tied.sort(key=lambda x: (x[1].name not in fixes, len(x[1].joints), x[1].changes))
    loss, move, errors, gains, cost = tied[0]
    gain = _loss(held) - loss
    agreeing, judged = int((gains > 0).sum()), int(np.isfinite(held).any(1).sum())
    if gain < CLEAR_GAIN or agreeing < AGREEING_BLOCKS * judged:
        return None
    # Nor is one told from another that is better in sample and not clearly worse held out.
    tied += [x for x in tried if x[0] < loss + CLEAR_GAIN and x[-1] < cost]
    rivals = tuple({x[1].name: x[1] for x in tied if x[1].name != move.name}.values())
    before, after = rms(held), rms(errors)
    return FoundFault(move, before, after, gain, (agreeing, judged), rivals), errors


def _stands(judge: Judge, move: Move) -> bool:
    """Whether a lag, or a sign, wins beside friction that builds up after reversals, too, and a
    coupling explains more than a push at one link does; true of all else."""
    if move.kind == "coupling":
        return judge.score(move.after).loss < pushed_loss(judge, move.before) - TIED_GAIN
    if move.kind == "lag" or move.kind.endswith("sign"):
        before, after = (judge.looped.score(h).loss for h in (move.before, move.after))
        return after < before - CLEAR_GAIN
    return True


def rms(errors: np.ndarray) -> np.ndarray:
    """RMS (n,) of errors (B, n) over the blocks in which a joint moves; 1 where it never does."""
    seen = np.isfinite(errors)
    mean = np.where(seen, errors, 0.0) ** 2
    return np.where(seen.any(0), np.sqrt(mean.sum(0) / np.maximum(seen.sum(0), 1)), 1.0)


def percent(share: float) -> str:
    """A share of a torque's spread as a log's examination says it everywhere: `56 %`, `2.3 %`."""
    return f"{100 * share:.{int(share < 0.1)}f} %"


def _loss(errors: np.ndarray) -> float:
    return float(np.log(rms(errors)).sum())


def _log(errors: np.ndarray) -> np.ndarray:
    return np.nan_to_num(np.log(errors)).sum(1)
