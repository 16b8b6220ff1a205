"""Writes effects.md, the catalogue of effects, from the registry, and draws its pictures, of which
each shows a family by its effects' own columns.

`python docs/draw_effects.py`
"""

import math
from collections.abc import Iterator, Mapping
from itertools import cycle, groupby
from pathlib import Path
from typing import get_args

import torch

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Abscissa, Effect, Family, Motion
from torchid.effects.parameters import Scale
from torchid.effects.registry import KINDS, not_fitted
from torchid.effects.rivals import ALIKE, aged
from torchid.effects.servo import SERVO_KINDS, ServoEffect
from torchid.report.colours import BLUE, GREEN, GREY, INK, ORANGE, RED
from torchid.report.effects import SECONDS, known_rivals
from torchid.report.panels import Figure, save, tiles
from torchid.report.table import pipe_table
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.typing import Tensor

FAMILY_WORDS: dict[Family, str] = {
    "speed": "Torque that follows speed.",
    "sign": "Torque that follows the direction of motion: a step at each reversal.",
    "constant": "Torque that stays.",
    "gravity": "Torque that follows posture, as gravity does.",
    "inertia": "Torque of bodies that the model does not have.",
    "phase": "Torque or motion that is measured late, and joints that give way.",
    "hysteresis": "Torque that depends on the way that led there.",
    "periodic": "Torque that repeats along the joint's travel.",
    "time": "Torque that changes while the arm works.",
    "transient": "Torque of some instants only.",
}
_SCALES: dict[Scale, str] = {
    "one": "",
    "speed": " times the joint's 99 % speed",
    "torque": " times the joint's 99 % torque",
    "travel": " times the joint's travel",
}
_HEAD = """# The effects

What besides the rigid body can make an arm's torque differ from a simulator's: {count} effects in
{families} families. `python docs/draw_effects.py` writes this page.

    tau = Y(q, dq, ddq) pi + sum of the effects

Every effect is linear in its *coefficients*; *shape* parameters are searched. Unless its entry says
otherwise, an effect acts at one joint (`joint`), shows in logs of torque, and is fitted by
`identify` and `gap`. Units are those of a revolute joint.

`torchid identify --effects a,b` fits effects on every joint, `NAME:joint=2,SHAPE=0.1` at one place
with a given shape. `torchid gap` searches over all of them. `torchid simulate --effect
NAME:joint=2,COEFFICIENT=0.5` adds them to a simulated arm. Members of one family look alike in a
log: believe the family first. `torchid effects NAME` gives one entry in full, with its source. The
pictures show the torque on joint 2 of a KUKA LWR IV+.

*Confused with* is the largest correlation of any torque of two effects at one place, from
{alike:g}, or the nearest where none is as near, along {seconds:g} s of exciting motion. *Exactly*:
some torque of the one is one of the other. `torchid gap` computes it for your log.
"""

_SERVOS = "In logs of commands and positions, beside effects whose entry names positions.\n"


def catalogue_page() -> str:
    """The page in Markdown."""
    families = list(get_args(Family))
    head = _HEAD.format(count=len(KINDS), families=len(families), seconds=SECONDS, alike=ALIKE)
    contents, parts = [], []
    for family in families:
        members = [kind for kind in KINDS.values() if kind.family == family]
        links = ", ".join(f"[{kind.name}](#{kind.name})" for kind in members)
        contents.append((f"[{family}](#{family})", links))
        parts += [f"## {family}\n\n{FAMILY_WORDS[family]}\n"]
        parts += [f"![Effects of the family {family}](img/{picture_name(family)}.png)\n"]
        parts += [effect_text(kind) for kind in members]
    links = ", ".join(f"[{name}](#{name})" for name in SERVO_KINDS)
    contents.append(("[command and servo](#command-and-servo)", links))
    parts += ["## command and servo\n", _SERVOS, *map(servo_text, SERVO_KINDS.values())]
    return "\n".join([head, pipe_table(("family", "effects"), contents) + "\n", *parts])


def picture_name(family: Family) -> str:
    """Name of a family's picture, without suffix."""
    return f"effects-{family}"


def effect_text(kind: type[Effect]) -> str:
    """One effect in Markdown, without its source and what holds for most effects."""
    # 4: of an effect
    alike = (
        f"[{r.name}](#{r.name}) {'exactly' if r.same else f'{r.correlation:.2f}'}"
        for r in known_rivals(kind)[:4]
    )
    fitted = "`identify` and `gap`" if not_fitted(kind) is None else "`gap`"
    facts = (
        ("place", kind.where, "one joint (`joint`)"),
        ("logs", " and ".join(kind.logs()), "torque"),
        ("fitted by", fitted, "`identify` and `gap`"),
    )
    lines = [
        f"### {kind.name}",
        "",
        kind.meaning,
        "",
        f"    {kind.equation}",
        "",
        *_coefficients(kind),
        *(
            f"- shape `{s.name}` [{s.unit}], {s.low:g} to {s.high:g}{_SCALES[s.scale]}: {s.meaning}"
            for s in kind.shapes
        ),
        *(f"- {name}: {x}" for name, x, usual in facts if x != usual),
        f"- signature: {kind.signature}",
        f"- confused with: {', '.join(alike)}",
        f"- experiment: {kind.experiment}",
        f"- remedy: {kind.remedy}",
        "",
    ]
    return "\n".join(lines)


def servo_text(effect: ServoEffect) -> str:
    """One cause under a servo in Markdown."""
    rival = f"- confused with: {effect.twin}, always\n" if effect.twin else ""
    return (
        f"### {effect.name}\n\n{effect.meaning}\n\n    {effect.equation}\n\n"
        f"- numbers: {', '.join(f'`{name}`' for name in effect.parameters)}\n"
        "- logs: of commands and positions; fitted by: `gap`\n"
        f"{rival}- experiment: {effect.experiment}\n- remedy: {effect.remedy}\n"
    )


def _coefficients(kind: type[Effect]) -> Iterator[str]:
    """A line a coefficient; those of one tensor have one."""
    for _, alike in groupby(kind.coefficients, lambda c: (c.meaning.split(",")[0], c.unit)):
        first, *rest = alike
        names = ", ".join(f"`{c.name}`" for c in (first, *rest))
        meaning = ", ".join([first.meaning, *(c.meaning.rpartition(", ")[2] for c in rest)])
        least, most = ("0 to " if first.non_negative else "up to ±"), first.largest
        bounds = f", {least}{most:g}" if most < math.inf else ", ≥ 0" * first.non_negative
        yield f"- {names} [{first.unit}]{bounds}: {meaning}"


JOINT = 1
"""The joint that is drawn, from 0: the shoulder, which carries the arm."""
_COLOURS = (BLUE, ORANGE, GREEN, RED, INK, GREY)

_AXES: Mapping[Abscissa, str] = {
    "speed": "speed [rad/s]",
    "position": "position [rad]",
    "acceleration": "acceleration [rad/s²]",
    "time": "time [s]",
}


def examples(family: Family) -> list[Effect]:
    """The effects of a family that are drawn."""
    return [kind.exemplar(JOINT) for kind in KINDS.values() if kind.family == family]


def family_figure(family: Family) -> Figure:
    """Torque of every effect of a family on the shoulder of a KUKA LWR IV+, a panel an effect."""
    motion, robot = example_motion(120.0 if family == "time" else 8.0)
    drawn = examples(family)
    columns = min(3, len(drawn))
    names = [effect.name for effect in drawn]
    figure, panels = tiles(names, columns, 3.2 * columns, (2.3, 0.1))
    for effect, axes, colour in zip(drawn, panels, cycle(_COLOURS), strict=False):
        torque, over = shown_torque(effect, motion, robot), effect.example.over
        if over == "time":
            assert motion.t is not None
            axes.plot(motion.t, torque, color=colour, linewidth=1.2)
        else:
            signal = {"speed": motion.dq, "position": motion.q, "acceleration": motion.ddq}[over]
            axes.plot(signal[:, JOINT], torque, ".", color=colour, markersize=1.5)
        axes.axhline(0, color=GREY, linewidth=0.8)
        axes.set(xlabel=_AXES[over], ylabel="torque [N m]")
    return figure


def example_motion(duration: float) -> tuple[Motion, Robot]:
    """A smooth motion of a KUKA LWR IV+, with the torque of its model; and the robot.

    Args:
        duration: [s], sampled at 200 Hz.
    """
    robot = load_robot("kuka_lwr4")
    t = torch.arange(round(200 * duration), dtype=torch.float64) / 200
    j = torch.arange(robot.n, dtype=torch.float64)
    q, dq, ddq = torch.zeros(3, len(t), robot.n, dtype=torch.float64).unbind()
    for amplitude, period in ((0.7, 5.0), (0.15, 1.6)):
        w = 2 * torch.pi / period * (1 + 0.07 * j)
        phase = t[:, None] * w + j
        q = q + amplitude * torch.sin(phase)
        dq = dq + amplitude * w * torch.cos(phase)
        ddq = ddq - amplitude * w**2 * torch.sin(phase)
    return Motion(q, dq, ddq, t=t, torque=inverse_dynamics(robot, q, dq, ddq)), robot


def shown_torque(effect: Effect, motion: Motion, robot: Robot) -> Tensor:
    """Torque (T,) of an example on the joint that is drawn."""
    values = effect.example.values
    return effect.all_torques(aged(effect, motion, values), values, robot)[:, JOINT]


def main() -> None:
    folder = Path(__file__).parent
    for family in get_args(Family):
        save(family_figure(family), folder / f"img/{picture_name(family)}.png")
    (folder / "effects.md").write_text(catalogue_page())


if __name__ == "__main__":
    main()
