"""`torchid correct`: from logs to a corrected file of the simulator, in one call."""

from pathlib import Path
from typing import Annotated, Literal

import typer

import torchid
from torchid.app import options as opt
from torchid.app.output import Computed
from torchid.app.signature import Switch, command
from torchid.gap.settings import GapSettings

Simulated = Literal["mjcf", "urdf", "drake", "mujoco", "mjlab", "isaaclab", "gazebo"]
"""What a corrected file can be for; the last four read one of the first two."""


@command
def correct_command(
    *,
    trials: opt.Trials,
    to: Simulated,
    name: Annotated[str | None, typer.Option(metavar="NAME")] = None,
    with_effects: Switch = False,
    settings: Annotated[
        GapSettings,
        opt.GAP.only("effects background parameters held_out_fraction gain_std seed"),
    ],
    output: Computed,
) -> None:
    """Correct a simulator's file by logs of the real arm.

    What it lacks is found and refitted to what the file can say, with bodies near to the nominal
    ones; the file is run in its engine on the log, and written. Without --out, it is written to the
    present folder.

    Example: `torchid correct arm.xml run1.parquet run2.parquet --held-out run3.parquet --to mjcf
    --out corrected`

    Args:
        to: Format to write (mjcf, urdf), or a simulator that reads one of them: a copy of ROBOT
            where it is of that format, else a new file of its kinematics, without shapes.
        name: Of the file, without suffix; the robot's name and `_corrected`.
        with_effects: Also write NAME_effects, fitted together with the effects that the format has
            no field for; they lie in its sidecar, and torchid.simulators.mujoco adds them at run
            time. For isaaclab and mjlab, an actuator class that does so, too.
        effects: Effects to search over, comma-separated; `all` for the whole library.
        background: Effects that are part of the simulator already, on every joint; fitted with the
            base parameters where the robot has no parameters.
        parameters: The robot's inertial parameters: right, to be refitted first, or one possible
            cause among the effects.
        gain_std: How well the scale of each joint's torque is known, one standard deviation as a
            share of it.
    """
    from torchid.export.correct import file_format
    from torchid.export.export import require_name
    from torchid.report.gap_words import verdict
    from torchid.report.robot import correction_shown

    kind = file_format(to)
    if name is not None:
        require_name(name)
    found, log, apart, _ = trials.open(output, settings.held_out_fraction)
    with output.progress("reading") as progress:
        result = torchid.diagnose(found, log, held_out=apart, settings=settings, progress=progress)
    keep = [Path(trials.robot), *trials.logs, *(trials.held_out or ())]
    done = torchid.correct(
        found, result, log, kind, output.out or Path(), name, held_out=apart, settings=settings,
        with_effects=with_effects and (to if to == "isaaclab" or to == "mjlab" else True),
        keep=keep,
    )  # fmt: skip
    said = output.keep(done, "correction.json", correction_shown)
    output.verdict(verdict(result))
    output.tell(said)
