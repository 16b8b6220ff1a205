"""`torchid pair`: a simulator's logs beside the arm's, under the same commands."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

import torchid
from torchid.app import options as opt
from torchid.app.inputs import RECORDED, ROBOT
from torchid.app.output import Output, settings_of
from torchid.app.signature import Fields, Switch, command
from torchid.errors import TorchidError
from torchid.gap.settings import GapSettings

LOGS = Annotated[list[Path], typer.Option(metavar="LOG"), RECORDED]


@dataclass(frozen=True, kw_only=True)
class BothLogs(opt.Trials):
    """Logs of a simulator, and of an arm under the same commands.

    Attributes:
        robot: Built-in name or file of the simulator's robot: then effects are named, too.
        simulated: Log of the simulator, of the same commands as --real. May be given several times.
        real: Log of the arm, one for each of --simulated.
    """

    robot: Annotated[str, typer.Argument(metavar="ROBOT"), ROBOT] = ""
    logs: Annotated[list[Path] | None, opt.LOGS, RECORDED] = None  # type: ignore[assignment]
    simulated: LOGS
    real: LOGS


_PAIR = Fields("robot simulated real torque columns topic gain kp kd tip root lock base")
_OUTPUT = Fields("json_file out report verbose overwrite quiet threads")


@command
def pair_command(
    *,
    both: Annotated[BothLogs, _PAIR],
    settings: Annotated[
        GapSettings,
        opt.GAP.only(
            "effects background cutoff parameters worthwhile worthwhile_torque gain_std "
            "max_effects seed"
        ),
    ],
    save_model: opt.Model = None,
    no_rows: Switch = False,
    force: Switch = False,
    output: Annotated[Output, _OUTPUT, "pair.json"],
) -> None:
    """Find where a simulator's logs and the arm's differ under the same commands: faults of the
    simulator's set-up, and, with a ROBOT, effects that only one of them has.

    Example: `torchid pair --simulated sim.csv --real arm.csv my_arm.urdf`

    Args:
        effects: Effects to search over, comma-separated; `all` for the whole library.
        cutoff: Cut-off of the fit's zero-phase filter.
        save_model: Write the simulator's robot with what the arm has more, as a .yaml.
        no_rows: Keep no log beside the model of --save-model.
        force: Name effects of an arm's log that looks wrong all the same.
    """
    from torchid.log.readers import open_logs
    from torchid.report.pair import report_of_pair
    from torchid.robot.config_files import robot_file

    if save_model is not None and not both.robot:
        raise TorchidError("--save-model corrects the simulator's robot, and needs its ROBOT.")
    robot = both.load() if both.robot else None
    sides = {"simulated": both.simulated, "real": both.real}
    named = [(side, str(path), path) for side, paths in sides.items() for path in paths]
    own = [("robot", both.robot, robot_file(both.robot))] if robot else []
    files = output.hashed([*own, *named])

    def read(paths: list[Path]) -> "torchid.Log":
        opened = open_logs(paths, both.request(robot))
        return torchid.Log.concatenate([both.with_torque(log, log.n) for _, log in opened])

    with output.progress("reading") as progress, both.line_to_mend(both.real):
        simulated, real = (read(paths) for paths in sides.values())
        result = torchid.compare_pair(
            simulated, real, robot, settings=settings, force=force, progress=progress
        )
    kept = output.keep(
        result, "pair.json", report_of_pair, seed=settings.seed, files=files,
        settings={} if result.of_arm is None else settings_of(result.of_arm, None),
    )  # fmt: skip
    try:
        output.put(save_model, partial(result.write_corrected, rows=not no_rows))
    finally:  # what differs is said where it is no model, too
        output.tell(kept)
