"""What a diagnosis of commands and positions answers."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Self

import msgspec
import torch
from msgspec import UNSET

from torchid.effects.servo import ServoEffect
from torchid.position.data import GAP, PositionData
from torchid.position.judge import closed_share
from torchid.position.model import ServoArm
from torchid.position.nominal import NominalServo
from torchid.position.record import (
    AccuracyRecord,
    ChangeRecord,
    EffectRecord,
    HeldOutRecord,
    HowFarRecord,
    JointRecord,
    KnownRecord,
    MotionRecord,
    NominalRecord,
    PositionRecord,
    RegimeRecord,
    ServosRecord,
    WhereRecord,
)
from torchid.position.repeats import PositionNoise
from torchid.results.answer import Answer, Cause, Diagnosis, JointError, NotTestable
from torchid.results.answer import Size as AnswerSize
from torchid.results.record import Rows
from torchid.results.replication import Replication
from torchid.simulation.servo import INDEX, Servos
from torchid.statistics.criteria import LIKELY, UNLIKELY
from torchid.statistics.proportion import HALF_95
from torchid.typing import Bool, Float, Tensor

MOST = 0.9
"""Share of a gap that its causes close [1]."""


@dataclass(frozen=True)
class Size:
    """One number of an effect on one joint.

    Attributes:
        name, unit: of the parameter.
        value: fitted.
        interval: 95 %: motions as clusters, and no less than noise allows.
    """

    name: str
    unit: str
    value: float
    interval: tuple[float, float]

    @property
    def std(self) -> float | None:
        """Of the interval, as if it were a normal variable's; None where it has no end."""
        half = (self.interval[1] - self.interval[0]) / 2
        return half / HALF_95 if math.isfinite(half) else None


@dataclass(frozen=True)
class PositionFinding:
    """One effect on one joint.

    Attributes:
        effect, family: names.
        joint: counted from 1; None for a plane or a load, which all joints feel.
        sizes: its numbers.
        error_without: position error of the joint (of all joints, for those) in windows of 2 s
            when the others are fitted without it [mrad of the log's unit].
        error_with: the same with it.
        ambiguous_with: effects that do as well in its place.
        meaning, remedy: one sentence each.
        replication: whether it is the same in every motion; None of what acts at the ends of the
            travel, and of what all joints feel.
        how_sure: probability of it, or of the set with what does as well.
    """

    effect: str
    family: str
    joint: int | None
    sizes: tuple[Size, ...]
    error_without: float
    error_with: float
    ambiguous_with: tuple[str, ...]
    meaning: str
    remedy: str
    replication: Replication | None = None
    how_sure: float | None = None

    @classmethod
    def of(
        cls,
        effect: ServoEffect,
        joint: int | None,
        sizes: Sequence[Size],
        errors: tuple[float, float],
        ambiguous_with: tuple[str, ...] = (),
        replication: Replication | None = None,
        how_sure: float | None = None,
    ) -> Self:
        """Of an effect, whose errors [mrad] are without it and with it."""
        return cls(
            effect.name, effect.family, joint, tuple(sizes), *errors, ambiguous_with,
            effect.meaning, effect.remedy, replication, how_sure,
        )  # fmt: skip

    @property
    def cause(self) -> Cause:
        """As the answer has it; it closes its share of the error of its joint."""
        left = self.error_with / self.error_without if self.error_without > 0 else 1.0
        return Cause(
            effect=self.effect,
            joints=() if self.joint is None else (self.joint - 1,),
            sizes=tuple(
                AnswerSize(name=s.name, unit=s.unit, value=s.value, std=s.std) for s in self.sizes
            ),
            how_sure=self.how_sure,
            ambiguous_with=self.ambiguous_with,
            closes=1.0 - left,
            remedy=self.remedy,
        )


@dataclass(frozen=True, eq=False)
class Accuracy:
    """RMS position errors of one way to predict a log [mrad of the log's unit].

    A joint that never moves is NaN: to predict it is neither a success nor a failure.

    Attributes:
        whole: (n,) whole motions from their measured start.
        windows: (n,) windows of 2 s.
    """

    whole: Float[Tensor, " n"]
    windows: Float[Tensor, " n"]

    @property
    def mean(self) -> tuple[float, float]:
        """Of the joints that move: whole motions, and windows of 2 s."""
        return float(self.whole.nanmean()), float(self.windows.nanmean())


@dataclass(frozen=True, eq=False)
class PositionDiagnosis(Diagnosis):
    """Where command and position part, what causes it, and how far it goes.

    Attributes:
        data: the motions.
        servos: the answered model, fitted to all of them.
        findings: effects beside a plain servo, those that close most first.
        gains: (n,) kp [N m/rad] with (n, 2) its 95 % interval; NaN of joints that never move, and
            of those of which ratios alone are known.
        ratio_only: (n,) joints of which torques are known up to one factor: findings have them as
            shares of kp (`kd/kp`), and those of `servos` are one choice of many.
        commanded: the position is the command.
        plain_servo: one with gain, damping, dry friction, inertia, delay and offset, held out.
        answered: the answered model, held out.
        regimes: by regime, (n,) whole-motion errors of the plain and of the answered model, NaN
            where the joint is never in it [mrad].
        motions: names, with (m, n) whole-motion errors of the answered model [mrad].
        errors: (T, n) of the plain and of the answered model in each row, simulated less measured,
            of whole motions, held out [log's unit].
        still: joints that never move.
        warnings: one sentence each.
        seconds: that it took.
        known: by joint, which parameters were fitted, and the covariance that motions and what was
            expected before them leave, of logarithms where they are positive
            (`position.fit.absolute`).
        held_out: errors of a log that took part in nothing, mean of the joints that move: whole
            motions and windows of 2 s [mrad]; None without one.
        nominal: what the joints' servos are said to be; empty where nothing says it.
        as_given: joints that the servos of the robot's file follow; None without such servos.
        changes: the servos beside those of that file.
        not_testable: effects that the motions would not have shown.
        closed_ci95: of `closed`, by motions drawn again and blocks of 2 s of each; None where it is
            none.
        noise: what no servo closes, where repeats tell it.
        doubt: what speaks against the log, which the headline says first.
    """

    data: PositionData
    servos: Servos
    findings: tuple[PositionFinding, ...]
    gains: tuple[Float[Tensor, " n"], Float[Tensor, "n 2"]]
    ratio_only: Bool[Tensor, " n"]
    commanded: Accuracy
    plain_servo: Accuracy
    answered: Accuracy
    regimes: dict[str, tuple[Float[Tensor, " n"], Float[Tensor, " n"]]]
    motions: tuple[tuple[str, ...], Float[Tensor, "m n"]]
    errors: tuple[Float[Tensor, "T n"], Float[Tensor, "T n"]]
    still: Bool[Tensor, " n"]
    warnings: tuple[str, ...]
    seconds: float
    noise: PositionNoise
    known: tuple[tuple[tuple[str, ...], Float[Tensor, "_ _"]], ...] = ()
    held_out: tuple[float, float] | None = None
    nominal: tuple[NominalServo, ...] = ()
    as_given: Bool[Tensor, " n"] | None = None
    changes: tuple[ChangeRecord, ...] = ()
    not_testable: tuple[NotTestable, ...] = ()
    closed_ci95: tuple[float, float] | None = None
    doubt: str = ""

    @property
    def _right_as_given(self) -> bool:
        """Whether the servos of the robot's file follow on all joints."""
        return self.as_given is not None and bool((self.as_given | self.still).all())

    @property
    def closed(self) -> float:
        """Share of the plain servos' error of whole motions that the answered model takes away,
        beyond noise where repeats tell it; NaN where they leave nothing that calls for a cause."""
        if math.isnan(self._closed_in_windows) or self._right_as_given:
            return math.nan
        moves = ~self.still
        before, after = (w.whole[moves].square() for w in (self.plain_servo, self.answered))
        noise = 1e6 * (self.noise.square / self.data.scale.square())[moves]
        return float(closed_share(before, after, noise))

    @cached_property
    def _closed_in_windows(self) -> float:
        """Share of the squares of what the plain servos leave in windows, but for what calls for no
        cause, that the answered model takes away; NaN where they leave nothing."""
        floor = self.unseen.square()
        plain, answered = (way.windows.square() for way in (self.plain_servo, self.answered))
        # What windows leave alone is their starts', whose velocities are those of a few samples.
        both = torch.minimum(plain, self.plain_servo.whole.square())
        gap = (both > GAP * floor) & ~self.still
        left = (answered - floor)[gap].clamp(min=0).sum() / (plain - floor)[gap].sum()
        return 1.0 - float(left)

    @property
    def unseen(self) -> Float[Tensor, " n"]:
        """RMS errors of joints beside refitted plain servos in windows that call for no cause, or
        are noise, where repeats tell it [mrad]."""
        return 1e3 * self.noise.at_least(self.data.slight) / self.data.scale

    @property
    def _measured_noise(self) -> Float[Tensor, "n 2"]:
        """Noise of whole motions, 90 %, as repeats tell it; else NaN [mrad]."""
        return 1e3 * torch.stack([self.noise.low, self.noise.high], 1) / self.data.scale[:, None]

    @property
    def _noise_interval(self) -> Float[Tensor, "n 2"]:
        """The same; where no repeat tells it from zero to what calls for no cause [mrad]."""
        measured, unseen = self._measured_noise, self.unseen
        between = torch.stack([torch.zeros_like(unseen), unseen], 1)
        return torch.where(measured.isfinite(), measured, between)

    @property
    def status(self) -> str:
        """`no_gap` beside a plain servo; `explained`, where what is named closes most of it;
        `partly_explained`, where something else is there too; `detected_unexplained`."""
        if not self.findings:
            return "no_gap" if math.isnan(self.closed) else "detected_unexplained"
        return "partly_explained" if self._closed_in_windows < MOST else "explained"

    @cached_property
    def answer(self) -> Answer:
        """What each joint's error is, which causes close it, and what to do: errors of whole
        motions that were left out, before them those of a plain servo."""
        unseen, moves, noise = self.unseen, ~self.still, self._noise_interval
        low_noise, high_noise = noise[moves].mean(0).nan_to_num(0.0).tolist()
        given = self.answered if self._right_as_given else self.plain_servo
        before, after = given.whole, self.answered.whole
        names = self.data.robot.joint_names
        every = sorted((f.cause for f in self.findings), key=lambda c: -c.closes)
        sure = [c for c in every if c.how_sure is None or c.how_sure >= LIKELY]
        low, high = (float(x) for x in unseen[moves].aminmax()) if bool(moves.any()) else (0.0, 0.0)
        small = f"What moves a joint by less than {low:.1f} to {high:.1f} mrad could not be seen."
        return Answer(
            status=self.status,
            error="the error of the file's servos"
            if self._right_as_given
            else "a plain servo's error",
            unit="mrad",
            before=given.mean[0],
            after=self.answered.mean[0],
            noise=(low_noise, high_noise),
            noise_measured=bool(self.noise.low[moves].isfinite().all()),
            closed=None if math.isnan(self.closed) else self.closed,
            closed_ci95=None if math.isnan(self.closed) else self.closed_ci95,
            joints=tuple(
                JointError(
                    joint=j,
                    name=names[j],
                    before=float(before[j]),
                    after=float(after[j]),
                    noise=(float(noise[j, 0]), float(noise[j, 1])),
                )
                for j in range(len(names))
            ),
            causes=tuple(sure),
            suspects=tuple(c for c in every if UNLIKELY <= (c.how_sure or 0.0) < LIKELY),
            reason=small if self.status == "no_gap" else "",
            doubt=self.doubt or UNSET,
        )

    def __repr__(self) -> str:
        names = ", ".join(dict.fromkeys(f.effect for f in self.findings)) or "no gap"
        return f"PositionDiagnosis('{self.data.robot.name}', {names})"

    @cached_property
    def record(self) -> PositionRecord:
        """As the JSON has it."""
        return position_record(self)

    @property
    def corrected(self) -> ServoArm:
        """The answered model: what `replay` moves, and `write` keeps."""
        std = torch.full_like(self.servos.joint, torch.nan)
        for j, (names, covariance) in enumerate(self.known):
            std[j, [INDEX[name] for name in names]] = covariance.diagonal().sqrt()
        return ServoArm(self.data.robot, self.servos, self.data.scale, std)

    def write_corrected(self, path: str | Path) -> None:
        """Write the robot with its servos as a .yaml.

        Raises:
            TorchidError: the file cannot be written.
        """
        self.corrected.write(path)

    @property
    def effects(self) -> Rows[EffectRecord]:
        """What was found, one row an effect and joint."""
        return self.record.table


def position_record(result: PositionDiagnosis) -> PositionRecord:
    """A diagnosis as its JSON has it."""
    kp, intervals = result.gains
    noise = result._measured_noise.tolist()
    joints = tuple(
        JointRecord(
            joint=j,
            name=result.data.robot.joint_names[j],
            commanded_mrad=float(result.commanded.whole[j]),
            plain_mrad=float(result.plain_servo.whole[j]),
            answered_mrad=float(result.answered.whole[j]),
            kp=float(kp[j]),
            kp_ci95=(float(intervals[j, 0]), float(intervals[j, 1])),
            ratio_only=bool(result.ratio_only[j]),
            never_moves=bool(result.still[j]),
            unseen_mrad=float(result.unseen[j]),
            noise_mrad=(noise[j][0], noise[j][1]),
            resolution_mrad=float(1e3 * 12**0.5 * result.data.resolution[j]),
        )
        for j in range(result.servos.n)
    )
    regimes = tuple(
        RegimeRecord(joint=j, regime=name, plain_mrad=float(before), answered_mrad=float(after))
        for name, both in result.regimes.items()
        for j, (before, after) in enumerate(zip(*both, strict=True))
    )
    names, errors = result.motions
    known = tuple(
        KnownRecord(joint=j, names=told, covariance=covariance)
        for j, (told, covariance) in enumerate(result.known)
        if told
    )
    return PositionRecord(
        robot=result.data.robot.name,
        answer=result.answer,
        motions=len(names),
        status=result.status,
        where=WhereRecord(joints=joints, regimes=regimes),
        which=tuple(map(_finding, result.findings)),
        how_far=HowFarRecord(
            commanded=_accuracy(result.commanded),
            plain=_accuracy(result.plain_servo),
            answered=_accuracy(result.answered),
            closed=result.closed,
            per_motion=tuple(
                MotionRecord(motion=name, answered_mrad=row)
                for name, row in zip(names, errors, strict=True)
            ),
        ),
        servos=msgspec.convert(result.servos.record(), ServosRecord),
        log_scale=result.data.scale,
        warnings=result.warnings,
        seconds=result.seconds,
        known=known or UNSET,
        changes=result.changes or UNSET,
        not_testable=result.not_testable,
        held_out=(
            UNSET
            if result.held_out is None
            else HeldOutRecord(whole_mrad=result.held_out[0], windows_2s_mrad=result.held_out[1])
        ),
        nominal=(
            UNSET
            if not result.nominal
            else tuple(
                NominalRecord(
                    joint=j,
                    servo=servo.name,
                    values=dict(servo.values),
                    counts=math.nan if servo.counts is None else servo.counts,
                    register_units=dict(servo.units),
                )
                for j, servo in enumerate(result.nominal)
            )
        ),
    )


def _accuracy(way: Accuracy) -> AccuracyRecord:
    whole, windows = way.mean
    return AccuracyRecord(
        whole_mrad=whole,
        windows_2s_mrad=windows,
        whole_per_joint=way.whole,
        windows_per_joint=way.windows,
    )


def _finding(found: PositionFinding) -> EffectRecord:
    return EffectRecord.of(
        found,
        joints=() if found.joint is None else (found.joint - 1,),
        parameters={s.name: s.value for s in found.sizes},
        unit={s.name: s.unit for s in found.sizes},
        ci95={s.name: s.interval for s in found.sizes},
        error_without_mrad=found.error_without,
        error_with_mrad=found.error_with,
        replication=found.replication,
    )
