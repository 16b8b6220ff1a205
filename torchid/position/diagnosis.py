"""What a diagnosis of commands and positions answers."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import torch
from msgspec import UNSET, UnsetType

from torchid.effects.registry import glosses
from torchid.effects.servo import INDEX, PARAMETERS, ServoEffect
from torchid.position.data import PositionData
from torchid.position.effects import experiment_of
from torchid.position.judge import closed_share
from torchid.position.model import ServoArm
from torchid.position.nominal import NominalServo
from torchid.position.record import (
    Accuracy,
    ChangeRecord,
    HeldOutRecord,
    HowFarRecord,
    JointRecord,
    KnownRecord,
    MotionRecord,
    PositionFinding,
    PositionRecord,
    RegimeRecord,
    ServosRecord,
    WhereRecord,
    error_words,
)
from torchid.position.repeats import PositionNoise
from torchid.results.agreement import RunValue
from torchid.results.answer import (
    UNCHANGED,
    Answer,
    Diagnosis,
    JointError,
    NotTestable,
    Stopped,
)
from torchid.results.cause import LEFT_OUT, Cause, JudgedOn
from torchid.results.record import Ends, Rows, by_joint
from torchid.results.replication import agreement_of
from torchid.robot.model import error_unit
from torchid.simulation.servo import Servos
from torchid.statistics.criteria import CLEAR_EXCESS, LIKELY, MOSTLY_EXPLAINED, UNLIKELY
from torchid.typing import Bool, Float, Tensor


class Number(NamedTuple):
    """One number of an effect, fitted, with its 95 % interval, and what the robot's file has."""

    name: str
    unit: str
    value: float
    interval: tuple[float, float]
    was: float = math.nan

    def holds(self, value: float, share: float = 1.0) -> bool:
        """Whether its interval, or a share of it, holds another value."""
        low, high = (self.value + share * (end - self.value) for end in self.interval)
        return low <= value <= high


def finding_of(
    effect: ServoEffect, joint: int | None, numbers: Sequence[Number], errors: Ends, **more: Any
) -> PositionFinding:
    """Of an effect on a joint (from 0), or on all, whose errors [mrad] are without it and with it;
    with more of a finding's fields."""
    return PositionFinding(
        effect=effect.name, family=effect.family, joints=() if joint is None else (joint,),
        parameters={x.name: x.value for x in numbers}, unit={x.name: x.unit for x in numbers},
        ci95={x.name: x.interval for x in numbers},
        was={x.name: x.was for x in numbers if not math.isnan(x.was)},
        error_without=errors[0], error_with=errors[1], meaning=effect.meaning,
        **{"remedy": effect.remedy, "ambiguous_with": (), **more},
    )  # fmt: skip


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
        unanchored: those of them of which not even the file's masses or gains tell that factor.
        commanded: the position is the command.
        plain_servo: one with gain, damping, dry friction, inertia, and a usual offset and delay,
            refitted to the log and held out.
        answered: the answered model, held out.
        file: the servos of the robot's file as they are; None where it has none.
        regimes: by regime, (n,) whole-motion errors before (of `before`) and of the answered model,
            NaN where the joint is never in it [mrad].
        motions: names, with (m, n) whole-motion errors of the answered model [mrad].
        errors: (T, n) before and of the answered model in each row, simulated less measured,
            of whole motions, held out [log's unit].
        still: joints that never move.
        warnings: one sentence each.
        seconds: that it took.
        known: joint by joint which parameters were fitted, and the covariance that motions and
            what was expected before them leave, of logarithms where they are positive
            (`position.fit.absolute`).
        held_out: the servos before and the answered model, on a log that took part in nothing; None
            without one.
        judged: the data that say how far the error shrinks.
        nominal: what the joints' servos are said to be; empty where nothing says it.
        as_given: joints that the servos of the robot's file follow; None without such servos.
        changes: the servos beside those of that file.
        not_testable: effects that the motions would not have shown.
        closed_ci95: of `closed`, by motions drawn again and blocks of 2 s of each; None where it is
            none.
        noise: what no servo closes, where repeats tell it.
        doubt: what speaks against the log, which the headline says first.
        file_doubt: what speaks against the robot's file.
        stopped_after: when the search was stopped for want of time; absent of a whole one.
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
    noise: PositionNoise
    seconds: float = 0.0
    unanchored: Bool[Tensor, " n"] | None = None
    file: Accuracy | None = None
    known: tuple[KnownRecord, ...] = ()
    held_out: tuple[Accuracy, Accuracy] | None = None
    judged: JudgedOn = LEFT_OUT
    nominal: tuple[NominalServo, ...] = ()
    as_given: Bool[Tensor, " n"] | None = None
    changes: tuple[ChangeRecord, ...] = ()
    not_testable: tuple[NotTestable, ...] = ()
    closed_ci95: tuple[float, float] | None = None
    doubt: str = ""
    file_doubt: str = ""
    stopped_after: Stopped | UnsetType = UNSET

    @property
    def _right_as_given(self) -> bool:
        """Whether the servos of the robot's file follow on all joints."""
        return self.as_given is not None and bool((self.as_given | self.still).all())

    @property
    def before(self) -> Accuracy:
        """The servos of the robot's file, or plain ones where it has none."""
        return self.plain_servo if self.file is None else self.file

    @property
    def _far(self) -> tuple[Accuracy, Accuracy]:
        """The servos before and the answered model, on the data that judge."""
        return self.held_out or (self.before, self.answered)

    @property
    def closed(self) -> float:
        """Share of the error before of whole motions that the answered model takes away, beyond
        noise where repeats tell it; NaN where nothing is left that calls for a cause."""
        if math.isnan(self._closed_in_windows(*self._far)):
            return math.nan
        moves = ~self.still
        before, after = (way.whole[moves].square() for way in self._far)
        noise = 1e6 * (self.noise.square / self.data.scale.square())[moves]
        return float(closed_share(before, after, noise))

    def _closed_in_windows(self, first: Accuracy, last: Accuracy) -> float:
        """Share of the squares of what is left before in windows, but for what calls for no cause,
        that the answered model takes away; NaN where nothing is left."""
        floor = self.unseen.square()
        before, answered = (way.windows.square() for way in (first, last))
        # What windows leave alone is their starts', whose velocities are those of a few samples.
        both = torch.minimum(before, first.whole.square())
        gap = (both > CLEAR_EXCESS * floor) & ~self.still
        if self._right_as_given or not bool(gap.any()):
            return math.nan
        left = (answered - floor)[gap].clamp(min=0).sum() / (before - floor)[gap].sum()
        return 1.0 - float(left)

    @property
    def unseen(self) -> Float[Tensor, " n"]:
        """RMS errors in windows that are noise, by repeats, or call for no cause [mrad]."""
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

    @cached_property
    def _named(self) -> tuple[Cause, ...]:
        """Causes that are likely and take something away of the error of motions left out."""
        fall = (self.before.whole - self.answered.whole).nan_to_num(0.0)
        fell = self.answered.whole_mrad < UNCHANGED * self.before.whole_mrad
        every = [f.cause for f in self.findings if f.how_sure is None or f.how_sure >= LIKELY]
        falls = [float((fall[list(c.at)] if c.at else fall).max()) for c in every]
        return tuple(c for c, x in zip(every, falls, strict=True) if fell and min(c.share, x) > 0)

    @property
    def status(self) -> str:
        """`no_gap` beside the servos before; `explained`, where what is named closes most of it;
        `partly_explained`, where something else is there too, on held-out motions as well;
        `detected_unexplained`."""
        closed = self._closed_in_windows(self.before, self.answered)
        if not self._named:
            return "no_gap" if math.isnan(closed) else "detected_unexplained"
        least = min(closed, self._closed_in_windows(*self._far))
        return "partly_explained" if least < MOSTLY_EXPLAINED else "explained"

    @cached_property
    def answer(self) -> Answer:
        """What each joint's error is, which causes close it, and what to do: errors of whole
        motions, before of the file's servos, or of a plain one."""
        unseen, moves, noise = self.unseen, ~self.still, self._noise_interval
        unit = error_unit(self.data.robot)
        low_noise, high_noise = noise[moves].mean(0).nan_to_num(0.0).tolist()
        every = sorted((f.cause for f in self.findings), key=lambda c: -c.share)
        first, last = (self.judged.error(way.whole_mrad, unit) for way in self._far)
        others = JudgedOn.by_names(self.motions[0], "left out in turn")
        left_out = others.error(self.answered.whole_mrad, unit) if self.held_out else None
        low, high = (float(x) for x in unseen[moves].aminmax()) if bool(moves.any()) else (0.0, 0.0)
        small = f"What moves a joint by less than {low:.1f} to {high:.1f} {unit} could not be seen."
        plain = f"A plain servo refitted to this log errs {self.plain_servo.whole_mrad:.3g} {unit}."
        return Answer(
            status=self.status,
            error=error_words(self.file is not None),
            unit=unit,
            before=first,
            after=last,
            left_out=left_out,
            noise=(low_noise, high_noise),
            noise_measured=bool(self.noise.low[moves].isfinite().all()),
            closed=None if math.isnan(self.closed) else self.closed,
            closed_ci95=None if math.isnan(self.closed) or self.held_out else self.closed_ci95,
            joints=by_joint(
                JointError,
                name=self.data.robot.joint_names,
                before=self._far[0].whole,
                after=self._far[1].whole,
                noise=noise,
            ),
            causes=tuple(sorted(self._named, key=lambda c: -c.share)),
            suspects=tuple(
                msgspec.structs.replace(c, role="suspect", remedy=experiment_of(c.effect))
                for c in every
                if UNLIKELY <= (c.how_sure or 0.0) < LIKELY
            ),
            reason=small if self.status == "no_gap" else "" if self.file is None else plain,
            doubt=self.doubt or UNSET,
            file_doubt=self.file_doubt or UNSET,
            stopped=UNSET if self.stopped_after is UNSET else True,
        ).explained_by(glosses)

    @cached_property
    def agreement(self) -> Rows[RunValue]:
        """What each run alone wants of each effect's first number, one row each; empty of one
        run."""
        # A factor is of what was found beside a servo without the effect.
        neutral = {p.name: p.neutral for p in PARAMETERS if p.kind == "real"}
        return agreement_of(
            msgspec.structs.replace(
                f.cause, std={s.name: s.std}, file={k: x for k, x in neutral.items() if k == s.name}
            )
            for f in self.findings
            for s in f.sizes[:1]
        )

    def __repr__(self) -> str:
        names = ", ".join(dict.fromkeys(f.effect for f in self.findings)) or "no gap"
        return f"PositionDiagnosis('{self.data.robot.name}', {names})"

    @cached_property
    def record(self) -> PositionRecord:
        """As the JSON has it."""
        data, (kp, kp_ci95), (names, of_motions) = self.data, self.gains, self.motions
        joints = by_joint(
            JointRecord,
            name=data.robot.joint_names,
            commanded_mrad=self.commanded.whole,
            plain_mrad=self.plain_servo.whole,
            answered_mrad=self.answered.whole,
            file_mrad=torch.full_like(kp, torch.nan) if self.file is None else self.file.whole,
            kp=kp,
            kp_ci95=kp_ci95,
            ratio_only=self.ratio_only,
            never_moves=self.still,
            unseen_mrad=self.unseen,
            noise_mrad=self._measured_noise,
            resolution_mrad=1e3 * data.count,
        )
        regimes = (
            by_joint(
                RegimeRecord, regime=[name] * len(joints), before_mrad=before, answered_mrad=after
            )
            for name, (before, after) in self.regimes.items()
        )
        return PositionRecord(
            robot=data.robot.name,
            answer=self.answer,
            agreement=self.agreement,
            motions=len(names),
            status=self.status,
            where=WhereRecord(joints=joints, regimes=tuple(chain.from_iterable(regimes))),
            which=self.findings,
            how_far=HowFarRecord(
                commanded=self.commanded,
                plain=self.plain_servo,
                answered=self.answered,
                closed=self.closed,
                file=UNSET if self.file is None else self.file,
                per_motion=tuple(
                    MotionRecord(motion=name, answered_mrad=row)
                    for name, row in zip(names, of_motions, strict=True)
                ),
            ),
            servos=msgspec.convert(self.servos.record(), ServosRecord),
            log_scale=data.scale,
            warnings=self.warnings,
            seconds=self.seconds,
            not_testable=self.not_testable,
            known=tuple(one for one in self.known if one.names) or UNSET,
            changes=self.changes or UNSET,
            held_out=UNSET
            if self.held_out is None
            else HeldOutRecord(
                whole_mrad=self.held_out[1].whole_mrad,
                windows_2s_mrad=self.held_out[1].windows_2s_mrad,
                on=self.judged.on,
                before=self.held_out[0],
                answered=self.held_out[1],
            ),
            nominal=tuple(s.record(j) for j, s in enumerate(self.nominal)) or UNSET,
        )

    @property
    def corrected(self) -> ServoArm:
        """The answered model: what `replay` moves, and `write` keeps."""
        std = torch.full_like(self.servos.joint, torch.nan)
        for one in self.known:
            std[one.joint, [INDEX[name] for name in one.names]] = one.covariance.diagonal().sqrt()
        free = torch.zeros_like(self.still) if self.unanchored is None else self.unanchored
        joints = tuple((free & ~self.still).nonzero().flatten().tolist())
        mark = self.answer.unconfirmed
        robot = replace(self.data.robot, warnings=(mark,)) if mark else self.data.robot
        return ServoArm(robot, self.servos, self.data.scale, std, joints)

    def write_corrected(self, path: str | Path, *, rows: bool = True) -> None:
        """Write the robot with its servos as a .yaml.

        Raises:
            TorchidError: the file cannot be written.
        """
        self.corrected.write(path)

    @property
    def effects(self) -> Rows[PositionFinding]:
        """What was found, one row an effect and joint."""
        return self.record.table
