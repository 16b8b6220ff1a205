"""`torchid robot` and `torchid effects`: what a robot description says, what effects there are."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from torchid.app import options as opt
from torchid.app.output import Kept, Output
from torchid.app.signature import Fields, command
from torchid.errors import TorchidError


@command
def robot_command(*, arm: opt.Arm, output: Annotated[Kept, "robot.json"]) -> None:
    """Print joints, limits, parameters and warnings of a robot.

    Example: `torchid robot kuka_lwr4`
    """
    from torchid.report.robot import report_of_robot, robot_record

    robot = arm.load()
    output.give(robot_record(robot), "robot.json", lambda _: report_of_robot(robot))


@command
def effects_command(
    *,
    name: Annotated[str | None, typer.Argument(metavar="[NAME]")] = None,
    output: Annotated[Output, Fields("json_file", "quiet")],
) -> None:
    """List the effects that can make an arm differ from its simulator, or explain one of them.

    Example: `torchid effects stribeck_friction`

    Args:
        name: One effect; all if left out.
    """
    from torchid.effects.registry import KINDS, effect_kind
    from torchid.effects.servo import SERVO_KINDS
    from torchid.report.effects import Kind, effect_record, effect_table, effects_table

    # A name may be that of an effect on torque, of a cause under a servo, or of both.
    every: list[Kind] = [*KINDS.values(), *SERVO_KINDS.values()]
    kinds = [kind for kind in every if name in (None, kind.name)]
    if not kinds:
        effect_kind(str(name))  # the error that lists all
    record = {"schema": "torchid.effects/1", "effects": [effect_record(kind) for kind in kinds]}
    output.write_json(record, None)
    for table in [effects_table(kinds)] if name is None else map(effect_table, kinds):
        output.say(table)


@command
def explain_command(
    *,
    result: Annotated[Path, typer.Argument(metavar="[RESULT]")] = Path(),
    output: Annotated[Output, Fields("json_file", "report", "quiet")],
) -> None:
    """Print a result again from its JSON: the answer, and the evidence for it. Of a folder: the
    result below it, or a list where there are several.

    Example: `torchid explain result/gap.json`

    Example: `torchid explain results --report index.html`

    Args:
        result: JSON of any command, or a folder of them; the present folder if absent.
        report: Of a folder: write an index of its results, links to them and their pages.
    """
    from torchid.report.explain import report_of_file

    if result.is_dir():
        from torchid.report.page.index import entries, report_of_folder, write_index

        results = entries(result)
        if output.report is not None or len(results) > 1:
            output.put(output.report, partial(write_index, result))
            output.tell(report_of_folder(result, results))
            return
        result = results[0].file
    if output.report is not None:
        raise TorchidError(
            "--report writes an index of a folder.",
            got=result,
            hint="the page of one result is written by the command that computes it",
        )
    data, said = report_of_file(result)
    output.write_json(data, "result.json")
    replace(output, verbose=True).tell(said)
