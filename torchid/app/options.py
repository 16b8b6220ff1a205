"""Options that several commands take, and what they do."""

import math
import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

import torchid
from torchid.app.inputs import PLACE, RECORDED, ROBOT, WRITTEN, Suffix
from torchid.app.output import Output
from torchid.app.signature import Fields, Parsed, Switch
from torchid.effects.names import DEFAULT_EFFECTS, require_effects
from torchid.errors import TorchidError
from torchid.robot.config_files import robot_file

if TYPE_CHECKING:
    from torchid.log.table import Request
    from torchid.parallel.workers import Workers
    from torchid.report.page.document import InputFile
    from torchid.robot.tree import Choice

    Logs = Sequence[torchid.Log | None]

LARGEST_SEED = 2**63 - 1
"""That torch's generators take."""
LARGE = 50e6
"""Of log files, from which reading them is told as a stage [bytes]."""


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


def total_mass(text: str) -> tuple[float, float]:
    """--total-mass: an interval [kg].

    Raises:
        TorchidError: not two numbers in order, none of them negative.
    """
    parts = [number("--total-mass", part, "LO,HI in kg") for part in text.split(",")]
    if len(parts) != 2 or not 0 <= parts[0] < parts[1]:
        raise TorchidError(
            "--total-mass is not an interval.", got=text, expected="LO,HI in kg with 0 <= LO < HI"
        )
    return parts[0], parts[1]


def names(text: str) -> tuple[str, ...]:
    """Names separated by commas; `none` for none. The settings check that they exist."""
    if text.strip() in ("", "none"):
        return ()
    return tuple(name.strip() for name in text.split(","))


def effect_names(text: str) -> tuple[str, ...]:
    """Names of effects separated by commas; `none` for none."""
    require_effects(effects := names(text))
    if not set(effects) <= set(DEFAULT_EFFECTS):
        from torchid.effects.registry import column_kind

        for name in effects:
            column_kind(name)
    return effects


def searched_effects(text: str) -> tuple[str, ...] | None:
    """The --effects option of a search: names, or None for `all`.

    Raises:
        TorchidError: no name at all.
    """
    if text.strip() == "all":
        return None
    effects = names(text)
    if not effects:
        raise TorchidError(
            "--effects leaves nothing to search over.", got=text, hint="`all` for the whole library"
        )
    require_effects(effects)
    return effects


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


def device(text: str) -> str:
    """The --device option."""
    if text == "cpu":
        return text
    from torchid.tensors import usable_device

    return usable_device(text)


Seed = Annotated[
    int, typer.Option("--seed", min=0, max=LARGEST_SEED, help="Seed of everything random.")
]
Device = Annotated[
    str,
    typer.Option("--device", help="Where tensors live: cpu, cuda, cuda:1, ..."),
    Parsed(device, "cpu"),
]
RobotOption = Annotated[str | None, typer.Option(metavar="ROBOT"), ROBOT]
LOGS = typer.Argument(
    metavar="LOG...",
    help="Logs (.parquet, .csv, .npz, .mat, .h5; ROS bags; LeRobot datasets): t, q1.., and "
    "dq1.., tau1.. or i1.., or --columns. Several are several trajectories.",
)
LogArguments = Annotated[list[Path], LOGS, RECORDED]
File = Annotated[Path | None, typer.Option(metavar="FILE")]
Written = Annotated[Path | None, typer.Option(metavar="FILE"), WRITTEN]
LOG_SUFFIX = Suffix((".csv", ".npz", ".parquet"))
Saved = Annotated[Path | None, typer.Option("--save", "--to", metavar="FILE"), WRITTEN, LOG_SUFFIX]
Model = Annotated[
    Path | None, typer.Option(metavar="FILE.yaml"), WRITTEN, Suffix((".yaml", ".yml"))
]
Folder = Annotated[Path, typer.Option(metavar="DIR"), PLACE]
LogFiles = Annotated[list[Path] | None, typer.Option(metavar="LOG"), RECORDED]
Group = Annotated[str | None, typer.Option(metavar="GROUP|none")]
Bounds = Annotated[str | None, typer.Option(metavar="BOUNDS")]
TotalMass = Annotated[tuple[float, float] | None, typer.Option(metavar="LO,HI"), Parsed(total_mass)]
Hertz = Annotated[float | None, typer.Option(metavar="HZ")]
Searched = Annotated[
    tuple[str, ...] | None, typer.Option(metavar="NAMES"), Parsed(searched_effects, "all")
]
Count = Annotated[int, typer.Option(min=1, max=100_000)]
FittedEffects = Annotated[
    tuple[str, ...], typer.Option(metavar="NAMES"), Parsed(effect_names, "none")
]
Cutoff = float | Literal["auto"] | None
FilterCutoff = Annotated[Cutoff, typer.Option(metavar="HZ|auto|none"), Parsed(cutoff_hz, "none")]
_Share = Annotated[float, typer.Option(metavar="SHARE", min=0, max=0.99)]
GAP = Fields(
    "held_out_fraction",
    effects=Searched,
    background=FittedEffects,
    cutoff=Annotated[Cutoff, typer.Option(metavar="HZ|auto"), Parsed(auto_hz, "none")],
    parameters=Literal["trusted", "free", "auto"],
    worthwhile=_Share,
    worthwhile_torque=_Share,
    gain_std=Annotated[
        float | None, typer.Option(metavar="SHARE", min=0, max=0.99, show_default=False)
    ],
    max_effects=Count,
    seed=Seed,
)
"""Options of a diagnosis."""
FIT = Fields(
    "rows basis method covariance signs held_out_fraction",
    effects=FittedEffects,
    cutoff=FilterCutoff,
    essential=Switch,
    force=Switch,
    error_cutoff=Hertz,
)
"""Options of a fit."""
Velocities = Annotated[str | None, typer.Option(metavar="V|V1,V2,..")]
Accelerations = Annotated[str | None, typer.Option(metavar="A|A1,A2,..")]


@dataclass(frozen=True, kw_only=True)
class Crew:
    """Who does the work.

    Attributes:
        workers: Processes of one thread each.
        scheduler: Address of a dask scheduler (tcp://HOST:8786), in place of processes.
    """

    workers: Count = 1
    scheduler: Annotated[str | None, typer.Option(metavar="tcp://HOST:PORT")] = None

    @property
    def crew(self) -> "Workers":
        """As torchid.parallel.workers takes it.

        Raises:
            TorchidError: both are given.
        """
        if self.scheduler is not None and self.workers != 1:
            raise TorchidError("--workers and --scheduler exclude each other.")
        return self.scheduler or self.workers


@dataclass(frozen=True, kw_only=True)
class Reading:
    """How logs are read.

    Attributes:
        columns: Which columns of the logs are what, where they have other names:
            `q=pos_{j} deg,tau=-eff_{j} mNm,t=stamp ns`, `q=state[:,0:7]`.
        topic: ROS bags: the topic of joint states.
        gain: Drive gains [N m/A], for logs of currents.
        kp: Gains [N m/rad] of the joint controllers, for logs whose torque is the commanded one:
            kp (u - q) + kd (du/dt - dq), and tau as the feed-forward where the log has it.
        kd: Their damping [N m s/rad].
    """

    columns: Annotated[str | None, typer.Option(metavar="MAP|FILE.yaml")] = None
    topic: Annotated[str | None, typer.Option(metavar="NAME")] = None
    gain: Annotated[str | None, typer.Option(metavar="K1,K2,..")] = None
    kp: Annotated[str | None, typer.Option(metavar="K1,K2,..")] = None
    kd: Annotated[str | None, typer.Option(metavar="D1,D2,..")] = None

    def request(self, robot: "torchid.Robot | None") -> "Request":
        """As these options say."""
        from torchid.log.mapping import read_mapping
        from torchid.log.table import Request

        for option, text in (("--columns", self.columns), ("--topic", self.topic)):
            if text is not None and not text.strip():
                raise TorchidError(f"{option} says nothing.", got=repr(text))
        mapping = None if self.columns is None else read_mapping(self.columns)
        joints = () if robot is None else robot.driven_names
        spare = () if robot is None else robot.spare
        return Request(mapping, self.topic, joints, spare)

    def with_torque(self, log: "torchid.Log", n: int) -> "torchid.Log":
        """The torque of n joints where options make it: of the joint controllers' commands, or of
        currents times the gains that are given."""
        from torchid.design.sensor import with_commanded_torque

        if self.kd is not None and self.kp is None:
            raise TorchidError("--kd needs --kp.")
        if self.kp is not None:
            if self.gain is not None:
                raise TorchidError("--kp and --gain exclude each other.")
            kd = numbers("--kd", self.kd or "0", n)
            return with_commanded_torque(log, numbers("--kp", self.kp, n), kd)
        return log if self.gain is None else log.with_torque(numbers("--gain", self.gain, n))

    def read(self, paths: Sequence[Path], robot: "torchid.Robot") -> "torchid.Log":
        """Files as the trajectories of one log."""
        from torchid.log.checks import check_joints
        from torchid.log.readers import open_logs

        if self.gain is not None:
            numbers("--gain", self.gain, robot.n)
        opened = open_logs(paths, self.request(robot))
        log = torchid.Log.concatenate([log for _, log in opened])
        check_joints(log, robot.name, robot.n, robot.floating)
        return self.with_torque(log, robot.n)


@dataclass(frozen=True, kw_only=True)
class Part:
    """The part of a robot's file that is meant.

    Attributes:
        tip: URDF, MJCF: last link of a chain, alone.
        root: URDF, MJCF: the base of what is read.
        lock: URDF, MJCF: a joint that is held, and where [rad or m]. May be given several times.
        base: URDF, MJCF: a base that is held, or moves and is measured (base_x ..).
    """

    tip: Annotated[str | None, typer.Option(metavar="LINK")] = None
    root: Annotated[str | None, typer.Option(metavar="LINK")] = None
    lock: Annotated[list[str] | None, typer.Option(metavar="JOINT=VALUE")] = None
    base: Literal["fixed", "moving"] = "fixed"

    @property
    def choice(self) -> "Choice":
        """As the readers take it.

        Raises:
            TorchidError: a joint that is to be held without a number.
        """
        from torchid.robot.tree import Choice

        held = {}
        for text in self.lock or ():
            joint, _, position = text.rpartition("=")
            if not joint:
                raise TorchidError(
                    "--lock names a joint and a position.", got=text, expected="JOINT=VALUE"
                )
            held[joint] = number("--lock", position, "JOINT=VALUE, in rad or m")
        return Choice(self.tip, self.root, held, self.base)


@dataclass(frozen=True, kw_only=True)
class Arm(Part):
    """One robot.

    Attributes:
        robot: Built-in name, or a torchid .yaml, .urdf or .xml (MJCF) file.
    """

    robot: Annotated[str, typer.Argument(metavar="ROBOT"), ROBOT]

    def load(self) -> "torchid.Robot":
        """The robot."""
        return load(self.robot, self)


@dataclass(frozen=True, kw_only=True)
class ArmAndLogs(Arm, Reading):
    """One robot and its logs.

    Attributes:
        torque: What the logs' torque is: measured with gravity, or without gravity, which a
            controller has taken out.
    """

    logs: LogArguments
    torque: Literal["measured", "without-gravity"] = "measured"

    def load(self) -> "torchid.Robot":
        """The robot, under no gravity where its torques hold none."""
        robot = super().load()
        return robot.without_gravity() if self.torque == "without-gravity" else robot

    def __post_init__(self) -> None:
        """Look at the logs' headers.

        Raises:
            LogError: one of them lacks columns.
        """
        from torchid.log.readers import require_header

        for path in self.logs or ():
            require_header(path, self.request(None))

    @property
    def as_log_options(self) -> str:
        """The logs, and how they are read, for a command that takes them as options."""
        names = {"log": self.logs or (), "columns": [self.columns], "topic": [self.topic]}
        each = [(f"--{name}", str(x)) for name, some in names.items() for x in some if x]
        return shlex.join([word for pair in each for word in pair])

    @contextmanager
    def line_to_mend(
        self, logs: Sequence[Path] | None = None, before: Sequence[Path] | None = None
    ) -> Iterator[None]:
        """An error that a log is wrong says what to paste: `--columns`, or the doctor's line, of
        these files or of LOG..., or of earlier ones where it is of them."""
        from torchid.doctor.first import WrongLogError
        from torchid.doctor.flag import flag_for

        try:
            yield
        except WrongLogError as stop:
            examination, logs = stop.examination, logs or self.logs or []
            if set(map(str, before or ())) & set(examination.log.source.split(", ")):
                logs = before or []
            choices = [c for check in examination.undecided for c in check.choices]
            own = not (self.columns or self.topic)
            flag = flag_for(examination.repairs, examination.robot.n, logs) if own else None
            fix = f'--fix "{choices[0].name}" ' if choices else ""
            names = shlex.join([self.robot, *map(str, logs)])
            line = f"torchid log doctor {names} {fix}--apply mended.parquet"
            if flag is not None:
                line = f'read it with --columns "{flag}", or: {line}'
            mends = any(c.repairs for c in stop.wrong)
            raise WrongLogError(examination, stop.wrong, line if mends else None) from None

    def ask_first(
        self, robot: "torchid.Robot", logs: "Logs", files: Sequence[Path] | None, force: bool,
        loaded: bool = False,
    ) -> tuple[str, ...]:  # fmt: skip
        """The doctor's decisive checks of logs with one load, read from these files, and what they
        doubt; loaded where the load is one that the robot lacks.

        Raises:
            WrongLogError: a log is wrong, and force is not asked for.
        """
        from torchid.doctor.first import ask_first

        every = torchid.Log.concatenate([log for log in logs if log is not None])
        with self.line_to_mend(files):
            return ask_first(robot, every, force=force, loaded=loaded).sentences


@dataclass(frozen=True, kw_only=True)
class Trials(ArmAndLogs):
    """One robot and its logs, some of which may be held out.

    Attributes:
        held_out: Whole trajectories that take part in no choice. May be given several times.
    """

    held_out: LogFiles = None

    @property
    def inputs(self) -> list[Path]:
        """All files that are read."""
        return [Path(self.robot), *self.logs, *(self.held_out or ())]

    def open(
        self, output: Output, fraction: float = 0.0
    ) -> "tuple[torchid.Robot, torchid.Log, torchid.Log | None, tuple[InputFile, ...]]":
        """The robot, the logs, those held out, and, for a page, what these files are.

        Args:
            output: that may want a page.
            fraction: of every trajectory that is held out in place of logs.

        Raises:
            TorchidError: an input cannot be read, or logs and a fraction are held out.
        """
        if self.held_out and fraction:
            raise TorchidError(
                "--held-out and --held-out-fraction exclude each other.", expected="one of them"
            )
        robot, apart = self.load(), self.held_out or []
        roles = [("log", path) for path in self.logs] + [("held-out log", path) for path in apart]
        named = [(role, str(path), path) for role, path in roles]
        files = output.hashed([("robot", self.robot, robot_file(self.robot)), *named])
        # Large files take a while.
        large = sum(p.stat().st_size for p in (*self.logs, *apart) if p.is_file()) > LARGE
        with output.progress("reading") if large else nullcontext():
            log = self.read(self.logs, robot)
            held_out = self.read(apart, robot) if apart else None
        return robot, log, held_out, files


def load(name: str, part: Part) -> "torchid.Robot":
    """A robot."""
    from torchid.effects.registry import nominal_effects

    robot = torchid.load_robot(name, **part.choice.options)
    nominal_effects(robot)  # known, complete and in range, also where they are not used
    return robot


def with_limits(
    robot: "torchid.Robot", velocity: str | None, acceleration: str | None
) -> "torchid.Robot":
    """The robot with velocity or acceleration limits from the command line."""
    given = {"velocity": velocity, "acceleration": acceleration}
    asked = {k: numbers(f"--max-{k}", x, robot.n) for k, x in given.items() if x is not None}
    for name, values in asked.items():
        if not min(values) > 0:
            raise TorchidError(f"--max-{name} must be positive.", got=given[name])
    return robot.with_limits(**asked)
