"""Effects as C: those whose torque is a closed form of the present motion."""

from collections.abc import Sequence
from typing import NamedTuple

from torchid.effects.base import Effect
from torchid.effects.c_text import JOINTS, RIGID
from torchid.effects.registry import Valued, in_rounds
from torchid.export.dynamics import described
from torchid.robot.model import Robot


class EffectCode(NamedTuple):
    """Statements of all effects, and what could not be written.

    Attributes:
        first: effects of the motion alone.
        later: effects of the torque, `loaded`, that those and the rigid body need.
        left_out: in words, those that depend on the past, on time or on an arm that is otherwise.
        uses_rigid: whether a statement calls the rigid body's function.
    """

    first: list[str]
    later: list[str]
    left_out: list[tuple[Effect, str]]
    uses_rigid: bool


def effect_code(robot: Robot, effects: Sequence[Valued], rigid: str) -> EffectCode:
    """C statements that add the effects' torques to tau[].

    Args:
        robot: for units.
        effects: with coefficients.
        rigid: name of the C function of the rigid body's torque.
    """
    rounds: list[list[str]] = []
    left_out = []
    uses_rigid = False
    for pairs in in_rounds(effects):
        lines: list[str] = []
        for effect, values in pairs:
            words = described(effect, values, robot)
            code = effect.c_code(values)
            if code is None:
                left_out.append((effect, words))
                continue
            uses_rigid |= any(RIGID in line for line in code)
            named = (line.replace(RIGID, rigid).replace(JOINTS, str(robot.n)) for line in code)
            lines += [f"/* {words} */", *named]
        rounds.append(lines)
    return EffectCode(rounds[0], rounds[1], left_out, uses_rigid)
