"""What a gap diagnosis leaves open (schema torchid.gap/1), as pairs to be separated by a motion."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import product
from pathlib import Path
from typing import Any

import torch

from torchid.effects.base import Effect, JointEffect, ModelEffect, Motion, Shape
from torchid.effects.registry import (
    KINDS,
    Valued,
    effect_from_record,
    model_torque,
    nominal_effects,
)
from torchid.errors import TorchidError
from torchid.excitation.fourier import FourierTrajectory
from torchid.excitation.separation import RATE, Rival, Setting, imitation
from torchid.identification.base_parameters import base_parameters
from torchid.robot.model import Robot
from torchid.robot.record import recorded_robot

SCHEMA = "torchid.gap/1"

INERTIAL = ("link_inertia", "payload", "all_base")
"""Names that refitted base parameters contain."""

EVENTS = ("contact", "dropped_samples", "saturation", "thermal_friction_drift")
"""Effects that a motion of some seconds does not bring about."""

DETECTABLE = 42.0
"""D at the smallest detectable size that a diagnosis reports: twice 1.3 times chi^2's quantile for
400 tests at 1 %."""

MOST = 16
"""Untestable effects that one motion is designed for."""

PLAUSIBLE = 0.02
"""Share of the largest plausible coefficient that stands for an effect that the log did not excite
at all."""


@dataclass(frozen=True, eq=False)
class Open:
    """What a diagnosis leaves open.

    Attributes:
        kind: `ambiguity`, or `not_testable`: effects that the log could not have shown.
        setting: model and noise.
        pairs: named, whose rivals `rivals` makes.
        notes: sentences for the user.
    """

    kind: str
    setting: Setting
    pairs: tuple[tuple[Valued, str], ...]
    notes: tuple[str, ...]


def read_open(path: Path, data: Mapping[str, Any], robot: Robot | None) -> Open:
    """What the diagnosis in a file leaves open.

    Args:
        path: for errors. data: its content.
        robot: with the limits to keep; its own record if None.

    Raises:
        TorchidError: an incomplete file, or nothing left open.
    """
    model = recorded_robot(data, str(path), "corrected")
    if model is None:
        raise TorchidError(
            f"'{path}' does not hold the corrected model.",
            hint="write it again: torchid gap ROBOT LOG... --json FILE",
        )
    if robot is not None:
        if robot.n != model.n:
            raise TorchidError(
                f"'{path}' is of another robot.", got=f"{model.n} joints", expected=robot.n
            )
        model = replace(model, limits=robot.limits)
    try:
        pairs, notes = _ambiguities(data, model)
        kind = "ambiguity"
        if not pairs:
            kind, pairs = "not_testable", _untestable(data, model)
        setting = _setting(data, model)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise TorchidError(
            f"'{path}' is not a complete diagnosis.", got=f"{type(error).__name__}: {error}"
        ) from error
    if not pairs:
        raise TorchidError(
            f"'{path}' leaves nothing open that a motion could settle: every effect has one name, "
            "and every effect that a motion can bring about was testable.",
            got=f"status {data['status']}" + "".join(f"; {note}" for note in notes),
        )
    return Open(kind, setting, tuple(pairs), tuple(notes))


def rivals(found: Open, plain: FourierTrajectory) -> tuple[Rival, ...]:
    """Pairs both ways; the rival's own size is that with which it imitates the truth on `plain`."""
    out = []
    for truth, name in found.pairs:
        if not name or name in INERTIAL:
            out.append(Rival(truth, (), name))
            continue
        others = instances(name, truth[0].joints, found.setting, plain)
        if not others:
            continue
        out.append(Rival(truth, others, name))
        back = imitation(found.setting, truth, others, plain)
        if back is not None:
            own = instances(truth[0].name, truth[0].joints, found.setting, plain)
            out.append(Rival(back, (truth[0], *own), truth[0].name))
    return tuple(out)


def instances(
    name: str, joints: Sequence[int], setting: Setting, plain: FourierTrajectory
) -> tuple[Effect, ...]:
    """Shapes of an effect on the first of the joints, or its places on the arm."""
    kind = KINDS[name]
    if issubclass(kind, ModelEffect):
        every = kind.candidates(setting.robot)
        return tuple(e for e in every if not joints or not e.joints or e.joints[0] == joints[0])
    if not issubclass(kind, JointEffect) or not joints:
        return ()
    sampled = plain.sample(RATE)
    motion = Motion(*sampled.motion.state, t=sampled.t)
    torque = model_torque(setting.robot, setting.given, motion)
    grids = [_grid(s, motion, torque[:, joints[0]].abs(), joints[0]) for s in kind.shapes]
    names = [s.name for s in kind.shapes]
    return tuple(kind(joints[0], **dict(zip(names, v, strict=True))) for v in product(*grids))


def _grid(shape: Shape, motion: Motion, torque: torch.Tensor, joint: int) -> list[float]:
    q, dq = motion.q[:, joint], motion.dq[:, joint].abs()
    travel = max(1e-9, float(q.max() - q.min()))
    if not shape.grid:  # wave numbers, half a period apart over the travel
        return [math.pi / travel * k for k in range(3, 40)]
    size = {
        "one": 1.0,
        "travel": travel,
        "speed": float(torch.quantile(dq, 0.99)),
        "torque": float(torch.quantile(torque, 0.99)),
    }[shape.scale]
    return [v * max(1e-9, size) for v in shape.grid]


def _ambiguities(
    data: Mapping[str, Any], robot: Robot
) -> tuple[list[tuple[Valued, str]], list[str]]:
    pairs: list[tuple[Valued, str]] = []
    notes = []
    for entry in data["which"]:
        effect = str(entry["effect"])
        for other in entry["ambiguous_with"]:
            if effect in INERTIAL:
                notes.append(f"{effect} and {other}: no motion weighs a link; compare with CAD")
            elif effect in EVENTS or other in EVENTS or other not in (*KINDS, *INERTIAL):
                notes.append(f"{effect} and {other}: not a matter of motion")
            else:
                pairs.append((_truth(entry, robot), str(other)))
    return pairs, notes


def _truth(entry: Mapping[str, Any], robot: Robot) -> Valued:
    kind = KINDS[str(entry["effect"])]
    own = {f.name for f in fields(kind)} | {c.name for c in kind.coefficients}
    place = {"joint": int(entry["joints"][0])} if "joint" in own else {}
    values = {k: v for k, v in entry["parameters"].items() if k in own}
    return effect_from_record({"effect": kind.name, **place, **values}, robot)


def _untestable(data: Mapping[str, Any], robot: Robot) -> list[tuple[Valued, str]]:
    """Effects of the smallest size that the log would have shown, or, of those that it did not
    excite, of a plausible one."""
    out: list[tuple[Valued, str]] = []
    for entry in data["not_testable"]:
        kind, joint = KINDS[str(entry["effect"])], entry["joint"]
        if kind.name in (*EVENTS, *INERTIAL) or kind.needs & {"age", "velocity"}:
            continue
        effect = _some(kind, None if joint is None else int(joint) - 1, robot)
        if effect is None:
            continue
        size = entry["smallest_detectable"]
        if size is None:
            largest = kind.coefficients[0].largest
            size = PLAUSIBLE * largest if math.isfinite(largest) else 1.0
        out.append(((effect, [float(size)] + [0.0] * (len(kind.coefficients) - 1)), ""))
    return out[:MOST]


def _some(kind: type[Effect], joint: int | None, robot: Robot) -> Effect | None:
    """An effect of a kind at a place, shapes in the middle of their grids."""
    if issubclass(kind, ModelEffect):
        every = kind.candidates(robot)
        return next((e for e in every if joint is None or e.joints[:1] == (joint,)), None)
    if joint is None or not issubclass(kind, JointEffect):
        return None
    shapes = {s.name: s.grid[len(s.grid) // 2] if s.grid else 10.0 for s in kind.shapes}
    return kind(joint, **shapes)


def _setting(data: Mapping[str, Any], robot: Robot) -> Setting:
    floor = data["noise_floor"]
    low, high = (torch.tensor(floor[key], dtype=torch.float64) for key in ("low", "high"))
    given = tuple(p for p in nominal_effects(robot) if not p[0].needs & {"age", "velocity"})
    return Setting(
        robot,
        given,
        base_parameters(robot),
        (low * high).sqrt().clamp(min=1e-6 * float(high.max())),
        float(data["band_hz"]),
        float(data["cutoff_hz"]),
    )
