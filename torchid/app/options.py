"""Options that every computing command takes, and what they do."""

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from torchid.errors import TorchidError

if TYPE_CHECKING:
    from torchid.log.model import Log
    from torchid.robot.model import Robot

RobotArgument = Annotated[
    str,
    typer.Argument(
        metavar="ROBOT", help="Built-in name, or a .yaml (ours), .urdf or .xml (MJCF) file."
    ),
]
LogArguments = Annotated[
    list[Path],
    typer.Argument(
        metavar="LOG...",
        help="Logs (.parquet, .csv, .npz, .mat, .h5; ROS bags; LeRobot datasets): t, q1.., and "
        "dq1.., tau1.. or i1.., or --columns. Several are several trajectories.",
    ),
]
Columns = Annotated[
    str | None,
    typer.Option(
        "--columns",
        metavar="MAP|FILE.yaml",
        help="Which columns of the logs are what, where they have other names: "
        "`q=pos_{j} deg,tau=-eff_{j} mNm,t=stamp ns`, `q=state[:,0:7]`.",
    ),
]
Topic = Annotated[
    str | None,
    typer.Option("--topic", metavar="NAME", help="ROS bags: the topic of joint states."),
]
HeldOut = Annotated[
    list[Path] | None,
    typer.Option(
        "--held-out",
        metavar="LOG",
        help="Whole trajectories that take part in no choice. May be given several times.",
    ),
]
HeldOutFraction = Annotated[
    float,
    typer.Option(
        "--held-out-fraction",
        help="Without --held-out: the last part of each trajectory kept for validation.",
    ),
]
FITTED = "viscous_friction,coulomb_friction,torque_offset,rotor_inertia"
"""Effects that a fit has by default."""
FittedEffects = Annotated[
    str,
    typer.Option(
        "--effects", help="Effects on every joint, comma-separated; `none` for the rigid body."
    ),
]
Method = Annotated[
    Literal["ols", "wls", "huber"], typer.Option(help="Least squares: plain, weighted, robust.")
]
Gain = Annotated[
    str | None,
    typer.Option("--gain", metavar="K1,K2,..", help="Drive gains [N m/A], for logs of currents."),
]
Tip = Annotated[
    str | None,
    typer.Option("--tip", metavar="LINK", help="URDF, MJCF: last link of the chain."),
]
Json = Annotated[
    Path | None,
    typer.Option(
        "--json", metavar="FILE", help="Write the result as JSON; - for standard output, alone."
    ),
]
Out = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Folder for JSON, tables and figures.")
]
Report = Annotated[
    Path | None,
    typer.Option(
        "--report",
        metavar="FILE.html",
        help="Write one self-contained page: verdict, pictures, tables, how it was obtained "
        "(needs torchid's extra `report`).",
    ),
]
LARGEST_SEED = 2**63 - 1
"""That torch's generators take."""
Seed = Annotated[
    int, typer.Option("--seed", min=0, max=LARGEST_SEED, help="Seed of everything random.")
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Threads = Annotated[
    int | None,
    typer.Option(
        "--threads",
        min=1,
        help="Threads of torch and BLAS (default 1: fastest on shared machines).",
    ),
]
MaxAcceleration = Annotated[
    str | None,
    typer.Option(
        "--max-acceleration",
        metavar="A|A1,A2,..",
        help="Acceleration limits, in place of the robot's (a URDF has none).",
    ),
]
Device = Annotated[str, typer.Option("--device", help="Where tensors live: cpu, cuda, cuda:1, ...")]


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


def effect_names(text: str) -> tuple[str, ...]:
    """Names of effects separated by commas; `none` for none."""
    from torchid.effects.registry import column_kind

    return tuple(column_kind(name).name for name in names(text))


def read_logs(
    paths: list[Path],
    gain: str | None,
    robot: "Robot",
    columns: str | None = None,
    topic: str | None = None,
) -> "Log":
    """Several files as the trajectories of one log; currents times the drive gains, if given."""
    import torch

    from torchid.log.readers import read_log

    gains = None if gain is None else numbers("--gain", gain, robot.n)
    log = read_log(paths, columns=columns, topic=topic, joints=robot.joint_names)
    return log if gains is None else log.with_torque(torch.tensor(gains, dtype=torch.float64))


def read_both(
    logs: list[Path],
    held_out: list[Path] | None,
    gain: str | None,
    robot: "Robot",
    columns: str | None = None,
    topic: str | None = None,
) -> "tuple[Log, Log | None]":
    """The logs, and those held out, if any."""
    log = read_logs(logs, gain, robot, columns, topic)
    return log, read_logs(held_out, gain, robot, columns, topic) if held_out else None


def names(text: str) -> tuple[str, ...]:
    """Names separated by commas; `none` for none. The settings check that they exist."""
    if text.strip() in ("", "none"):
        return ()
    return tuple(name.strip() for name in text.split(","))


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


def cutoff_hz(text: str) -> float | Literal["auto"] | None:
    """The --cutoff option: a frequency [Hz], `auto`, or None for `none`."""
    return None if text == "none" else auto_hz(text, "a frequency in Hz, `auto` or `none`")


def auto_hz(text: str, expected: str = "a frequency in Hz, or `auto`") -> float | Literal["auto"]:
    """A --cutoff that cannot be left out."""
    if text == "auto":
        return "auto"
    value = number("--cutoff", text, expected)
    if value <= 0:
        raise TorchidError("--cutoff must be positive.", got=text)
    return value


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
    import torch

    changed = {}
    for name, text in (("velocity", velocity), ("acceleration", acceleration)):
        if text is None:
            continue
        values = numbers(f"--max-{name}", text, robot.n)
        upper = torch.tensor(values, dtype=torch.float64)
        if not bool((upper > 0).all()):
            raise TorchidError(f"--max-{name} must be positive.", got=text)
        changed[name] = torch.stack([-upper, upper], -1)
    return replace(robot, limits=replace(robot.limits, **changed)) if changed else robot
