"""Is the corrected model a better simulator? Short simulations from many instants of the log.

Both models start from measured positions and velocities, are driven by the measured torque, and are
compared with the measured positions a while later (multiple shooting; Bock and Plitt 1984). Replay
of torque in open loop drifts whatever the model, since nothing corrects an error once made; so
horizons are short, errors saturate, and what counts is the ratio of two models from the same
starts. Neighbouring rollouts share data: intervals come from whole blocks of them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch

from torchid.design.segments import Segment
from torchid.effects.registry import model_torque, nominal_effects
from torchid.results.record import Col, Part, Real
from torchid.results.words import percent
from torchid.robot.model import Robot
from torchid.simulation.controller import Controller
from torchid.simulation.open_loop import Held, rollout
from torchid.simulation.shooting import Starts, Windows, edge_of, starts_of, windows_of
from torchid.statistics.resampling import DRAWS, bootstrap_weights, tails
from torchid.typing import Float, Int, Tensor

HORIZONS = (0.1, 0.5, 2.0)

SHOWN_S = 6.0
"""Length of the motion that is shown [s]."""

CONTROLLER = Controller()
"""That holds both models to the arm in the motion that is shown."""

DIVERGED = 1.0
"""Position error of a joint at which a rollout has lost the arm [rad or m]. Larger ones count as
this, so that one runaway does not decide a mean."""

SHRANK = 0.9
"""Ratio of torque RMS below which the torque gap is said to have shrunk."""

_LONGEST_STEP = 4e-3  # of the simulation [s]
_FEWEST_BLOCKS = 5  # for an interval
_LOST = 0.5  # share of rollouts that diverge above which a horizon says little


class TorqueGap(Part, frozen=True):
    """RMS of the torque gap of both models (n,), and after to before."""

    rms_before: Float[Tensor, " n"]
    rms_after: Float[Tensor, " n"]
    ratio: Real


class Horizon(Part, frozen=True, kw_only=True):
    """Position errors after some time of simulation; null where nothing is long enough.

    Attributes:
        horizon_s: [s].
        starts: how many simulations.
        rms_before, rms_after: (n,) of the position error [rad; m].
        joint_ratio, joint_ratio_ci95: after to before, a joint.
        ratio, ratio_ci95: over all joints.
        diverged_before, diverged_after: shares of simulations that lost the arm.
    """

    horizon_s: Annotated[float, Col("horizon", "g", "s")]
    starts: int
    rms_before: Float[Tensor, " n"] | None = None
    rms_after: Float[Tensor, " n"] | None = None
    joint_ratio: tuple[float | None, ...] | None = None
    joint_ratio_ci95: tuple[tuple[float, float] | None, ...] | None = None
    ratio: Annotated[float | None, Col("ratio [95 %]", spread="ratio_ci95")] = None
    ratio_ci95: tuple[float, float] | None = None
    diverged_before: Annotated[Real, Col("lost before", words=percent)] = math.nan
    diverged_after: Annotated[Real, Col("lost after", words=percent)] = math.nan


class Rollout(Part, frozen=True, kw_only=True):
    """Position errors of two models, simulated with the measured torque.

    Attributes:
        starts, step_s, diverged_beyond: number of rollouts, their step [s], and the error at which
            one counts as diverged [rad; m].
        torque: of the same passages.
        horizons: in ascending order.
        ignored_effects: names of effects that a replay of measured torque cannot have.
        fitted_on_these_data: whether the model after was fitted on the same passages.
        sentences: what to know about it.
    """

    starts: int
    step_s: float | None
    diverged_beyond: float
    torque: TorqueGap
    horizons: tuple[Horizon, ...]
    ignored_effects: tuple[str, ...]
    fitted_on_these_data: bool
    sentences: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class SimulatedMotion:
    """Joint positions of the arm and of both models, which have the measured torque under a
    controller that holds them to the arm.

    Attributes:
        name: of the trajectory.
        t: (T,) from the trajectory's first sample on [s].
        measured, before, after: (T, n) positions [rad; m]; NaN where a model has lost the arm.
    """

    name: str
    t: Float[Tensor, " T"]
    measured: Float[Tensor, "T n"]
    before: Float[Tensor, "T n"]
    after: Float[Tensor, "T n"]


def rollouts(
    before: Robot,
    after: Robot,
    passages: Sequence[Segment],
    horizons: Sequence[float] = HORIZONS,
    seed: int = 0,
    max_starts: int = 128,
    fitted_here: bool = False,
) -> tuple[Rollout, tuple[SimulatedMotion, ...]]:
    """Position errors of two models, simulated from measured states with the measured torque.

    Args:
        before, after: models with parameters; their nominal effects count.
        passages: all on the same rate.
        horizons: how long to simulate [s], ascending.
        seed: of the starts and of the bootstrap.
        max_starts: how many rollouts; they run as one batch.
        fitted_here: whether the model after was fitted on these passages.

    Returns:
        The errors, and of each passage the stretch in which the arm moves most, under a controller.

    Raises:
        RobotError: a model has no parameters, or an effect that does not exist.
    """
    starts = starts_of(passages, min(horizons), max_starts, seed)
    torque, step, rows, ignored = _torque_gap(before, after, passages), None, [], list[str]()
    motions: tuple[SimulatedMotion, ...] = ()
    said = ["No trajectory is long enough for a rollout."]
    if len(starts.first):
        windows = windows_of(passages, starts, max(horizons))
        runs = [_simulated(robot, windows) for robot in (before, after)]
        # Saturated; what is not a number has diverged.
        offs = [(q - windows.q).abs() for q, _ in runs]
        errors = [torch.where(off < DIVERGED, off, DIVERGED) for off in offs]
        rows = [_at(h, windows, errors, before, seed) for h in horizons]
        motions = _motions(before, after, passages)
        ignored = sorted({name for _, names in runs for name in names})
        step, said = windows.dt, _sentences(torque, rows, ignored, fitted_here)
    replayed = Rollout(
        starts=len(starts.first),
        step_s=step,
        diverged_beyond=DIVERGED,
        torque=torque,
        horizons=tuple(rows),
        ignored_effects=tuple(ignored),
        fitted_on_these_data=fitted_here,
        sentences=tuple(said),
    )
    return replayed, motions


def _motions(
    before: Robot, after: Robot, passages: Sequence[Segment]
) -> tuple[SimulatedMotion, ...]:
    """Of each passage the stretch in which the arm moves most, with one controller for both models:
    what is wrong stands out where it is, and is not lost in what it led to."""
    first, length, passage = [], [], []
    for k, p in enumerate(passages):
        edge = edge_of(p)
        count = min(round(SHOWN_S * p.rate), p.length - 2 * edge - 1)
        if count < p.rate / 4:
            continue
        far = p.motion.dq.square().sum(1).cumsum(0)
        room = torch.arange(edge, p.length - edge - count)
        first.append(int(room[(far[room + count] - far[room]).argmax()]))
        length.append(count)
        passage.append(k)
    if not first:
        return ()
    starts = Starts(*map(torch.tensor, (passage, first, length)))
    windows = windows_of(passages, starts, SHOWN_S)
    gains = CONTROLLER.gains(before, windows.q)
    held = Held(gains, windows.q, windows.dq)
    runs = [_simulated(robot, windows, held)[0] for robot in (before, after)]
    lost = [~((q - windows.q).abs() < DIVERGED) for q in runs]
    shown = [q.masked_fill(gone, math.nan) for q, gone in zip(runs, lost, strict=True)]
    out = []
    for w, k in enumerate(passage):
        rows = slice(0, int(windows.steps[w]) + 1)
        begun = windows.t0[w] - float(passages[k].motion.require("t", "a rollout")[0])
        t = begun + windows.dt * torch.arange(windows.q.shape[1], dtype=begun.dtype)
        signals = (x[w, rows] for x in (windows.q, *shown))
        out.append(SimulatedMotion(passages[k].name, t[rows], *signals))
    return tuple(out)


def _simulated(
    robot: Robot, windows: Windows, held: Held | None = None
) -> tuple[Float[Tensor, "B T n"], Sequence[str]]:
    """Positions at the samples, and names of effects left out."""
    q0, dq0, dt = windows.q[:, 0], windows.dq[:, 0], windows.dt
    run = rollout(
        robot, (), q0, dq0, windows.tau, dt, windows.t0, held=held, longest_step=_LONGEST_STEP
    )
    return run.q, run.ignored


def _at(
    horizon: float,
    windows: Windows,
    errors: Sequence[Float[Tensor, "B T n"]],
    robot: Robot,
    seed: int,
) -> Horizon:
    """Errors of both models at one horizon."""
    step = max(1, round(horizon / windows.dt))
    use = windows.steps >= step
    if not use.any():
        return Horizon(horizon_s=horizon, starts=0)
    final = [e[use, step] for e in errors]
    lost = [(e[use, : step + 1] >= DIVERGED).any(-1).any(-1) for e in errors]
    moved = windows.q[use, step] - windows.q[use, 0]
    rms = [e.square().mean(0).sqrt() for e in final]
    block = windows.blocks(horizon, use)
    alone = _ratio([e.square() for e in final], block, seed)
    scaled = [(e / _scale(robot, moved)).square().sum(-1, keepdim=True) for e in final]
    whole = _ratio(scaled, block, seed)
    return Horizon(
        horizon_s=horizon,
        starts=int(use.sum()),
        rms_before=rms[0],
        rms_after=rms[1],
        joint_ratio=tuple(ratio for ratio, _ in alone),
        joint_ratio_ci95=tuple(interval for _, interval in alone),
        ratio=whole[0][0],
        ratio_ci95=whole[0][1],
        diverged_before=float(lost[0].double().mean()),
        diverged_after=float(lost[1].double().mean()),
    )


def _scale(robot: Robot, moved: Float[Tensor, "b n"]) -> Float[Tensor, " n"]:
    """What makes radians and metres comparable: how far joints of each kind move in this time."""
    if len(set(robot.joint_types)) == 1:
        return torch.ones(robot.n, dtype=moved.dtype)
    kinds = list(robot.joint_types)
    size = {
        kind: moved[:, [k is kind for k in kinds]].square().mean().sqrt().clamp(min=1e-12)
        for kind in set(kinds)
    }
    return torch.stack([size[kind] for kind in kinds])


def _ratio(
    squares: Sequence[Float[Tensor, "b c"]], block: Int[Tensor, " b"], seed: int
) -> list[tuple[float | None, tuple[float, float] | None]]:
    """Root of the ratio of sums of squares, second to first, a column, with the 2.5 % and 97.5 %
    quantiles over resampled blocks."""
    blocks = int(block.max()) + 1
    sums = [x.new_zeros(blocks, x.shape[1]).index_add_(0, block, x) for x in squares]
    many = torch.from_numpy(bootstrap_weights(blocks, DRAWS, np.random.default_rng(seed)))
    first, second = (torch.cat([x.sum(0, keepdim=True), many @ x]) for x in sums)
    ratios = (second / first).sqrt()
    same = (first == 0) & (second == 0)
    ratios[same] = 1.0
    out: list[tuple[float | None, tuple[float, float] | None]] = []
    for column in ratios.T:
        value = float(column[0]) if bool(column[0].isfinite()) else None
        ends = None
        if blocks >= _FEWEST_BLOCKS and bool(column.isfinite().all()):
            low, high = column[1:].quantile(column.new_tensor(tails())).tolist()
            ends = low, high
        out.append((value, ends))
    return out


def _torque_gap(before: Robot, after: Robot, passages: Sequence[Segment]) -> TorqueGap:
    """RMS of measured minus modelled torque (n) of both models, edges left out."""
    rms = []
    for robot in (before, after):
        effects, squares, count = nominal_effects(robot), torch.zeros(robot.n).double(), 0
        for p in passages:
            edge = edge_of(p)
            gap = (p.tau - model_torque(robot, effects, p.motion))[edge : p.length - edge]
            squares = squares + gap.square().sum(0)
            count += len(gap)
        rms.append((squares / max(1, count)).sqrt())
    total = [float(x.norm()) for x in rms]
    ratio = total[1] / total[0] if total[0] else 1.0 if not total[1] else math.inf
    return TorqueGap(rms[0], rms[1], ratio)


def _sentences(
    torque: TorqueGap,
    rows: Sequence[Horizon],
    ignored: Sequence[str],
    fitted_here: bool,
) -> list[str]:
    out = []
    for row in rows:
        horizon = f"{row.horizon_s:g} s"
        if not row.starts:
            out.append(f"No trajectory is long enough for a rollout of {horizon}.")
            continue
        if _disagrees(torque.ratio, row):
            low_high = row.ratio_ci95
            within = f" ({low_high[0]:.2f} to {low_high[1]:.2f})" if low_high else ""
            out.append(
                f"Torque and rollouts disagree: the torque gap shrank to {torque.ratio:.2f} of "
                f"what it was, the position error after {horizon} did not: {row.ratio:.2f}"
                f"{within}."
            )
        if row.diverged_after > _LOST:
            out.append(
                f"{row.diverged_after:.0%} of the rollouts of {horizon} lose the arm even with "
                "the corrected model: replay of torque in open loop says little at that horizon."
            )
    if ignored:
        names = ", ".join(name.replace("_", " ") for name in ignored)
        out.append(f"Rollouts are without {names}: a replay of torque cannot have them.")
    if fitted_here:
        out.append("The corrected model was also fitted to these runs: the numbers are optimistic.")
    return out


def _disagrees(torque_ratio: float, row: Horizon) -> bool:
    """Not where both models lose the arm mostly: then their errors are those of a replay."""
    if not torque_ratio < SHRANK or row.ratio is None:
        return False
    if min(row.diverged_before, row.diverged_after) > _LOST:
        return False
    highest = row.ratio_ci95[1] if row.ratio_ci95 else row.ratio
    return bool(highest >= 1)
