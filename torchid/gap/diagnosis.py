"""The answer: where the gap lies, which effects cause it, how far it shrinks."""

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from msgspec import UNSET, UnsetType

from torchid.design.columns import Columns, Model
from torchid.design.segments import EDGE, NEVER, Samples, Segment
from torchid.effects.base import Motion
from torchid.effects.registry import glosses
from torchid.files import atomic_write
from torchid.gap.record import (
    Budget,
    Covariance,
    Experiment,
    FarRecord,
    GapRecord,
    JointGap,
    JointRms,
    Known,
    NoiseFloor,
    RegimeGap,
    Residual,
    Status,
    Where,
)
from torchid.gap.rows import LogRows, write_with_rows
from torchid.gap.settings import GapSettings
from torchid.notebooks import data_frame
from torchid.results.agreement import RunValue
from torchid.results.answer import Answer, Diagnosis, JointError, NotTestable, Stopped
from torchid.results.cause import LEFT_OUT, LINK, Cause, Error, JudgedOn
from torchid.results.friction import FrictionLaw
from torchid.results.record import Rows, by_joint
from torchid.results.replication import agreement_of
from torchid.results.words import count, effect_words, joints_words, listed
from torchid.robot.model import Robot, torque_unit
from torchid.simulators.nearest_fields import NearestFields, nearest_fields
from torchid.typing import Bool, Float, Int, Tensor

if TYPE_CHECKING:
    from pandas import DataFrame

    from torchid.next_motion.separating_motion import Separation

UNLIKE = 0.5
"""Share of the torque's variance on joints that move, beyond which it does not follow the model as
given [1]."""


@dataclass(frozen=True)
class Trace:
    """One trajectory's torque in the band of the report, before and after, none of it fitted on
    this trajectory (or block).

    Attributes:
        name: of the trajectory.
        rate: [Hz].
        motion: q, dq, ddq, t.
        measured, before, after: (T, n) torque [N m; N]: measured; of the model as given; of the
            model with the accepted effects, selected and fitted on other trajectories or blocks.
        valid: (T,) instants that count (edges and gaps between blocks do not).
        moving: (T, n) instants at which each joint moves, and does not reverse where the noise is
            known: only those count for how far the gap closes. None: all.
        stamp: of the first instant in the log itself [s]; the motion's time runs on from one
            trajectory to the next.
    """

    name: str
    rate: float
    motion: Motion
    measured: Float[Tensor, "T n"]
    before: Float[Tensor, "T n"]
    after: Float[Tensor, "T n"]
    valid: Bool[Tensor, " T"]
    moving: Bool[Tensor, "T n"] | None = None
    stamp: float = 0.0

    @property
    def counting(self) -> Bool[Tensor, "T n"]:
        """Instants of each joint that count for how far the gap closes."""
        every = self.valid.unsqueeze(1).expand_as(self.measured)
        return every if self.moving is None else every & self.moving


@dataclass(frozen=True, eq=False)
class TorqueOverTime:
    """Torque of the logs that were judged, one row an instant and joint, in the band of the report.

    Attributes:
        t: (R,) time in the log [s].
        log: (R,) name of the trajectory.
        joint: (R,) from 0; from 1 in frames and files.
        measured, as_given, corrected: (R,) torque [N m; N]: measured; of the model as given; of the
            model with what was found, fitted without this instant.
        counts: (R,) whether the row counts for how far the gap closes.
    """

    t: Float[np.ndarray, " R"]
    log: np.ndarray
    joint: Int[np.ndarray, " R"]
    measured: Float[np.ndarray, " R"]
    as_given: Float[np.ndarray, " R"]
    corrected: Float[np.ndarray, " R"]
    counts: Bool[np.ndarray, " R"]

    @classmethod
    def of(cls, traces: Sequence[Trace]) -> "TorqueOverTime":
        """Rows of all traces, instant by instant."""
        n = traces[0].measured.shape[1]
        times = [t.motion.require("t", "a trace") for t in traces]
        since = [x - x[0] + trace.stamp for x, trace in zip(times, traces, strict=True)]
        values = ([t.measured, t.before, t.after, t.counting] for t in traces)
        torques = (torch.cat(x).flatten().numpy() for x in zip(*values, strict=True))
        return cls(
            torch.cat(since).repeat_interleave(n).numpy(),
            np.repeat([t.name for t in traces], [t.measured.numel() for t in traces]),
            np.tile(np.arange(n), sum(map(len, times))),
            *torques,
        )

    def columns(self) -> dict[str, np.ndarray]:
        """The arrays by name; joints from 1."""
        return {f.name: getattr(self, f.name) for f in fields(self)} | {"joint": self.joint + 1}

    def to_frame(self) -> "DataFrame":
        """The columns as a pandas DataFrame.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        return data_frame()(self.columns())

    def to_csv(self, path: str | Path) -> None:
        """Write the columns, whole or not at all.

        Raises:
            TorchidError: the file cannot be written.
        """
        with atomic_write(Path(path)) as file:
            rows = csv.writer(file, lineterminator="\n")
            rows.writerow(self.columns())
            rows.writerows(zip(*(x.tolist() for x in self.columns().values()), strict=True))


def is_foreign(traces: Sequence[Trace]) -> bool:
    """Whether most of the torque of the joints that move does not follow the model as given: then
    a gap without a known cause is no noise."""
    moves, torque, gap, _ = _judged(traces)
    share = gap.square().mean(0) / torque.var(0, correction=0)
    return bool(share[moves].clamp(max=1).mean() > UNLIKE)  # of none NaN, which is not


def alien_joints(traces: Sequence[Trace]) -> Bool[Tensor, " n"]:
    """Joints (n,) that move, beside whose torque the model as given is worse than none, and the
    corrected one hardly better, where these are most of those that move; else none. The log may be
    of another robot: nothing that is found there is a cause."""
    moves, *torques = _judged(traces)
    torque, given, corrected = (x.square().mean(0) for x in torques)
    alien = moves & (given > torque) & (corrected > UNLIKE * torque)
    return alien & (2 * alien.sum() > moves.sum())


def worse_than_none(traces: Sequence[Trace]) -> bool:
    """Whether beside the torque of most joints that move the model as given is worse than none."""
    moves, *torques = _judged(traces)
    torque, given, _ = (x.square().mean(0) for x in torques)
    return bool(2 * (moves & (given > torque)).sum() > moves.sum())


def _judged(traces: Sequence[Trace]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Joints (n,) that move; torque (N, n) that is valid, and what the model as given and the
    corrected one leave of it."""
    q = torch.cat([t.motion.q for t in traces])
    valid = [[x[t.valid] for x in (t.measured, t.before, t.after)] for t in traces]
    torque, given, corrected = (torch.cat(x) for x in zip(*valid, strict=True))
    return q.amax(0) - q.amin(0) > NEVER, torque, torque - given, torque - corrected


@dataclass(frozen=True)
class HowFar:
    """RMS over all joints in the band of the report, each joint divided by nothing: N m (or N).

    Attributes:
        rms_before, rms_after: (n,) on data used for no choice, while the joint moves: at rest, and
            where it may stick, friction can be anything.
        closed: share of the error beyond noise that is closed (see
            `torchid.gap.describe.closing`); None where the gap's interval holds zero.
        closed_ci95: what it may be on other motions, where the log has three different ones or
            more: of resampled motions and blocks of them; else of resampled blocks.
        judged: the data.
        left_out: the same on motions left out in turn, where others were held out.
    """

    rms_before: Float[Tensor, " n"]
    rms_after: Float[Tensor, " n"]
    closed: float | None
    closed_ci95: tuple[float, float] | None
    judged: JudgedOn = field(default=LEFT_OUT, kw_only=True)
    left_out: "HowFar | None" = field(default=None, kw_only=True)

    @property
    def less(self) -> float:
        """Share of the error that is gone, whatever of it is noise; none where it grows."""
        return max(0.0, float(1 - self.rms_after.norm() / self.rms_before.norm()))

    def after(self, unit: str) -> Error:
        """The whole error after, on the data that judge it."""
        return self.judged.error(float(self.rms_after.norm()), unit)


@dataclass(frozen=True)
class TorqueDiagnosis(Diagnosis):
    """A diagnosis of logs with torques.

    Attributes:
        robot: the model as given (with fitted parameters, where it had none).
        corrected: the robot with accepted effects and corrected parameters.
        status: the verdict.
        joints, regimes: where.
        causes: that have a name, the largest share first: effects, links whose inertial parameters
            changed, and all base parameters.
        how_far, budget: how far.
        floor: noise in the band of the report.
        not_testable: effects these data cannot show, with the smallest size that could be seen.
        next_experiment: what would separate an ambiguity, or None.
        traces: held-out torque before and after, trajectory by trajectory.
        band, cutoff: of the report and of the fit [Hz].
        settings: how it was searched.
        refitted: whether base parameters were fitted with everything.
        warnings: sentences for the user.
        friction: the law of each joint that has friction, in the model or found.
        covariance: of the coefficients of all causes that last; None where nothing was fitted.
        residual: what is left of each joint's torque on data it was not fitted on.
        small: effects that are there and below what was asked for.
        suspects: the likeliest causes that are not sure enough to be named, the likeliest first.
        knowledge: what was known of the model before, and what this log adds.
        remainder: what is left on the worst joint, on data it was not fitted on, that is
            unexplained, or at least more than noise may be; empty where nothing is.
        doubt: what speaks against the log, which the headline says first.
        since: the earlier log that causes are held against; absent without one.
        stopped_after: when the search was stopped for want of time; absent of a whole one.
        rows: the log, as a file beside the corrected model's holds it.
    """

    robot: Robot
    corrected: Robot
    status: Status
    joints: tuple[JointGap, ...]
    regimes: tuple[RegimeGap, ...]
    causes: tuple[Cause, ...]
    how_far: HowFar
    budget: Budget
    floor: NoiseFloor
    not_testable: tuple[NotTestable, ...]
    next_experiment: Experiment | None
    traces: tuple[Trace, ...]
    band: float
    cutoff: float
    settings: GapSettings
    refitted: bool
    warnings: tuple[str, ...]
    friction: Rows[FrictionLaw] = field(default_factory=Rows)
    covariance: Covariance | None = None
    residual: tuple[Residual, ...] = ()
    small: tuple[Cause, ...] = ()
    suspects: tuple[Cause, ...] = ()
    knowledge: Known | None = None
    remainder: str = ""
    doubt: str = ""
    since: str | UnsetType = UNSET
    stopped_after: Stopped | UnsetType = UNSET
    rows: LogRows | None = None

    def __repr__(self) -> str:
        effects = ", ".join(c.effect for c in self.which) or "no effects"
        closed = (
            "" if self.how_far.closed is None else f", {100 * self.how_far.closed:.0f} % closed"
        )
        return f"Diagnosis('{self.robot.name}', {self.status}: {effects}{closed})"

    @property
    def which(self) -> tuple[Cause, ...]:
        """Effects and links, as the JSON has them."""
        return tuple(c for c in self.causes if c.effect != LINK or c.at)

    @cached_property
    def agreement(self) -> Rows[RunValue]:
        """What each run alone wants of each cause, one row each; empty of one run."""
        return agreement_of((*self.causes, *self.small, *self.suspects))

    @cached_property
    def record(self) -> GapRecord:
        """As the JSON has it."""
        far, floor = self.how_far, self.floor
        return GapRecord.of(
            self,
            robot=self.robot.name,
            where=Where(self.joints, self.regimes),
            how_far=FarRecord.of(
                far,
                rms_before=far.rms_before.norm(),
                rms_after=far.rms_after.norm(),
                noise_floor_rms=floor.total,
                on=far.judged.on,
                how=far.judged.how,
                per_joint=by_joint(
                    JointRms,
                    before=far.rms_before,
                    after=far.rms_after,
                    noise_floor_rms=floor.ends,
                ),
            ),
            noise_floor=floor,
            trajectories=tuple(t.name for t in self.traces),
            band_hz=self.band,
            cutoff_hz=self.cutoff,
            settings={**vars(self.settings), "refitted": self.refitted},
            model=self.robot,
        )

    @cached_property
    def nearest_fields(self) -> tuple[NearestFields, ...]:
        """What MJCF and URDF say of effects that they have no field for, along this log."""
        segments = [
            Segment(t.name, t.rate, self.band, t.motion, t.measured, own_velocity=False)
            for t in self.traces
            if len(t.valid) > 3 * EDGE * t.rate / self.band and t.rate == self.traces[0].rate
        ]
        if not segments or not self.which:
            return ()
        columns = Columns(Model.of(self.corrected), Samples(segments, self.band))
        return (*nearest_fields(columns, "mjcf"), *nearest_fields(columns, "urdf"))

    @cached_property
    def answer(self) -> Answer:
        """What each joint's error is, which causes close it, and what to do."""
        far, floor, unit = self.how_far, self.floor, torque_unit(self.robot)
        return Answer(
            status=self.status,
            error="the gap",
            unit=unit,
            before=far.judged.error(float(far.rms_before.norm()), unit),
            after=far.after(unit),
            left_out=None if far.left_out is None else far.left_out.after(unit),
            noise=floor.total,
            closed=far.closed,
            closed_ci95=far.closed_ci95,
            noise_measured=floor.source == "repeats",
            joints=by_joint(
                JointError,
                name=self.robot.joint_names,
                before=far.rms_before,
                after=far.rms_after,
                noise=floor.ends,
            ),
            causes=self.causes,
            unnamed=sum((c.share for c in self.suspects if not math.isnan(c.share)), 0.0),
            friction=tuple(law.brief for law in self.friction),
            suspects=self.suspects,
            small=self.small,
            reason=self._reason,
            unexplained=(self.status == "detected_unexplained" and self.remainder) or UNSET,
            doubt=self.doubt or UNSET,
            since=self.since,
            stopped=UNSET if self.stopped_after is UNSET else True,
        ).explained_by(glosses)

    @property
    def _reason(self) -> str:
        """Why nothing is named; empty where something is, or where there is no more to say."""
        if self.causes:
            return ""
        if self.since:
            left = f": {self.remainder}" if self.status == "negligible" and self.remainder else ""
            return f"Nothing is new since {self.since}{left}."
        hiding = [j for j in self.knowledge.joints if j.hides] if self.knowledge else []
        if self.status == "negligible":
            small = [f"{effect_words(e.effect)} of {joints_words(e.joints)}" for e in self.small]
            most = f"More than noise may be, at most: {self.remainder}."
            return f"Small: {listed(small, most=2)}." if small else most
        if self.status == "not_testable" and hiding:
            where = listed(str(j.joint + 1) for j in hiding)
            return f"the model was not sure enough of joint {where}, where a cause can hide."
        if self.status == "not_testable":
            why = self.not_testable[0].reason if self.not_testable else "it holds too little motion"
            return f"{why.rstrip('.')}."
        if self.status == "no_gap" and self.not_testable:
            return f"{count(len(self.not_testable), 'effect')} could not have been seen in it."
        return ""

    def write_corrected(self, path: str | Path, *, rows: bool = True) -> None:
        """Write the corrected robot with its effects as a .yaml, and beside it, as .rows.npz, the
        log, so that a later one can be held against it.

        Args:
            path: of the .yaml.
            rows: whether the log is kept; its motion may be private.

        Raises:
            TorchidError: a file cannot be written.
        """
        write_with_rows(self.corrected, self.rows if rows else None, Path(path))

    @property
    def over_time(self) -> TorqueOverTime:
        """Measured torque, the model's as given and corrected, of all that was judged."""
        return TorqueOverTime.of(self.traces)

    @property
    def effects(self) -> Rows[Cause]:
        """What was found, as a table."""
        return self.record.effects

    def next_motion(self, robot: Robot | None = None, **settings: Any) -> "Separation":
        """The motion that separates what this diagnosis cannot tell apart; see `excite_for`."""
        return self.record.next_motion(robot, **settings)
