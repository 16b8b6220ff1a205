"""What a gap diagnosis leaves open (schema torchid.gap/1), as questions to a motion."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import torch

from torchid.effects.base import Effect, ModelEffect
from torchid.effects.registry import COLUMN_KINDS, KINDS, effect_from_record, nominal_effects
from torchid.errors import TorchidError
from torchid.identification.base_parameters import base_parameters
from torchid.next_motion.rows import Group, Setting
from torchid.next_motion.separation import Explanation, beyond
from torchid.robot.model import Robot
from torchid.robot.record import recorded_robot

SCHEMA = "torchid.gap/1"

LINK = "link_inertia"
INERTIAL = (*(name for name, kind in KINDS.items() if kind.inertial), "all_base")
"""Names that refitted base parameters contain."""

SAME_FRAMES = 1e-3
"""Difference of joint frames [m; 1] that is rounding in a file."""


@dataclass(frozen=True)
class Question:
    """An explanation, and the effect it must not be taken for; an empty name: whether it is seen at
    all, values then being of no account."""

    truth: Explanation
    other: str


@dataclass(frozen=True, eq=False)
class Open:
    """What a diagnosis leaves open.

    Attributes:
        kind: `ambiguity`, or `not_testable`: effects that the log could not have shown.
        setting: model and noise.
        questions: what a motion may settle.
        notes: sentences for the user.
    """

    kind: str
    setting: Setting
    questions: tuple[Question, ...]
    notes: tuple[str, ...]


def read_open(path: Path, data: Mapping[str, Any], robot: Robot | None) -> Open:
    """What the diagnosis in a file leaves open.

    Args:
        path: for errors. data: its content.
        robot: with the limits to keep; its own record if None.

    Raises:
        TorchidError: an incomplete file, another robot's, or nothing left open.
    """
    again = "write it again: torchid gap ROBOT LOG... --json FILE"
    model = recorded_robot(data, str(path), "corrected")
    if model is None:
        raise TorchidError(f"'{path}' does not hold the corrected model.", hint=again)
    if robot is not None:
        _refuse_another(path, model, robot)
        model = replace(model, limits=robot.limits)
    try:
        asked, notes = _ambiguities(data, model)
        kind = "ambiguity"
        if not asked:
            kind, asked = "not_testable", _untestable(data, model)
        setting = _setting(data, model)
        # What is fitted anyway (a background) is known, not hidden.
        asked = [q for q in asked if q.other or q.truth.effects not in setting.fitted]
        found = [f"{e['effect']} of joint {e['joints']}" for e in data["which"]]
        status = str(data["status"])
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise TorchidError(
            f"'{path}' is not a complete diagnosis.",
            got=f"{type(error).__name__}: {error}",
            hint=again,
        ) from error
    if not asked:
        raise TorchidError(
            f"'{path}' leaves nothing open that a motion could settle: "
            + ("every effect that a motion can bring about was testable, and every one found has "
               "one name." if not notes else "what is left is no matter of motion."),
            got="; ".join([f"status {status}", *(found or ["no effect found"]), *notes]),
            hint=_unexplained(status),
        )  # fmt: skip
    return Open(kind, setting, tuple(asked), tuple(notes))


def _unexplained(status: str) -> str | None:
    if status != "detected_unexplained":
        return None
    return "the gap is unexplained: drive one trajectory twice, so that its noise is known"


def _refuse_another(path: Path, model: Robot, robot: Robot) -> None:
    same_joints = robot.joint_types == model.joint_types
    if same_joints and bool((robot.frames_apart(model) < SAME_FRAMES).all()):
        return
    raise TorchidError(
        f"'{path}' is of another robot.",
        got=f"'{model.name}', {model.n} joints",
        expected=f"the kinematics of '{robot.name}', {robot.n} joints",
    )


def _ambiguities(data: Mapping[str, Any], robot: Robot) -> tuple[list[Question], list[str]]:
    asked: list[Question] = []
    events: dict[str, list[str]] = {}
    for entry in data["which"]:
        effect = str(entry["effect"])
        for other in map(str, entry["ambiguous_with"]):
            event = next((n for n in (effect, other) if not _by_motion(n)), None)
            if event is None and effect in INERTIAL and other in INERTIAL:
                event = effect
            if event is None:
                asked.append(Question(_truth(entry, data, robot), other))
            else:
                events.setdefault(event, []).append(other if event == effect else effect)
    return asked, [
        f"{event} or {', '.join(dict.fromkeys(others))} is no matter of motion; {beyond([event])}"
        for event, others in events.items()
    ]


def _by_motion(name: str) -> bool:
    """Whether a name is of an effect that a motion of some seconds brings about."""
    return name in KINDS and KINDS[name].by_motion


def _truth(entry: Mapping[str, Any], data: Mapping[str, Any], robot: Robot) -> Explanation:
    """An accepted effect with its coefficients; of a link, the change of its parameters."""
    kind = KINDS[str(entry["effect"])]
    joint = int(entry["joints"][0])
    if kind.name == LINK:
        before = recorded_robot(data, "model")
        if before is None or before.parameters is None or robot.parameters is None:
            raise ValueError("no inertial parameters of the model")
        change = robot.parameters.pi[joint - 1] - before.parameters.pi[joint - 1]
        return Explanation((kind(joint - 1),), tuple(change.tolist()))  # type: ignore[call-arg]
    own = {f.name for f in fields(kind)} | {c.name for c in kind.coefficients}
    place = {"joint": joint} if "joint" in own else {}
    values = {k: v for k, v in entry["parameters"].items() if k in own}
    effect, coefficients = effect_from_record({"effect": kind.name, **place, **values}, robot)
    return Explanation(_group(entry, effect, robot), tuple(coefficients))


def _group(entry: Mapping[str, Any], effect: Effect, robot: Robot) -> Group:
    """The effect, or the same one on every joint where it is common to all."""
    if entry.get("common") and isinstance(effect, ModelEffect):
        return tuple(type(effect).candidates(robot))
    return (effect,)


def _untestable(data: Mapping[str, Any], robot: Robot) -> list[Question]:
    """Effects that the log could not have shown, of usual shapes."""
    out: list[Question] = []
    for entry in data["not_testable"]:
        kind, joint = KINDS[str(entry["effect"])], entry["joint"]
        if not kind.by_motion or kind.inertial or kind.needs & {"age", "velocity"}:
            continue
        effects: Sequence[Effect]
        if issubclass(kind, ModelEffect):
            places = kind.candidates(robot)
            effects = [e for e in places if joint is None or e.joints[:1] == (int(joint) - 1,)]
        else:
            effects = [] if joint is None else [kind.exemplar(int(joint) - 1)]
        for effect in effects:
            question = Question(Explanation((effect,), (1.0,) * len(effect.coefficients)), "")
            if question not in out:
                out.append(question)
    return out


def _setting(data: Mapping[str, Any], robot: Robot) -> Setting:
    floor, settings = data["noise_floor"], data["settings"]
    low, high = (torch.tensor(floor[key], dtype=torch.float64) for key in ("low", "high"))
    # Without repeats the lower bound is whatever a predictor can foretell of the torque.
    noise = (low * high).sqrt() if floor.get("source") == "repeats" else high
    background = tuple(settings.get("background") or ())
    free = bool(settings.get("refitted", settings.get("parameters") == "free" or background))
    fitted: list[Group] = [
        (COLUMN_KINDS[name](j),) for name in background for j in range(robot.n) if free
    ]
    for entry in data["which"]:
        if entry["effect"] != LINK and _by_motion(entry["effect"]):
            fitted.append(_truth(entry, data, robot).effects)
    return Setting(
        robot,
        tuple(p for p in nominal_effects(robot) if not p[0].needs & {"age", "velocity"}),
        base_parameters(robot),
        noise.clamp(min=1e-6 * float(high.max())),
        float(data["band_hz"]),
        float(data["cutoff_hz"]),
        free,
        tuple(dict.fromkeys(fitted)),
    )
