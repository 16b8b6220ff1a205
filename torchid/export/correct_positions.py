"""A diagnosis of commands and positions carried out into MuJoCo: servos refitted to what an MJCF
says of them, written, and moved there by the log's commands.

Nothing is written before the engine has run the file on the log.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import torch

from torchid.errors import TorchidError
from torchid.export.correct import CLAIMED, of_joints
from torchid.export.dynamics import Dynamics, require_same_arm
from torchid.export.export import Export, edited_of, export_dynamics, stem_of
from torchid.export.record import PositionCorrectionRecord, position_correction_record
from torchid.export.results import servo_dynamics
from torchid.export.servo_mjcf import SAID, ServosInMujoco, unsaid, write_servos
from torchid.export.write_actuator import Package
from torchid.export.write_xml import xml_of
from torchid.log.model import Log
from torchid.position.data import PositionData, prepare
from torchid.position.diagnose import refitted
from torchid.position.diagnosis import PositionDiagnosis
from torchid.position.model import ServoArm, replay
from torchid.results.record import Result
from torchid.robot.model import Robot
from torchid.simulation.servo import INDEX
from torchid.simulation.servo_loop import windows_of
from torchid.simulators.servo import AS_EFFORT, AT_RUN_TIME, SetPoints
from torchid.typing import Float, Tensor

WINDOW_S = 10.0
"""Motions begin again at the measured position after so long [s]."""
UNITS = 0.1
"""By which units of joints, as logs' velocities tell them, may differ [1]."""
NO_BETTER = 0.9
"""Mean error over that of the commands themselves from which a file is refused."""


@dataclass(frozen=True, eq=False)
class Followed:
    """RMS position errors, begun anew at the measured position every 10 s [mrad of the log's unit].

    Attributes:
        held_out: what they are on: `a held-out log` or `the log that was fitted`.
        command: (n,) the position is the command.
        full: (n,) all that was diagnosed, by torchid.
        claim: (n,) what the file says, by torchid.
        engine: (n,) the file, by the engine that runs it, commands held from one to the next.
        run_time: (n,) a file with set-points made at run time, by that engine.
        by: that engine.
    """

    held_out: str
    command: Float[Tensor, " n"]
    full: Float[Tensor, " n"]
    claim: Float[Tensor, " n"]
    engine: Float[Tensor, " n"]
    run_time: Float[Tensor, " n"]
    by: str


@dataclass(frozen=True, eq=False)
class PositionCorrection(Result):
    """An MJCF with servos.

    Attributes:
        nominal: the robot as given.
        refitted: the servos that are in the file.
        followed: what it is worth.
        no_field: parameters of servos that are not in it, with joints from 0.
        exports: what was written: the file, and the one for set-points at run time.
        beside: the yaml of that one's servos.
    """

    nominal: Robot
    refitted: ServoArm
    followed: Followed
    no_field: dict[str, tuple[int, ...]]
    exports: tuple[Export, ...]
    beside: tuple[Path, ...]

    def __repr__(self) -> str:
        return f"PositionCorrection('{self.nominal.name}', {', '.join(map(str, self.files))})"

    @property
    def files(self) -> tuple[Path, ...]:
        """What was written."""
        return (*(file for one in self.exports for file in one.files), *self.beside)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Where the engine does not do what the file's own numbers say."""
        found, own = self.followed.engine, self.followed.claim
        worse = (found > CLAIMED * own) & (found > own + 1)
        said = [
            f"joint {j + 1}: {self.followed.by} leaves {float(found[j]):.1f} mrad, and the file's "
            f"own numbers {float(own[j]):.1f}"
            for j in worse.nonzero().flatten().tolist()
        ]
        return (*said, *dict.fromkeys(words for one in self.exports for words in one.warnings))

    @cached_property
    def record(self) -> PositionCorrectionRecord:
        """As the JSON has it."""
        return position_correction_record(self)


def correct_positions(
    robot: Robot,
    full: PositionDiagnosis | ServoArm,
    log: Log,
    folder: Path | str,
    name: str | None = None,
    *,
    held_out: Log | None = None,
    with_effects: bool | Package = False,
    seed: int = 0,
    keep: Sequence[Path] = (),
) -> PositionCorrection:
    """Write a robot with servos as MuJoCo says them, refitted to a log of commands and positions.

    Args:
        robot: as given: if it is an MJCF, a copy of its file is edited.
        full: a diagnosis of it on this log, or what it corrected.
        log: motions that the servos in the file are fitted to.
        folder: made if need be.
        name: of the file, without suffix; the robot's own, with `_corrected`, by default.
        held_out: motions that judge it; without them, those that it was fitted to.
        with_effects: write a second file, `_effects` after its name, and a yaml of its servos, for
            set-points that `torchid.simulators.servo` makes at run time. With a package's name that
            package's actuator class is written, too: all of a servo at run time, refitted to that.
        seed: of the states at which the file's torque is compared.
        keep: files that are never overwritten.

    Raises:
        LogError: logs that do not fit the robot, or have no commands.
        MissingExtraError: MuJoCo is not installed.
        TorchidError: another arm, or a file that follows hardly better than its commands.

    >>> from tempfile import TemporaryDirectory
    >>> import numpy as np, torchid
    >>> robot, servo = torchid.load_robot("3r"), {"kp": 260.0, "damping": 22.0, "armature": 0.8}
    >>> real = torchid.ServoArm.of(robot, **servo, delay=0.02)
    >>> t = 0.04 * np.arange(260)
    >>> u = 0.3 * np.sin(np.outer(t, [1.0, 2.0, 3.0]))
    >>> log = torchid.replay(real, torchid.Log(t, q=u, u=u)).simulated[0]
    >>> with TemporaryDirectory() as folder:
    ...     done = correct_positions(robot, real, log, folder)
    >>> bool(done.followed.engine.mean() < 0.1 * done.followed.command.mean())
    True
    """
    arm = full.corrected if isinstance(full, PositionDiagnosis) else full
    require_same_arm(arm.robot, robot, "servos are")
    stem = f"{stem_of(robot)}_corrected" if name is None else name
    yaml = Path(folder) / f"{stem}_effects.yaml"
    if with_effects and yaml.resolve() in [Path(file).resolve() for file in keep]:
        raise TorchidError(
            f"the servos would take the place of '{yaml}'.",
            hint="another `name=...`, or another folder",
        )
    fitted = prepare(arm.robot, log)
    on, data = log, fitted
    if held_out is not None:
        on, data = held_out, prepare(arm.robot, held_out)
    for one in (fitted, data):
        if not torch.allclose(one.scale, arm.scale, rtol=UNITS):
            raise TorchidError(
                f"{one.log.label} is in other units than the servos' own log.",
                got=one.scale.tolist(),
                expected=f"{arm.scale.tolist()} rad (m) per unit, as its own velocities tell",
            )
    alone, running = refitted(arm, fitted, SAID, (*SAID, *AT_RUN_TIME))
    own, beside = (_in_engine(robot, _rigid(one, log), data) for one in (alone, running))
    followed = Followed(
        "the log that was fitted" if held_out is None else "a held-out log",
        _rms((data.tracks.u - data.q) / data.scale),
        replay(arm, on, windows=WINDOW_S).error[0],
        replay(alone, on, windows=WINDOW_S).error[0],
        own[1],
        beside[1],
        own[2],
    )
    found, none = (
        float(x.nan_to_num(torch.inf).mean()) for x in (followed.engine, followed.command)
    )
    if not found < NO_BETTER * none:
        raise TorchidError(
            "the file follows hardly better than its commands, so nothing was written.",
            got=f"{found:.3g} mrad in {followed.by}",
            expected=f"less than {NO_BETTER:g} times {none:.3g} mrad, on {followed.held_out}",
        )
    no_field = unsaid(arm.servos, SAID)

    def write(
        dynamics: Dynamics, stem: str, title: str, to: Literal["mjcf"] | Package = "mjcf"
    ) -> Export:
        return export_dynamics(
            replace(dynamics, title=title),
            to,
            folder,
            stem,
            nominal=robot,
            geometry="none",
            seed=seed,
            keep=keep,
        )

    words = f"'{robot.name}' with servos, corrected and refitted to mjcf"
    others = [f"{name}{of_joints(joints)}" for name, joints in no_field.items()]
    files = [write(own[0], stem, words + (f"; no field for {', '.join(others)}" if others else ""))]
    if with_effects:
        files.append(write(beside[0], f"{stem}_effects", f"{words}, for set-points at run time"))
        running.write(yaml)
    if not isinstance(with_effects, bool):
        (drives,) = refitted(arm, fitted, AS_EFFORT)
        title = f"{words}, all of it at run time"
        files.append(write(servo_dynamics(drives), stem, title, with_effects))
    said = (yaml,) if with_effects else ()
    return PositionCorrection(robot, alone, followed, no_field, tuple(files), said)


def _rigid(arm: ServoArm, log: Log) -> ServoArm:
    """The arm with stops where a log's positions end: those of a fit give way, a file's do not."""
    joint, q = arm.servos.joint.clone(), log.q * arm.scale
    for name, end in (("stop_low", q.amin(0)), ("stop_high", q.amax(0))):
        stop = joint[:, INDEX[name]]
        joint[:, INDEX[name]] = torch.where(stop.isfinite(), end, stop)
    return replace(arm, servos=replace(arm.servos, joint=joint))


def _in_engine(
    robot: Robot, arm: ServoArm, data: PositionData
) -> tuple[Dynamics, Float[Tensor, " n"], str]:
    """What a file with these servos holds, how far MuJoCo with it is from the log, and its name."""
    dynamics = servo_dynamics(arm, SetPoints(arm.servos, data.tracks.dt).late)
    with TemporaryDirectory() as drafts:
        path = Path(drafts) / "servos.xml"
        written, file, _, _ = xml_of(dynamics.robot, path, edited_of(robot, "mjcf"), "mjcf")
        write_servos(file, written, arm.servos, robot.source, dynamics.late)
        path.write_bytes(file.to_bytes())
        engine = ServosInMujoco(path, written)
        windows = windows_of(data.tracks, WINDOW_S)
        begun = (x.numpy() for x in data.start(windows))
        q = engine.moved(arm.servos, data.tracks, windows, *begun)
    return dynamics, _rms((q - data.q) / data.scale), engine.name


def _rms(apart: Float[Tensor, "T n"]) -> Float[Tensor, " n"]:
    """[mrad]"""
    return 1e3 * apart.square().mean(0).sqrt()
