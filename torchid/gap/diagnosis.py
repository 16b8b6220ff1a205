"""The answer: where the gap lies, which effects cause it, how far it shrinks."""

import csv
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from msgspec import UNSET

from torchid.design.columns import Columns, Model
from torchid.design.segments import EDGE, NEVER, Samples, Segment
from torchid.effects.base import Coefficient, Effect, Motion
from torchid.effects.names import PLACES
from torchid.effects.registry import Valued
from torchid.files import atomic_write
from torchid.gap.record import (
    Budget,
    Experiment,
    FarRecord,
    FoundEffect,
    GapRecord,
    JointFit,
    JointGap,
    JointRms,
    Known,
    KnownCoefficient,
    NoiseFloor,
    Parametric,
    RegimeGap,
    Residual,
    Status,
    UnnamedEffect,
    Where,
)
from torchid.gap.settings import GapSettings
from torchid.json_data import plain
from torchid.notebooks import data_frame
from torchid.results.agreement import RunValue
from torchid.results.answer import Answer, Diagnosis, JointError, NotTestable
from torchid.results.friction import FrictionLaw
from torchid.results.record import Rows, by_joint
from torchid.results.replication import Replication, agreement_of
from torchid.results.words import count, effect_words, joints_words, listed
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import JointType, Robot, torque_unit
from torchid.robot.writer import write_robot
from torchid.simulators.nearest_fields import NearestFields, nearest_fields
from torchid.typing import Bool, Float, Int, Tensor

if TYPE_CHECKING:
    from pandas import DataFrame

    from torchid.next_motion.separating_motion import Separation

UNLIKE = 0.5
"""Share of the torque's variance on joints that move, beyond which it does not follow the model as
given [1]."""

FOREIGN = "Most of this torque does not follow the model."
ALIEN = "This torque does not follow the model at all."

INERTIA_MEANING = "The link's mass, centre of mass or inertia differs from the model's."
INERTIA_REMEDY = (
    "Replace the link's inertial parameters, or all of them by those `torchid identify` finds."
)


def unit_of(unit: str, joints: Iterable[int], robot: Robot) -> str:
    """A coefficient's unit on these joints: that of revolute ones unless all are prismatic."""
    kinds = {robot.joint_types[j] for j in joints}
    return Coefficient("", unit, False, "").unit_for(kinds == {JointType.PRISMATIC})


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
        """Of all traces, instant by instant."""
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
class Finding:
    """An accepted effect.

    Attributes:
        effect, values: which, and its coefficients; of an effect common to all joints, that of the
            first.
        joints: from 0; of a global effect those whose torque it changes beyond noise.
        ambiguous_with: names of effects the data do not separate it from.
        std: block-robust standard deviations of the coefficients.
        p_value: family-wise, by the test that judged it.
        how_sure: probability of it, against nothing and against what it cannot be told from; of a
            set that of the set.
        changed: coefficients that the model knew otherwise; none of an effect that is new.
        replication: whether it is the same in every motion.
        branch_sure: probability that a cause of its branch is there at its place, whichever it is.
        one_of_a_set: whether it is the likeliest of a set none of which is likely by itself.
        share: of the error that it takes away, the mean over all orders in which causes may join
            (`torchid.gap.search.shares`), so that the shares add up to that of the answered model.
        alone: share of the error that it takes away by itself.
        removes: (n,) what it takes away of each joint's error [N m; N]; they add up, too.
        notes: sentences, e.g. a coefficient that is not determined.
        common: whether one coefficient is common to all joints.
        main: number of the coefficient that makes most of its torque in these logs.
    """

    effect: Effect
    values: tuple[float, ...]
    joints: tuple[int, ...]
    ambiguous_with: tuple[str, ...]
    std: tuple[float, ...]
    p_value: float
    how_sure: float
    share: float
    alone: float
    removes: tuple[float, ...]
    notes: tuple[str, ...] = ()
    common: bool = False
    main: int = 0
    one_of_a_set: bool = False
    branch_sure: float | None = None
    changed: tuple[KnownCoefficient, ...] = ()
    replication: Replication | None = None

    @property
    def located(self) -> tuple[int, ...]:
        """Joints that the effect is at, from 0; none where it belongs to the whole arm."""
        return () if self.common else self.effect.joints

    @property
    def valued(self) -> Valued:
        """Effect and coefficients, for a model."""
        return self.effect, list(self.values)

    def record(self, robot: Robot) -> FoundEffect:
        """As the JSON has it."""
        effect = self.effect
        # Coefficients, shapes and places of the effect; private keys are the program's own.
        own = {
            key: value
            for key, value in effect.record(self.values).items()
            if key not in ("effect", "joint", "joints") and key[0] != "_"
        }
        # A unit follows the joints that the effect is at.
        located = self.located or self.joints
        units = {c.name: unit_of(c.unit, located, robot) for c in effect.coefficients}
        units |= {s.name: unit_of(s.unit, located, robot) for s in effect.shapes}
        return FoundEffect.of(
            self,
            effect,
            effect=effect.name,
            parameters=plain(own),
            std=plain(dict(zip((c.name for c in effect.coefficients), self.std, strict=True))),
            unit=units,
            shape=[name for name in own if name in {x.name for x in effect.shapes}],
            places=[name for name in own if name in PLACES],
            main=effect.coefficients[self.main].name,
        )


@dataclass(frozen=True)
class HowFar:
    """RMS over all joints in the band of the report, each joint divided by nothing: N m (or N).

    Attributes:
        rms_before, rms_after: (n,) on data used for no choice, while the joint moves: at rest, and
            where it may stick, friction can be anything.
        closed: share of the error beyond noise that is closed (see
            `torchid.gap.validate.closing`); None where the gap's interval holds zero.
        closed_ci95: what it may be on other motions, where the log has three different ones or
            more: of resampled motions and blocks of them; else of resampled blocks.
    """

    rms_before: Float[Tensor, " n"]
    rms_after: Float[Tensor, " n"]
    closed: float | None
    closed_ci95: tuple[float, float] | None

    @property
    def less(self) -> float:
        """Share of the error that is gone, whatever of it is noise; none where it grows."""
        return max(0.0, float(1 - self.rms_after.norm() / self.rms_before.norm()))


def body_change(before: InertialParameters, after: InertialParameters) -> str:
    """What to set of a link: its mass, centre of mass and inertia, before and after; of numbers
    without a mass the first moment, and the inertia about the link's frame."""
    heavy = min(float(before.mass), float(after.mass)) > 0
    mass, centre, inertia = (
        " -> ".join(words)
        for words in zip(*(_body_words(body, heavy) for body in (before, after)), strict=True)
    )
    where, about = ("centre of mass", "it") if heavy else ("first moment", "the link's frame")
    return (
        f"Set the link's mass {mass} kg, its {where} {centre} {'m' if heavy else 'kg m'}, its "
        f"inertia about {about} (xx, yy, zz) {inertia} kg m²."
    )


def _body_words(body: InertialParameters, heavy: bool) -> tuple[str, str, str]:
    """Mass, centre of mass or first moment, and inertia about that or the link's frame."""
    centre = body.com if heavy else body.first_moment
    inertia = body.inertia_about_com if heavy else body.inertia_about_link_frame
    parts = (centre, inertia[[0, 3, 5]])
    centre_words, inertia_words = (f"({', '.join(f'{v:.3g}' for v in x.tolist())})" for x in parts)
    return f"{float(body.mass):.3g}", centre_words, inertia_words


def _link(changed: Parametric) -> FoundEffect:
    """Changed inertial parameters as an accepted effect; a link has the number of its joint."""
    return FoundEffect.of(
        changed,
        effect="link_inertia",
        family="inertia",
        branch="inertia",
        joints=changed.links,
        located=changed.links,
        parameters={"links": [link + 1 for link in changed.links]},
        std={},
        unit={},
        shape=(),
        places=(),
        meaning=INERTIA_MEANING,
        remedy=changed.change or INERTIA_REMEDY,
    )


@dataclass(frozen=True)
class TorqueDiagnosis(Diagnosis):
    """A diagnosis of logs with torques.

    Attributes:
        robot: the model as given (with fitted parameters, where it had none).
        corrected: the robot with accepted effects and corrected parameters.
        status: the verdict.
        joints, regimes: where.
        findings, parametric: which.
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
        joint_fits: what is told with the covariance of all its coefficients, then what cannot be
            told from it.
        residual: what is left of each joint's torque on data it was not fitted on.
        small: effects that are there and below what was asked for.
        suspects: the likeliest causes that are not sure enough to be named, the likeliest first.
        knowledge: what was known of the model before, and what this log adds.
        doubt: what speaks against the log, which the headline says first.
    """

    robot: Robot
    corrected: Robot
    status: Status
    joints: tuple[JointGap, ...]
    regimes: tuple[RegimeGap, ...]
    findings: tuple[Finding, ...]
    parametric: tuple[Parametric, ...]
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
    joint_fits: tuple[JointFit, ...] = ()
    residual: tuple[Residual, ...] = ()
    small: tuple[UnnamedEffect, ...] = ()
    suspects: tuple[UnnamedEffect, ...] = ()
    knowledge: Known | None = None
    doubt: str = ""

    def __repr__(self) -> str:
        effects = ", ".join(f.effect.name for f in self.findings) or "no effects"
        closed = (
            "" if self.how_far.closed is None else f", {100 * self.how_far.closed:.0f} % closed"
        )
        return f"Diagnosis('{self.robot.name}', {self.status}: {effects}{closed})"

    @cached_property
    def which(self) -> tuple[FoundEffect, ...]:
        """Accepted effects, then links whose inertial parameters changed, as the JSON has them."""
        links = (_link(p) for p in self.parametric if p.links)
        return (*(f.record(self.robot) for f in self.findings), *links)

    @cached_property
    def agreement(self) -> Rows[RunValue]:
        """What each run alone wants of each cause, one row each; empty of one run."""
        every: Sequence[FoundEffect | UnnamedEffect]
        every = (*self.which, *self.small, *self.suspects)
        return agreement_of((e.cause, e.replication) for e in every)

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
        if not segments or not self.findings:
            return ()
        columns = Columns(Model.of(self.corrected), Samples(segments, self.band))
        return (*nearest_fields(columns, "mjcf"), *nearest_fields(columns, "urdf"))

    @cached_property
    def answer(self) -> Answer:
        """What each joint's error is, which causes close it, and what to do."""
        far, floor, robot = self.how_far, self.floor, self.robot
        # All base parameters stand in the JSON's `parametric` alone.
        bodies = (_link(p) for p in self.parametric if not p.links)
        causes = [f.cause for f in (*self.which, *bodies)]
        return Answer(
            status=self.status,
            error="the gap",
            unit=torque_unit(robot),
            before=float(far.rms_before.norm()),
            after=float(far.rms_after.norm()),
            noise=floor.total,
            closed=far.closed,
            closed_ci95=far.closed_ci95,
            noise_measured=floor.source == "repeats",
            joints=by_joint(
                JointError,
                name=robot.joint_names,
                before=far.rms_before,
                after=far.rms_after,
                noise=floor.ends,
            ),
            causes=tuple(sorted(causes, key=lambda c: -c.closes)),
            unnamed=sum((e.share for e in self.suspects if not math.isnan(e.share)), 0.0),
            friction=tuple(law.brief for law in self.friction),
            suspects=tuple(e.cause for e in self.suspects),
            small=tuple(e.cause for e in self.small),
            reason=self._reason,
            doubt=self.doubt or self._foreign or UNSET,
        )

    @property
    def _reason(self) -> str:
        """Why nothing is named; empty where something is, or where there is no more to say."""
        if self.findings or self.parametric:
            return ""
        hiding = [j for j in self.knowledge.joints if j.hides] if self.knowledge else []
        if self.status == "negligible":
            small = (f"{effect_words(e.effect)} of {joints_words(e.joints)}" for e in self.small)
            return f"Small: {listed(small, most=2)}."
        if self.status == "not_testable" and hiding:
            where = listed(str(j.joint + 1) for j in hiding)
            return f"the model was not sure enough of joint {where}, where a cause can hide."
        if self.status == "not_testable":
            why = self.not_testable[0].reason if self.not_testable else "it holds too little motion"
            return f"{why.rstrip('.')}."
        if self.status == "no_gap" and self.not_testable:
            return f"{count(len(self.not_testable), 'effect')} could not have been seen in it."
        return ""

    @property
    def _foreign(self) -> str:
        """That the torque is another one than the model's, where nothing is named; else empty."""
        named = bool(self.findings or self.parametric)
        if self.status != "detected_unexplained" or named or not self.traces:
            return ""
        alien = bool(alien_joints(self.traces).any())
        return ALIEN if alien else FOREIGN if is_foreign(self.traces) else ""

    def write_corrected(self, path: str | Path) -> None:
        """Write the corrected robot with its effects as a .yaml.

        Raises:
            TorchidError: the file cannot be written.
        """
        write_robot(self.corrected, path)

    @property
    def over_time(self) -> TorqueOverTime:
        """Measured torque, the model's as given and corrected, of all that was judged."""
        return TorqueOverTime.of(self.traces)

    @property
    def effects(self) -> Rows[FoundEffect]:
        """What was found, as a table."""
        return self.record.effects

    def next_motion(self, robot: Robot | None = None, **settings: Any) -> "Separation":
        """The motion that separates what this diagnosis cannot tell apart; see `excite_for`."""
        return self.record.next_motion(robot, **settings)
