"""`torchid robot` and `torchid effects`: what a robot description says, what effects there are."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from torchid.app import options as opt
from torchid.app.output import Kept, Printed
from torchid.app.signature import command


@command
def robot_command(*, arm: opt.Arm, output: Kept) -> None:
    """Print joints, limits, parameters and warnings of a robot.

    Example: `torchid robot kuka_lwr4`
    """
    from torchid.report.robot import robot_record, shown

    found = arm.load()
    output.give(robot_record(found), "robot.json", lambda _: shown(found))


@command
def effects_command(
    *, name: Annotated[str | None, typer.Argument(metavar="[NAME]")] = None, output: Kept
) -> None:
    """List the effects that can make an arm differ from its simulator, or explain one of them.

    With --out, write the catalogue of all: effects.md, and its pictures in img.

    Example: `torchid effects stribeck_friction`

    Args:
        name: One effect; all if left out.
    """
    from rich.markdown import Markdown

    from torchid.effects.registry import KINDS, effect_kind
    from torchid.report.catalogue import effect_record, effect_text, effects_table, write_catalogue

    kinds = list(KINDS.values()) if name is None else [effect_kind(name)]
    record = {"schema": "torchid.effects/1", "effects": [effect_record(kind) for kind in kinds]}
    replace(output, out=None).write_json(record, "effects.json")
    if output.out is not None:
        output.written.append(write_catalogue(output.out))
    output.say(effects_table() if name is None else Markdown(effect_text(kinds[0])))


@command
def explain_command(
    *, result: Annotated[Path, typer.Argument(metavar="RESULT")], output: Printed
) -> None:
    """Print a result again from its JSON: the answer, and what it rests on.

    Example: `torchid explain result/gap.json`

    Args:
        result: JSON of any command.
    """
    from torchid.report.explain import shown
    from torchid.results.files import load

    record = load(result)
    output.give(record, "result.json", shown)
