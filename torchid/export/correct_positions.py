"""A diagnosis of commands and positions carried out into MuJoCo: servos refitted to what an MJCF
says of them, written, and moved there by the log's commands.

Nothing is written before the engine has run the file on the log.
"""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import torch

from torchid.effects.servo import INDEX
from torchid.errors import TorchidError
from torchid.export.correction import (
    Correction,
    CorrectionRequest,
    Judged,
    of_joints,
    without_field,
)
from torchid.export.dynamics import Dynamics, in_places_of, require_same_arm
from torchid.export.export import edited_of, ratios_to_file
from torchid.export.results import servo_dynamics
from torchid.export.servo_mjcf import (
    FAR,
    SAID,
    STOPS,
    ServosInMujoco,
    said_in_mjcf,
    unsaid_parameters,
    write_servos,
)
from torchid.export.write_xml import xml_of
from torchid.log.checks import own_units
from torchid.log.model import Log
from torchid.position.data import PositionData, prepare
from torchid.position.diagnose import refitted
from torchid.position.diagnosis import PositionDiagnosis
from torchid.position.model import ServoArm
from torchid.position.replay import replay
from torchid.results.cause import held_out_words
from torchid.robot.model import Robot, error_unit
from torchid.simulation.servo_loop import windows_of
from torchid.simulators.servo import AS_EFFORT, AT_RUN_TIME, SetPoints
from torchid.typing import Bool, Float, Tensor

WINDOW_S = 10.0
"""Motions begin again at the measured position after so long [s]."""
UNITS = 0.1
"""By which units of joints, as logs' velocities tell them, may differ [1]."""
NO_BETTER = 0.9
"""Mean error over that of the commands themselves from which a file is refused."""


def correct_positions(asked: CorrectionRequest, full: PositionDiagnosis | ServoArm) -> Correction:
    """Write a robot with servos as MuJoCo says them, refitted to a log of commands and positions.

    With effects there is a yaml of its servos beside the second file, for set-points that
    `torchid.simulators.servo` makes at run time; a package's actuator class is all of a servo at
    run time, refitted to that.

    Args:
        asked: of an MJCF.
        full: a diagnosis of the robot on this log, or what it corrected.

    Raises:
        LogError: logs that do not fit the robot, or have no commands.
        TorchidError: another arm, or a file that follows hardly better than its commands.
    """
    arm = full.corrected if isinstance(full, PositionDiagnosis) else full
    robot, log = asked.robot, asked.log
    require_same_arm(arm.robot, robot, "servos are")
    arm = replace(arm, robot=in_places_of(arm.robot, robot))
    if not isinstance(asked.with_effects, bool):
        ratios_to_file(arm, None)
    yaml = asked.folder / f"{asked.stem}_effects.yaml"
    if asked.with_effects and yaml.resolve() in [Path(file).resolve() for file in asked.keep]:
        raise TorchidError(
            f"the servos would take the place of '{yaml}'.",
            hint="another `name=...`, or another folder",
        )
    fitted = _prepared(arm, log)
    on, data = log, fitted
    if asked.held_out is not None:
        on, data = asked.held_out, _prepared(arm, asked.held_out)
    said = said_in_mjcf(arm.servos, set_points=not asked.plain)
    alone, running = refitted(arm, fitted, said, arm.servos.keeping((*SAID, *AT_RUN_TIME)))
    limits = _limits(robot)
    reach = torch.stack([fitted.q.amin(0), fitted.q.amax(0)], 1)
    passed = torch.stack([reach[:, 0] < limits[:, 0], reach[:, 1] > limits[:, 1]], 1)
    guessed = fitted.scale != 1
    own, beside = (
        _in_engine(robot, _rigid(one, robot, reach, passed, guessed), data, by_file)
        for one, by_file in ((alone, not asked.plain), (running, False))
    )
    judged = Judged(
        unit=error_unit(robot),
        held_out="the log that was fitted"
        if asked.held_out is None
        else held_out_words(asked.held_out.names),
        nominal=_rms((data.tracks.u - data.q) / data.scale),
        full=replay(arm, on, windows=WINDOW_S).error[0],
        claim=replay(alone, on, windows=WINDOW_S).error[0],
        engine=own[1],
        run_time=beside[1],
        by=own[2],
    )
    _require_follows(judged)
    no_field = unsaid_parameters(arm.servos, said)
    words = f"'{robot.name}' with servos, corrected and refitted to mjcf"
    others = [f"{name}{of_joints(joints)}" for name, joints in no_field.items()]
    files = [asked.write(own[0], words + without_field(others))]
    servos: tuple[Path, ...] = ()
    if asked.with_effects:
        title = f"{words}, for set-points at run time"
        files.append(asked.write(beside[0], title, ending="_effects"))
        running.write(yaml)
        servos = (yaml,)
    if not isinstance(asked.with_effects, bool):
        (drives,) = refitted(arm, fitted, arm.servos.keeping(AS_EFFORT))
        title = f"{words}, all of it at run time"
        files.append(asked.write(servo_dynamics(drives), title, asked.with_effects))
    warnings = dict.fromkeys(words for one in files for words in one.warnings)
    widened = [
        f"joint {j + 1}: the log reaches {float(reach[j, end]):.4g} rad (m), and the limit of "
        f"{float(limits[j, end]):.4g} that the joint has in '{robot.name}' is moved there"
        for j, end in (passed & ~guessed[:, None]).nonzero().tolist()
    ] + [
        f"joint {j + 1}: its unit in the log is guessed, so its limit in '{robot.name}' is not kept"
        for j in (guessed & limits.isfinite().any(1)).nonzero().flatten().tolist()
    ]
    return Correction(
        robot, judged, tuple(files), (*judged.worse_than_claimed, *widened, *warnings),
        servos=alone, no_field=no_field, beside=servos,
    )  # fmt: skip


def _prepared(arm: ServoArm, log: Log) -> PositionData:
    """A log for the fit of an arm's servos.

    Raises:
        TorchidError: a joint is in another unit than in the servos' own logs.
    """
    data = prepare(arm.robot, log, arm.scale)
    # Most motions say nothing of their unit: then it is that of the servos' own logs.
    for j, told in own_units(data.log).items():
        known = float(arm.scale[j])
        if abs(told - known) > UNITS * known:
            raise TorchidError(
                f"{data.log.label} has joint {j + 1} in another unit than the servos' own logs.",
                got=f"{told:.3g} rad (m) per unit, by the recorded velocities",
                expected=f"{known:.3g}",
                hint="diagnose this log together with the others",
            )
    return data


def _require_follows(judged: Judged) -> None:
    """Raise TorchidError for a file that follows hardly better than the commands themselves."""
    found, none = (float(x.nan_to_num(torch.inf).mean()) for x in (judged.engine, judged.nominal))
    if not found < NO_BETTER * none:
        raise TorchidError(
            "the file follows hardly better than its commands, so nothing was written.",
            got=f"{found:.3g} mrad in {judged.by}",
            expected=f"less than {NO_BETTER:g} times {none:.3g} mrad, on {judged.held_out}",
        )


def _limits(robot: Robot) -> Float[Tensor, "n 2"]:
    """Limits of the joints' positions; infinite where there are none [rad; m]."""
    if robot.limits.position is not None:
        return robot.limits.position
    return torch.tensor([[-torch.inf, torch.inf]], dtype=torch.float64).repeat(robot.n, 1)


def _rigid(
    arm: ServoArm,
    robot: Robot,
    reach: Float[Tensor, "n 2"],
    passed: Bool[Tensor, "n 2"],
    guessed: Bool[Tensor, " n"],
) -> ServoArm:
    """The arm with the limits of the robot that is written, and stops where a log's positions end:
    in the place of those of a fit, which give way as a file's do not, and of limits that the log
    passes. Limits in another unit than the log's, which is guessed, are far away."""
    joint = arm.servos.joint.clone()
    for name, end, beyond, far in zip(STOPS, reach.T, passed.T, (-FAR, FAR), strict=True):
        stop = joint[:, INDEX[name]]
        known = stop.isfinite() | (beyond & ~guessed)
        joint[:, INDEX[name]] = torch.where(known, end, stop.masked_fill(guessed, far))
    limited = replace(arm.robot, limits=robot.limits)
    return replace(arm, robot=limited, servos=replace(arm.servos, joint=joint))


def _in_engine(
    robot: Robot, arm: ServoArm, data: PositionData, set_points: bool
) -> tuple[Dynamics, Float[Tensor, " n"], str]:
    """What a file with these servos holds, how far MuJoCo with it is from the log, and its name;
    `set_points` as in `write_servos`."""
    late = SetPoints(arm.servos, data.tracks.dt).late
    dynamics = servo_dynamics(arm, late, set_points)
    with TemporaryDirectory() as drafts:
        path = Path(drafts) / "servos.xml"
        written, file, _, _ = xml_of(dynamics.robot, path, edited_of(robot, "mjcf"), "mjcf")
        write_servos(file, written, arm.servos, robot.source, dynamics.late, set_points=set_points)
        path.write_bytes(file.to_bytes())
        engine = ServosInMujoco(path, written)
        windows = windows_of(data.tracks, WINDOW_S)
        begun = (x.numpy() for x in data.start(windows))
        q = engine.moved(arm.servos, data.tracks, windows, *begun)
    return dynamics, _rms((q - data.q) / data.scale), engine.name


def _rms(apart: Float[Tensor, "T n"]) -> Float[Tensor, " n"]:
    """[mrad]"""
    return 1e3 * apart.square().mean(0).sqrt()
