"""`torchid simulate`: a synthetic log along a trajectory."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer

import torchid
from torchid.app import options as opt
from torchid.app.inputs import PLACE, RECORDED
from torchid.app.output import Computed, Output
from torchid.app.signature import Switch, command
from torchid.errors import TorchidError
from torchid.files import require_no_input, require_writable


@dataclass(frozen=True, kw_only=True)
class _Noise:
    """What the log's sensors do, of `noise_model`."""

    noise: Literal["none", "paper", "honest"] = "honest"
    snr: Annotated[float, typer.Option(min=-100, max=400)] = 30.0
    torque_noise: Annotated[float, typer.Option(min=0, max=100)] = 0.01
    encoder_bits: int = 18
    colour: opt.Hertz = None
    velocity_noise: Annotated[float | None, typer.Option(min=0, max=100)] = None


@dataclass(frozen=True, kw_only=True)
class _Replayed:
    """Whether and how logs' commands are simulated."""

    replay: Switch = False
    windows: Annotated[float | None, typer.Option(metavar="SECONDS")] = None
    columns: Annotated[str | None, typer.Option(metavar="MAP|FILE.yaml")] = None


@command
def simulate_command(
    *,
    arm: opt.Arm,
    trajectory: Annotated[list[Path], typer.Argument(metavar="TRAJECTORY|LOG..."), RECORDED],
    save: Annotated[Path | None, typer.Option("--save", "--to", metavar="FILE|DIR"), PLACE] = None,
    sensors: _Noise,
    effect: Annotated[list[str] | None, typer.Option(metavar="NAME:KEY=VALUE,..")] = None,
    closed_loop: Switch = False,
    rate: opt.Hertz = None,
    control_frequency: Annotated[float, typer.Option(metavar="HZ", min=0.01, max=1000)] = 5.0,
    replayed: _Replayed,
    seed: opt.Seed = 0,
    output: Annotated[Computed, "simulation.json", "replay.json"],
    device_name: opt.Device = "cpu",
) -> None:
    """Write the log that the robot would give along a trajectory.

    Without effects the nominal robot moves exactly along it. With `--effect` or `--closed-loop` a
    controller that knows the nominal robot follows it, and forward simulation tells how far the
    arm gets: effects change the motion, as they do on a real arm.

    Example: `torchid simulate kuka_lwr4_friction motion/trajectory.csv --save log.parquet`

    Example: `torchid simulate 3r motion/trajectory.csv --effect coulomb_friction:joint=2,Fc=0.6
    --effect torque_gain:joint=1,gain=0.05 --save log.parquet`

    With `--replay`, a robot with servos (`torchid gap LOG.. --save-model`) is given the commands
    that logs recorded, from their measured start on.

    Example: `torchid simulate corrected.yaml run1.parquet run2.parquet --replay --save simulated`

    Args:
        trajectory: File with t, q1.., dq1.., ddq1.., or several, whose arms move side by side; with
            --replay, logs with u1.. and q1.. .
        save: Log file (.parquet, .csv, .npz), of several `run{k}.parquet`; with --replay, a folder
            for one file a log, with the log's name, t and simulated q1.. .
        noise: `paper`: on the trajectory, torque computed from it. `honest`: encoder steps, torque
            noise, no accelerations.
        snr: paper: signal-to-noise ratio [dB].
        torque_noise: honest: torque noise, share of each joint's RMS torque.
        encoder_bits: honest: encoder counts a turn, as a power of 2; 0 for exact.
        colour: honest: low-pass the torque noise; white if absent.
        velocity_noise: honest: measured velocities, with this noise as a share of their RMS.
        effect: An effect the model lacks, e.g. coulomb_friction:joint=2,Fc=0.6; once for each. The
            arm then moves under control, and effects change its motion.
        closed_loop: Move under control, without effects too.
        rate: under control: samples per second; the trajectory's if absent.
        control_frequency: under control: natural frequency of the PD.
        replay: Simulate the commands of logs with the robot's servos.
        windows: with --replay: begin again at the measured position every so many seconds.
        columns: with --replay: which columns of the logs are what, as for other commands.
    """
    if replayed.replay:
        _replay(output, arm.robot, trajectory, save, replayed, seed)
        return
    if replayed.windows is not None or replayed.columns is not None:
        raise TorchidError("--windows and --columns are for --replay.")
    targets = _targets(save, output.out, len(trajectory))
    from torchid.effects.written import effect_written
    from torchid.excitation.synthetic import noise_model, simulation_record
    from torchid.simulation.controller import Controller

    numbers = dict(vars(sensors))
    noise = numbers.pop("noise")
    model = noise_model(noise, **numbers)
    robot = arm.load()
    effects = [effect_written(text, robot, "--effect") for text in effect or []]
    moves = closed_loop or bool(effects)
    motions = [torchid.read_log(path) for path in trajectory]
    # All arms move side by side: it takes no longer than one.
    motion = torchid.Log.concatenate(motions)
    with output.progress("simulating"):
        controller = Controller(control_frequency) if moves else None
        log = torchid.simulate(
            robot, motion, effects=effects, noise=model, closed_loop=moves, rate=rate,
            controller=controller, seed=seed, device=device_name,
        )  # fmt: skip
    runs = log.trajectories()
    for file, one in zip(targets, motions, strict=True):
        own, runs = runs[: one.trajectory_count], runs[one.trajectory_count :]
        output.put(file, partial(torchid.write_log, torchid.Log.concatenate(own)))
    names = ", ".join(file.name for file in targets)
    record = simulation_record(
        robot, log, effects, file=names, noise=noise, closed_loop=moves, seed=seed
    )
    output.write_json(record, "simulation.json")
    output.warn(log.warnings)
    output.say(f"{log.samples} samples of {log.trajectory_count} trajectories")


def _targets(save: Path | None, folder: Path | None, count: int) -> list[Path]:
    """Files of as many logs: `save` of one, with `{k}` for their numbers of several; else in the
    folder.

    Raises:
        TorchidError: nowhere to write, one name for several, or a file that cannot be written.
    """
    several = count > 1
    target = save or (folder and folder / ("log{k}.parquet" if several else "log.parquet"))
    if target is None or (several and "{k}" not in target.name):
        what = "several logs need several names." if target else "nowhere to write the log."
        where = (
            '--save "run{k}.parquet", for run1, run2, ..' if several else "--save FILE or --out DIR"
        )
        raise TorchidError(what, got=target, expected=where)
    targets = [target.with_name(target.name.replace("{k}", str(k))) for k in range(1, count + 1)]
    for file in targets if save is not None else ():
        require_writable(file, "--save")
    return targets


def _replay(
    output: Output, arm: str, paths: list[Path], save: Path | None, asked: _Replayed, seed: int
) -> None:
    """Simulated positions of logs, one file each."""
    from torchid.log.readers import written_suffixes

    folder = save or output.out
    if folder is None or folder.is_file():
        raise TorchidError("--replay writes one file a log.", got=folder, expected="--save DIR")
    names = [
        path.name if path.suffix.lower() in written_suffixes() else f"{path.stem}.parquet"
        for path in paths
    ]
    twice = [name for k, name in enumerate(names) if name in names[:k]]
    if twice:
        raise TorchidError("two logs have one name.", got=twice[0], expected="logs of other names")
    for name in names:
        require_no_input(folder / name, "--save")
    model = torchid.ServoArm.read(arm)
    joints = model.robot.joint_names
    logs = [torchid.read_log(path, columns=asked.columns, joints=joints) for path in paths]
    replayed = replace(torchid.replay(model, logs, windows=asked.windows), files=tuple(names))
    folder.mkdir(parents=True, exist_ok=True)
    for name, simulated in zip(names, replayed.simulated, strict=True):
        output.put(folder / name, partial(torchid.write_log, simulated.replace(u=None)))
    output.write_json({**replayed.plain(), "seed": seed}, "replay.json")
    for name, error in zip(names, replayed.error.mean(1).tolist(), strict=True):
        output.say(f"{name}: {error:.2f} {replayed.unit} from the measured positions")
