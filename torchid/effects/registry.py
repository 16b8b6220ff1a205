"""The library of effects: the kinds of its modules, in the order of `names`."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

from torch import Tensor

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects import (
    backlash,
    bearing,
    coupling,
    file_mistakes,
    friction,
    friction_laws,
    gravity,
    hysteresis,
    inertia,
    periodic,
    phase,
    spring,
    surroundings,
    transient,
)
from torchid.effects.base import Effect, JointEffect, Motion
from torchid.effects.inertia import BodyEffect
from torchid.effects.names import NAMES, PLACES, require_effects
from torchid.effects.servo import SERVO_KINDS, ServoEffect
from torchid.errors import RobotError, TorchidError
from torchid.robot.model import Robot
from torchid.robot.yaml_values import number
from torchid.typing import Joints

_MODULES = (
    backlash, bearing, coupling, file_mistakes, friction, friction_laws, gravity, hysteresis,
    inertia, periodic, phase, spring, surroundings, transient,
)  # fmt: skip
_NAMED: dict[str, type[Effect]] = {
    kind.name: kind
    for module in _MODULES
    for kind in vars(module).values()
    if isinstance(kind, type) and issubclass(kind, Effect) and hasattr(kind, "name")
}
KINDS = {name: _NAMED[name] for name in NAMES}

FAMILIES: dict[str, str] = {name: kind.family for name, kind in KINDS.items()}

COLUMN_KINDS: dict[str, type[JointEffect]] = {
    name: kind
    for name, kind in KINDS.items()
    if issubclass(kind, JointEffect) and not (kind.shapes or kind.needs or kind.memory)
}
"""Effects whose columns depend on the present motion alone: those that identification fits."""


EVENTS = tuple(name for name, kind in KINDS.items() if kind.event)
"""Effects that happened once in one log, and are no property of the arm."""

Valued = tuple[Effect, list[float]]
"""An effect and its coefficients."""


def glosses(names: Iterable[str]) -> dict[str, str]:
    """What names of effects say that are not everybody's."""
    kinds: dict[str, type[Effect] | ServoEffect] = {**SERVO_KINDS, **KINDS}
    every = ((name, kinds[name].gloss) for name in dict.fromkeys(names) if name in kinds)
    return {name: gloss for name, gloss in every if gloss}


def effect_kind(name: str) -> type[Effect]:
    """The class of an effect by name, or a TorchidError that lists those that exist."""
    require_effects([name], KINDS)
    return KINDS[name]


def column_kind(name: str) -> type[JointEffect]:
    """The class of an effect that identification can fit, or a TorchidError that lists those."""
    if name in KINDS and name not in COLUMN_KINDS:
        raise TorchidError(
            f"effect '{name}' cannot be fitted as plain columns.",
            available=list(COLUMN_KINDS),
            hint="`torchid gap` searches over all effects",
        )
    effect_kind(name)
    return COLUMN_KINDS[name]


def not_fitted(kind: type[Effect]) -> str | None:
    """Why an identification, whose base parameters are free, cannot fit an effect beside them; None
    where it can: where its columns are of joints' motion, time, and the torque of the fit itself.
    """
    if kind.inertial:
        return "it is a body, and bodies are what base parameters say already"
    if kind.event or kind.windowed:
        return "it happened once in one log, and is no property of the arm"
    beside = kind.needs & {"robot", "age", "velocity"} or kind.smooth or kind.linearised
    return "its torque is a change of a model with trusted parameters" if beside else None


def fitted_kind(name: str) -> type[Effect]:
    """The class of an effect that `identify` can fit.

    Raises:
        TorchidError: an unknown name, or an effect that cannot be fitted beside base parameters.
    """
    kind = effect_kind(name)
    reason = not_fitted(kind)
    if reason is not None:
        raise TorchidError(
            f"effect '{name}' cannot be identified beside base parameters: {reason}.",
            available=[other for other, k in KINDS.items() if not_fitted(k) is None],
            hint="`torchid gap` searches over all effects",
        )
    return kind


def experiment(one: str, two: str) -> str:
    """What to do on the arm to tell two effects apart, in one sentence: each shows itself in its
    own experiment. A name that is no effect's (all base parameters) has none."""
    told = dict.fromkeys(KINDS[name].experiment for name in (one, two) if name in KINDS)
    both = "; and ".join(told)
    return both[:1].upper() + both[1:] + "."


def on_every_joint(names: Iterable[str], n: int) -> list[JointEffect]:
    """The named effects on all n joints: effect by effect, joint by joint."""
    return [column_kind(name)(joint) for name in names for joint in range(n)]


def nominal_effects(robot: Robot) -> list[Valued]:
    """The effects a robot's description lists, with their coefficients.

    Raises:
        RobotError: a record without a joint or without a coefficient, or with an unknown key.
    """
    return [effect_from_record(record, robot) for record in robot.effects]


def nominal_columns(robot: Robot) -> list[tuple[JointEffect, list[float]]]:
    """The nominal effects that identification can fit."""
    return [
        (effect, values)
        for effect, values in nominal_effects(robot)
        if isinstance(effect, JointEffect) and effect.name in COLUMN_KINDS
    ]


def nominal_others(robot: Robot) -> list[Valued]:
    """The nominal effects that identification cannot fit."""
    return [pair for pair in nominal_effects(robot) if pair[0].name not in COLUMN_KINDS]


def carrying(robot: Robot, effects: Iterable[tuple[Effect, Sequence[float] | Tensor]]) -> Robot:
    """The arm with the bodies among its effects: what turns, moves or differentiates the model does
    so to these as well. A body itself is added to the robot as it is."""
    for effect, values in effects:
        if isinstance(effect, BodyEffect):
            robot = effect.plant(robot, values)
    return robot


def effect_torque(
    robot: Robot, effects: Sequence[Valued], motion: Motion, rigid: Joints | None = None
) -> Joints:
    """Torque (..., n) of effects, in two rounds: first those that do not depend on the torque, then
    the others, whose `motion.torque` is the rigid body's with the first round's.

    Args:
        robot: with the parameters that effects of the model need.
        effects: with their coefficients.
        motion: with t where an effect needs it.
        rigid: (..., n) torque of the rigid body, where an effect needs the torque.
    """
    first, later = in_rounds(effects)
    tau = motion.q * 0.0
    # Bodies alone need no parameters of the robot.
    alone = all(effect.inertial for effect, _ in effects)
    arm = robot if alone else carrying(robot, effects)
    for effect, values in first:
        tau = tau + effect.all_torques(motion, values, robot if effect.inertial else arm)
    if not later:
        return tau
    assert rigid is not None, "effects that depend on the torque need the rigid body's"
    loaded = motion._replace(torque=rigid + tau)
    return tau + sum(effect.all_torques(loaded, values, arm) for effect, values in later)


def in_rounds(effects: Sequence[Valued]) -> tuple[list[Valued], list[Valued]]:
    """Effects that do not depend on the torque, and those that do."""
    first = [pair for pair in effects if "torque" not in pair[0].needs]
    return first, [pair for pair in effects if "torque" in pair[0].needs]


def model_torque(robot: Robot, effects: Sequence[Valued], motion: Motion) -> Joints:
    """Torque (..., n) [N m; N] of the rigid body with effects along a motion.

    Raises:
        RobotError: the robot has no parameters.
    """
    rigid = inverse_dynamics(robot, *motion.state)
    return rigid + effect_torque(robot, effects, motion, rigid)


def effect_from_record(record: Mapping[str, Any], robot: Robot) -> Valued:
    """An effect and its coefficients from {effect, joint, <coefficient>: value, <shape>: value}.

    Shape parameters and other fields of the effect with a default may be left out.

    Raises:
        RobotError: an unknown effect, joint or key, a missing coefficient, a value of another type.
    """
    where = f"robot '{robot.name}': an effect"
    if "effect" not in record:
        raise RobotError(f"{where} has no key 'effect'.", got=dict(record), available=list(KINDS))
    kind = effect_kind(str(record["effect"]))
    names = [c.name for c in kind.coefficients]
    own = [f.name for f in fields(kind)]
    places = [name for name in PLACES if name in own]
    expected = ["effect", *places, *names]
    optional = [name for name in own if name not in places]
    if not set(expected) <= set(record) <= {*expected, *optional}:
        raise RobotError(
            f"{where} has wrong entries.", got=dict(record), expected=[*expected, *optional]
        )
    for place in places:
        joint = record[place]
        if not isinstance(joint, int) or not 1 <= joint <= robot.n:
            joints = list(range(1, robot.n + 1))
            raise RobotError(
                f"{where} is on a joint that does not exist.", got=joint, available=joints
            )
    numbers = [*names, *(s.name for s in kind.shapes if s.name in record)]
    for name in numbers:
        number(record[name], f"{where}, {kind.name}: {name}")
    given = {name: record[name] for name in optional if name in record}
    try:
        effect = kind(**{place: record[place] - 1 for place in places}, **given)
    except (TypeError, ValueError) as error:
        raise RobotError(f"{where} cannot be made: {error}", got=dict(record)) from error
    values = [float(record[name]) for name in names]
    for coefficient, value in zip(kind.coefficients, values, strict=True):
        # 100.0: how much larger than on any arm a coefficient in a file may be, to see what it
        # would do
        most = 100.0 * coefficient.largest
        # What is fitted may have a sign that physics forbids; a delay or a width may not.
        least = 0.0 if coefficient.non_negative and most < math.inf else -most
        if not least <= value <= most:
            raise RobotError(
                f"{where}, {kind.name}: {coefficient.name} is out of range.",
                got=value,
                expected=f"{least:g} to {most:g} {coefficient.unit}",
            )
    if "at" in own and "at" not in record and values[0] > 0:
        effect = replace(effect, at=values[0])  # type: ignore[call-arg]
    return effect, values
