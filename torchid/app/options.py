"""Options that every computing command takes, and what they do."""

import logging
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.console import Console
from rich.markup import escape

from torchid.errors import TorchidError
from torchid.json_data import write_json

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


@dataclass(frozen=True)
class Output:
    """Where a command's results go.

    Attributes:
        json_file: from --json.
        folder: from --out.
        quiet: from --quiet.
        console: for people, on standard output.
        page_file: from --report.
        started: of `time.monotonic`.
    """

    json_file: Path | None
    folder: Path | None
    quiet: bool
    console: Console
    page_file: Path | None = None
    started: float = field(default_factory=time.monotonic)

    def write_json(self, data: dict[str, Any], name: str) -> None:
        """To --json and to DIR/name, whichever were given."""
        for target in (self.json_file, None if self.folder is None else self.folder / name):
            if target is not None:
                with suppress(BrokenPipeError):  # standard output, whose reader has left
                    write_json(data, target)

    def say(self, *objects: Any) -> None:
        """Print for people, unless quiet."""
        if not self.quiet:
            self.console.print(*objects)

    def warn(self, warnings: tuple[str, ...]) -> None:
        """Print warnings, one a line."""
        for warning in warnings:
            self.say(f"[yellow]![/] {escape(warning)}")


def open_output(
    json_file: Path | None,
    folder: Path | None,
    quiet: bool,
    threads: int | None = None,
    page_file: Path | None = None,
) -> Output:
    """Check that results can be written before any work is done, and set torch's threads.

    Raises:
        TorchidError: a folder that does not exist or cannot be written.
        MissingExtraError: a page is asked for, and what makes it is not installed.
    """
    started = time.monotonic()
    if str(json_file) == "-":
        json_file, quiet = Path("/dev/stdout"), True
    if folder is not None:
        _make_folder(folder)
    _check_file("--json", json_file)
    if page_file is not None:
        _check_page(page_file, json_file)
    _set_torch_threads(threads)
    logging.basicConfig(level=logging.ERROR if quiet else logging.WARNING, format="%(message)s")
    return Output(json_file, folder, quiet, _console(), page_file, started)


def _check_file(option: str, path: Path | None) -> None:
    if path is None:
        return
    if path.is_dir():
        raise TorchidError(f"{option} needs a file, and '{path}' is a folder.")
    if not path.parent.is_dir():
        raise TorchidError(f"the folder of '{path}' does not exist.")
    _probe(path.parent)


def _check_page(page_file: Path, json_file: Path | None) -> None:
    if json_file is not None and page_file.resolve() == json_file.resolve():
        raise TorchidError("--report and --json name the same file.", got=page_file)
    _check_file("--report", page_file)
    from torchid.report.page.render import require_templates

    require_templates()


class _Console(Console):
    """Falls silent when its reader has left (`| head`), where rich ends the program: files that
    were asked for are still written."""

    def on_broken_pipe(self) -> None:
        with suppress(SystemExit):
            super().on_broken_pipe()


def _console() -> Console:
    """As wide as the terminal; wide enough for the tables where there is none."""
    console = _Console(highlight=False)
    return console if console.is_terminal else _Console(highlight=False, width=120)


def _set_torch_threads(threads: int | None) -> None:
    import torch

    torch.set_num_threads(threads or 1)


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TorchidError(
            f"the output folder '{folder}' cannot be made: {error.strerror or error}."
        ) from error
    _probe(folder)


def _probe(folder: Path) -> None:
    """A file really written and removed: permission bits say nothing to root or of a full disk."""
    probe = folder / ".torchid-write-test"
    try:
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise TorchidError(
            f"the folder '{folder}' cannot be written: {error.strerror or error}."
        ) from error


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


@contextmanager
def progress_bar(output: Output) -> Iterator[Callable[[str, int, int], None] | None]:
    """A callback (stage, done, total) that draws one bar; None when there is no terminal."""
    if output.quiet or not output.console.is_terminal:
        yield None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(
        *columns, TimeElapsedColumn(), console=output.console, transient=True
    ) as progress:
        task = progress.add_task("", total=None)

        def report(stage: str, done: int, total: int) -> None:
            progress.update(task, description=stage, completed=done, total=total)

        yield report


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

    if text.strip() in ("", "none"):
        return ()
    return tuple(column_kind(name.strip()).name for name in text.split(","))


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


def cutoff_hz(text: str) -> float | Literal["auto"] | None:
    """The --cutoff option: a frequency [Hz], `auto`, or None for `none`."""
    if text == "auto":
        return "auto"
    if text == "none":
        return None
    value = number("--cutoff", text, "a frequency in Hz, `auto` or `none`")
    if value <= 0:
        raise TorchidError("--cutoff must be positive.", got=text)
    return value


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
