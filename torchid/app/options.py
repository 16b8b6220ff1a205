"""Options that several commands take, and what they do."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from torchid.app.output import Output, hashed
from torchid.errors import TorchidError
from torchid.identification.settings import DEFAULT_EFFECTS

if TYPE_CHECKING:
    from torchid.log.model import Log
    from torchid.report.page.document import InputFile
    from torchid.robot.model import Robot

FITTED = ",".join(DEFAULT_EFFECTS)
"""Effects that a fit has by default."""
LARGEST_SEED = 2**63 - 1
"""That torch's generators take."""
_SEED = typer.Option("--seed", min=0, max=LARGEST_SEED, help="Seed of everything random.")
Seed = Annotated[int, _SEED]
Device = Annotated[str, typer.Option("--device", help="Where tensors live: cpu, cuda, cuda:1, ...")]
Tip = Annotated[
    str | None, typer.Option(metavar="LINK", help="URDF, MJCF: last link of the chain.")
]
RobotOption = Annotated[str | None, typer.Option(metavar="ROBOT")]
LogArguments = Annotated[
    list[Path],
    typer.Argument(
        metavar="LOG...",
        help="Logs (.parquet, .csv, .npz, .mat, .h5; ROS bags; LeRobot datasets): t, q1.., and "
        "dq1.., tau1.. or i1.., or --columns. Several are several trajectories.",
    ),
]
File = Annotated[Path | None, typer.Option(metavar="FILE")]
LogFiles = Annotated[list[Path] | None, typer.Option(metavar="LOG")]
Group = Annotated[str | None, typer.Option(metavar="GROUP|none")]
Bounds = Annotated[str | None, typer.Option(metavar="GROUP|from-robot")]
Hertz = Annotated[float | None, typer.Option(metavar="HZ")]
Names = Annotated[str, typer.Option(metavar="A,B,C")]
Count = Annotated[int, typer.Option(min=1)]
LessThanOne = Annotated[float, typer.Option(min=0, max=0.99)]
Share = Annotated[float | None, typer.Option(min=0, max=0.99, show_default=False)]
FittedEffects = Annotated[
    str, typer.Option(help="Effects on every joint, comma-separated; `none` for the rigid body.")
]
FilterCutoff = Annotated[str, typer.Option(metavar="HZ|auto|none")]
HeldOutFraction = Annotated[
    float,
    typer.Option(help="Without --held-out: the last part of each trajectory kept for validation."),
]
Method = Annotated[
    Literal["ols", "wls", "huber"], typer.Option(help="Least squares: plain, weighted, robust.")
]
Velocities = Annotated[str | None, typer.Option(metavar="V|V1,V2,..")]
Accelerations = Annotated[
    str | None,
    typer.Option(
        metavar="A|A1,A2,..",
        help="Acceleration limits, in place of the robot's (a URDF has none).",
    ),
]


@dataclass(frozen=True, kw_only=True)
class Reading:
    """How logs are read.

    Attributes:
        columns: Which columns of the logs are what, where they have other names:
            `q=pos_{j} deg,tau=-eff_{j} mNm,t=stamp ns`, `q=state[:,0:7]`.
        topic: ROS bags: the topic of joint states.
        gain: Drive gains [N m/A], for logs of currents.
    """

    columns: Annotated[str | None, typer.Option(metavar="MAP|FILE.yaml")] = None
    topic: Annotated[str | None, typer.Option(metavar="NAME")] = None
    gain: Annotated[str | None, typer.Option(metavar="K1,K2,..")] = None

    def read(self, paths: list[Path], robot: "Robot") -> "Log":
        """Files as the trajectories of one log; currents times the drive gains, if given."""
        import torch

        from torchid.log.readers import read_log

        gains = None if self.gain is None else numbers("--gain", self.gain, robot.n)
        names = robot.joint_names
        log = read_log(paths, columns=self.columns, topic=self.topic, joints=names)
        return log if gains is None else log.with_torque(torch.tensor(gains, dtype=torch.float64))


@dataclass(frozen=True, kw_only=True)
class Arm:
    """One robot.

    Attributes:
        robot: Built-in name, or a .yaml (ours), .urdf or .xml (MJCF) file.
    """

    robot: Annotated[str, typer.Argument(metavar="ROBOT")]
    tip: Tip = None

    def load(self) -> "Robot":
        """The robot."""
        from torchid.robot.library import load_robot

        return load_robot(self.robot, tip=self.tip)


@dataclass(frozen=True, kw_only=True)
class ArmAndLogs(Arm, Reading):
    """One robot and its logs."""

    logs: LogArguments


@dataclass(frozen=True, kw_only=True)
class Trials(ArmAndLogs):
    """One robot and its logs, some of which may be held out.

    Attributes:
        held_out: Whole trajectories that take part in no choice. May be given several times.
    """

    held_out: LogFiles = None

    def open(self, output: Output) -> "tuple[Robot, Log, Log | None, tuple[InputFile, ...]]":
        """The robot, the logs, those held out, and, for a page, what these files are.

        Raises:
            TorchidError: an input cannot be read, or the page would take its place.
        """
        from torchid.robot.library import robot_file

        robot = self.load()
        named = [("robot", self.robot, robot_file(self.robot))]
        for role, paths in (("log", self.logs), ("held-out log", self.held_out or ())):
            for path in paths:  # of one that is a folder, the files in it
                inside = sorted(f for f in path.rglob("*") if f.is_file()) if path.is_dir() else []
                named += [(role, str(file), file) for file in inside or [path]]
        files = hashed(output, named)
        log = self.read(self.logs, robot)
        return robot, log, self.read(self.held_out, robot) if self.held_out else None, files


def device(name: str) -> str:
    """A device that exists and has float64, or a TorchidError."""
    import torch

    try:
        torch.zeros(1, dtype=torch.float64, device=name)
    except (RuntimeError, AssertionError, TypeError) as error:
        raise TorchidError(
            f"device '{name}' cannot be used.",
            got=str(error).splitlines()[0],
            available=["cpu", *(f"cuda:{k}" for k in range(torch.cuda.device_count()))],
        ) from error
    return name


def number(option: str, text: str, expected: str) -> float:
    """A finite number from the command line."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not math.isfinite(value):
        raise TorchidError(f"{option} is not a number.", got=text, expected=expected)
    return value


def numbers(option: str, text: str, n: int) -> list[float]:
    """n numbers separated by commas, or one for all n joints."""
    values = [number(option, part, "numbers separated by commas") for part in text.split(",")]
    if len(values) == 1:
        values = values * n
    if len(values) != n:
        raise TorchidError(f"{option} needs one number a joint.", got=len(values), expected=n)
    return values


def interval(option: str, text: str) -> tuple[float, float]:
    """LO,HI from the command line.

    Raises:
        TorchidError: not two numbers in order.
    """
    parts = [number(option, part, "LO,HI") for part in text.split(",")]
    if len(parts) != 2 or not parts[0] < parts[1]:
        raise TorchidError(f"{option} is not an interval.", got=text, expected="LO,HI with LO < HI")
    return parts[0], parts[1]


def names(text: str) -> tuple[str, ...]:
    """Names separated by commas; `none` for none. The settings check that they exist."""
    if text.strip() in ("", "none"):
        return ()
    return tuple(name.strip() for name in text.split(","))


def effect_names(text: str) -> tuple[str, ...]:
    """Names of effects separated by commas; `none` for none."""
    from torchid.effects.registry import column_kind

    return tuple(column_kind(name).name for name in names(text))


def searched(text: str) -> tuple[str, ...] | None:
    """The --effects option of a search: names, or None for `all`.

    Raises:
        TorchidError: no name at all.
    """
    if text.strip() == "all":
        return None
    found = names(text)
    if not found:
        raise TorchidError(
            "--effects leaves nothing to search over.", got=text, hint="`all` for the whole library"
        )
    return found


def auto_hz(text: str, expected: str = "a frequency in Hz, or `auto`") -> float | Literal["auto"]:
    """A --cutoff that cannot be left out."""
    if text == "auto":
        return "auto"
    value = number("--cutoff", text, expected)
    if value <= 0:
        raise TorchidError("--cutoff must be positive.", got=text)
    return value


def cutoff_hz(text: str) -> float | Literal["auto"] | None:
    """The --cutoff option: a frequency [Hz], `auto`, or None for `none`."""
    return None if text == "none" else auto_hz(text, "a frequency in Hz, `auto` or `none`")


def load_both(params: str, robot: str | None, tip: str | None) -> "tuple[Robot, Robot]":
    """The robot whose parameters are asked about, and --robot, or the same one without it."""
    from torchid.robot.library import load_robot

    both = [params] if robot is None else [params, robot]
    # A tip is for the files that can branch; where none can, the reader refuses it.
    trees = [name for name in both if Path(name).suffix.lower() in (".urdf", ".xml")]
    found = [load_robot(name, tip=tip if name in trees or not trees else None) for name in both]
    return found[0], found[-1]


def limited(robot: "Robot", velocity: str | None, acceleration: str | None) -> "Robot":
    """The robot with velocity or acceleration limits from the command line."""
    changed = {}
    for name, text in (("velocity", velocity), ("acceleration", acceleration)):
        if text is None:
            continue
        values = numbers(f"--max-{name}", text, robot.n)
        if not min(values) > 0:
            raise TorchidError(f"--max-{name} must be positive.", got=text)
        changed[name] = values
    return robot.with_limits(**changed)
