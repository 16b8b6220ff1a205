"""What a gap diagnosis leaves open as questions to a motion."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

from torchid.effects.base import JointEffect, ModelEffect
from torchid.effects.registry import (
    KINDS,
    effect_kind,
    nominal_effects,
    on_every_joint,
)
from torchid.errors import TorchidError
from torchid.excitation.fourier import FourierTrajectory
from torchid.gap.cause_records import valued
from torchid.gap.record import GapRecord
from torchid.identification.base_parameters import base_parameters
from torchid.next_motion.rows import Group, Rows, Setting
from torchid.next_motion.separation import Explanation, Rival, imitation, other_means
from torchid.results.cause import LINK, Cause
from torchid.robot.model import Robot

INERTIAL = (*(name for name, kind in KINDS.items() if kind.inertial), "all_base")
"""Names that refitted base parameters contain."""


@dataclass(frozen=True, eq=False)
class Open:
    """What a diagnosis leaves open.

    Attributes:
        kind: `ambiguity`, or `not_testable`: effects that the log could not have shown.
        setting: model and noise.
        questions: what a motion may settle: explanations, and what they must not be taken for,
            without its forms. Without a name: whether they are seen at all, in any size.
        notes: sentences for the user.
    """

    kind: str
    setting: Setting
    questions: tuple[Rival, ...]
    notes: tuple[str, ...]


def open_questions(record: GapRecord, robot: Robot, source: str) -> Open:
    """What a diagnosis leaves open.

    Args:
        record: of the diagnosis.
        robot: with the limits to keep.
        source: what the record is called in errors.

    Raises:
        TorchidError: another robot's, or nothing left open.
    """
    refuse_another(source, record.corrected, robot)
    model = replace(record.corrected, limits=robot.limits)
    asked, notes = _ambiguities(record, model)
    kind = "ambiguity"
    if not asked:
        kind, asked = "not_testable", _untestable(record, model)
    setting = _setting(record, model)
    # What is fitted anyway (a background) is known, not hidden.
    asked = [q for q in asked if q.name or q.truth.effects not in setting.fitted]
    if not asked:
        effects = [f"{e.effect} of joint {[j + 1 for j in e.joints]}" for e in record.which]
        raise TorchidError(
            f"'{source}' leaves nothing open that a motion could settle: "
            + ("every effect that a motion can bring about was testable, and every one found has "
               "one name." if not notes else "no motion settles the remainder."),
            got="; ".join([f"status {record.status}", *(effects or ["no effect found"]), *notes]),
            hint="the gap is unexplained: drive one trajectory twice, so that its noise is known"
            if record.status == "detected_unexplained" and record.noise_floor.source != "repeats"
            else None,
        )  # fmt: skip
    return Open(kind, setting, tuple(asked), tuple(notes))


def refuse_another(source: str, model: Robot, robot: Robot) -> None:
    """Raise if a diagnosis is of another robot.

    Raises:
        TorchidError: other joints or frames.
    """
    same_joints = robot.joint_types == model.joint_types
    # 1e-3: difference of joint frames [m; 1] that is rounding in a file
    if same_joints and bool((robot.frames_apart(model) < 1e-3).all()):
        return
    raise TorchidError(
        f"'{source}' is of another robot.",
        got=f"'{model.name}', {model.n} joints",
        expected=f"the kinematics of '{robot.name}', {robot.n} joints",
    )


def _ambiguities(record: GapRecord, robot: Robot) -> tuple[list[Rival], list[str]]:
    asked: list[Rival] = []
    events: dict[str, list[str]] = {}
    for entry in record.which:
        effect = entry.effect
        for other in entry.ambiguous_with:
            if other.partition(" ")[0] == effect:  # the same elsewhere
                continue
            event = next((n for n in (effect, other) if not _by_motion(n)), None)
            if event is None and effect in INERTIAL and other in INERTIAL:
                event = effect
            if event is None:
                asked.append(Rival(_truth(entry, record, robot), (), other))
            else:
                events.setdefault(event, []).append(other if event == effect else effect)
    return asked, [
        f"{event} or {', '.join(dict.fromkeys(others))} is no matter of motion; "
        f"{other_means([event])}"
        for event, others in events.items()
    ]


def _by_motion(name: str) -> bool:
    """Whether a name is of an effect that a motion of some seconds brings about."""
    return name in KINDS and KINDS[name].by_motion


def _truth(entry: Cause, record: GapRecord, robot: Robot) -> Explanation:
    """An accepted effect with its coefficients; of a link, the change of its parameters."""
    kind = effect_kind(entry.effect)
    joint = entry.joints[0] if entry.joints else 0
    if kind.name == LINK:
        before = record.model.parameters
        if before is None or robot.parameters is None:
            raise TorchidError("the diagnosis does not record the model's inertial parameters.")
        change = robot.parameters.pi[joint] - before.pi[joint]
        return Explanation((kind(joint),), tuple(change.tolist()))  # type: ignore[call-arg]
    effect, coefficients = valued(entry, robot)
    # What the file has already nothing else is taken for.
    file = [entry.file.get(c.name, 0.0) for c in effect.coefficients]
    coefficients = [x - has for x, has in zip(coefficients, file, strict=True)]
    group: Group = (effect,)
    if entry.common:
        group = tuple(type(effect).candidates(robot))
    return Explanation(group, tuple(coefficients))


def _untestable(record: GapRecord, robot: Robot) -> list[Rival]:
    """Effects that the log could not have shown, of usual shapes."""
    out: list[Rival] = []
    for entry in record.not_testable:
        kind, joint = effect_kind(entry.effect), entry.joint
        if not kind.by_motion or kind.inertial or kind.needs & {"age", "velocity"}:
            continue
        for effect in kind.candidates(robot):
            if joint is not None and effect.joints[:1] != (joint,):
                continue
            question = Rival(Explanation((effect,), (1.0,) * len(effect.coefficients)), (), "")
            if question not in out:
                out.append(question)
    return out


def _setting(record: GapRecord, robot: Robot) -> Setting:
    floor, settings = record.noise_floor, record.settings
    # Without repeats the lower bound is whatever a predictor leaves of the torque.
    noise = (floor.low * floor.high).sqrt() if floor.source == "repeats" else floor.high
    fitted: list[Group] = []
    if settings.refitted:
        fitted = [(e,) for e in on_every_joint(settings.background, robot.n)]
    for entry in record.which:
        if entry.effect != LINK and _by_motion(entry.effect):
            fitted.append(_truth(entry, record, robot).effects)
    return Setting(
        robot,
        tuple(p for p in nominal_effects(robot) if not p[0].needs & {"age", "velocity"}),
        base_parameters(robot),
        noise.clamp(min=1e-6 * float(floor.high.max())),
        record.band_hz,
        record.cutoff_hz,
        settings.refitted,
        tuple(dict.fromkeys(fitted)),
    )


def rivals(questions: Open, plain: FourierTrajectory) -> tuple[Rival, ...]:
    """Every member of every ambiguity as truth, against every other one; an alternative has the
    size with which it imitates the accepted effect on `plain`."""
    rows = Rows(questions.setting, plain)
    out: list[Rival] = []
    sets: dict[Explanation, list[str]] = {}
    for question in questions.questions:
        if question.name:
            sets.setdefault(question.truth, []).append(question.name)
        else:
            out.append(_seen(question, rows))
    for truth, names in sets.items():
        out += _among(truth, names, questions.setting.robot, rows)
    return tuple(out)


def _seen(question: Rival, rows: Rows) -> Rival:
    """The effect in its most visible coefficient, at a tenth of the torque of the joints it acts on
    or its largest plausible size."""
    effects = question.truth.effects
    columns = rows.columns(effects)
    used = list(effects[0].essential or range(columns.shape[1]))
    best = used[int(rows.beside(columns[:, used]).square().sum(0).argmax())]
    own = columns[:, best].reshape(rows.torque.shape).norm(dim=-1)
    acts = own > 1e-6 * own.max()
    size = effects[0].coefficients[best].largest
    if bool(acts.any()):
        # 0.1: torque of an effect that a log could not show, as a share of its joints' own: what is
        # asked to be seen
        size = min(size, 0.1 * float(rows.torque[acts].norm() / own[acts].norm()))
    values = [0.0] * columns.shape[1]
    values[best] = size if math.isfinite(size) else 1.0
    return replace(question, truth=Explanation(effects, tuple(values)))


def _among(
    accepted: Explanation, names: Sequence[str], robot: Robot, rows: Rows
) -> Iterator[Rival]:
    leaving = accepted.effects
    members = {accepted.effect.name: accepted}
    for name in names:
        forms = instances(LINK if name in INERTIAL else name, leaving, robot, rows)
        like = imitation(rows, accepted, forms, leaving)
        if like is not None:
            members[name] = like
    for (one, truth), other in product(members.items(), members):
        if one == other or (one in INERTIAL and other in INERTIAL):
            continue
        # A link is blamed for what base parameters could do.
        forms = () if other in INERTIAL else instances(other, truth.effects, robot, rows)
        if forms or other in INERTIAL:
            yield Rival(truth, forms, other, leaving)


def instances(name: str, like: Group, robot: Robot, rows: Rows) -> tuple[Group, ...]:
    """Places and shapes of an effect that act where another does; all of them where that acts on
    several joints."""
    kind, place = KINDS[name], rows.place(like)
    if issubclass(kind, ModelEffect):
        every = tuple(kind.candidates(robot))
        near = [(e,) for e in every if place is None or rows.place((e,)) in (None, place)]
        return (*near, every) if kind.shared else tuple(near)
    assert issubclass(kind, JointEffect)
    names = [s.name for s in kind.shapes]
    return tuple(
        (kind(j, **dict(zip(names, shapes, strict=True))),)
        for j in (range(robot.n) if place is None else (place,))
        for shapes in kind.grid(rows.motions, j, rows.cutoff).tolist()
    )
