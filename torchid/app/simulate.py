"""`torchid simulate`: a synthetic log along a trajectory."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from torchid.app import options as opt
from torchid.app.output import open_output
from torchid.errors import TorchidError

if TYPE_CHECKING:
    from torchid.effects.registry import Valued
    from torchid.excitation.synthetic import NoiseModel
    from torchid.log.model import Log
    from torchid.robot.model import Robot


def simulate_command(
    robot: opt.RobotArgument,
    trajectory: Annotated[
        Path, typer.Argument(metavar="TRAJECTORY", help="File with t, q1.., dq1.., ddq1.. .")
    ],
    to: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Log file (.parquet, .csv, .npz).")
    ] = None,
    noise: Annotated[
        Literal["none", "paper", "honest"],
        typer.Option(
            help="`paper`: on the trajectory, torque computed from it. `honest`: encoder steps, "
            "torque noise, no accelerations.",
        ),
    ] = "honest",
    snr: Annotated[float, typer.Option(help="paper: signal-to-noise ratio [dB].")] = 30.0,
    torque_noise: Annotated[
        float, typer.Option(help="honest: torque noise, share of each joint's RMS torque.")
    ] = 0.01,
    encoder_bits: Annotated[
        int, typer.Option(help="honest: encoder counts a turn, as a power of 2; 0 for exact.")
    ] = 18,
    colour: Annotated[
        float | None,
        typer.Option(metavar="HZ", help="honest: low-pass the torque noise; white if absent."),
    ] = None,
    velocity_noise: Annotated[
        float | None,
        typer.Option(help="honest: measured velocities, with this noise as a share of their RMS."),
    ] = None,
    effect: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME:KEY=VALUE,..",
            help="An effect the model lacks, e.g. coulomb_friction:joint=2,Fc=0.6; once for each. "
            "The arm then moves under control, and effects change its motion.",
        ),
    ] = None,
    closed_loop: Annotated[
        bool, typer.Option("--closed-loop", help="Move under control, without effects too.")
    ] = False,
    rate: Annotated[
        float | None,
        typer.Option(
            metavar="HZ", help="under control: samples per second; the trajectory's if absent."
        ),
    ] = None,
    control_frequency: Annotated[
        float, typer.Option(metavar="HZ", help="under control: natural frequency of the PD.")
    ] = 5.0,
    tip: opt.Tip = None,
    json_file: opt.Json = None,
    out: opt.Out = None,
    seed: opt.Seed = 0,
    quiet: opt.Quiet = False,
    threads: opt.Threads = None,
    device_name: opt.Device = "cpu",
) -> None:
    """Write the log that the robot would give along a trajectory.

    Without effects the nominal robot moves exactly along it. With `--effect` or `--closed-loop` a
    controller that knows the nominal robot follows it, and forward simulation tells how far the
    arm gets: effects change the motion, as they do on a real arm.

    Example: `torchid simulate kuka_lwr4_friction motion/trajectory.csv --to log.parquet`

    Example: `torchid simulate 3r motion/trajectory.csv --effect coulomb_friction:joint=2,Fc=0.6
    --effect torque_gain:joint=1,gain=0.05 --to log.parquet`
    """
    output = open_output(json_file, out, quiet, threads)
    from torchid.app.effect_option import effect_from_text
    from torchid.excitation.synthetic import HonestNoise, PaperNoise, synthetic_log
    from torchid.log.readers import read_log, write_log
    from torchid.robot.library import load_robot

    target = to if to is not None else (None if out is None else out / "log.parquet")
    if target is None:
        raise TorchidError("nowhere to write the log.", expected="--to FILE or --out DIR")
    model: "NoiseModel" = None
    if noise == "paper":
        model = PaperNoise(snr_db=snr)
    elif noise == "honest":
        if not 0 <= encoder_bits <= 40:
            raise TorchidError("--encoder-bits lies between 0 and 40.", got=encoder_bits)
        model = HonestNoise(
            encoder_step=0.0 if encoder_bits == 0 else 2 * math.pi / 2**encoder_bits,
            torque_relative=torque_noise,
            colour_hz=colour,
            include_velocity=velocity_noise is not None,
            velocity_relative=velocity_noise or 0.0,
        )
    found = load_robot(robot, tip=tip)
    effects = [effect_from_text(text, found) for text in effect or []]
    moves = closed_loop or bool(effects)
    if moves:
        planned = read_log(trajectory)
        log = _under_control(found, planned, effects, model, seed, rate, control_frequency)
    elif rate is not None:
        raise TorchidError("--rate needs --closed-loop or --effect.", got=f"--rate {rate:g}")
    else:
        where = opt.device(device_name)
        log = synthetic_log(found, read_log(trajectory), model, seed, device=where)
    write_log(log, target)
    output.warn(log.warnings)
    output.say(f"{log.samples} samples of {log.trajectory_count} trajectories written to {target}")
    assert log.tau is not None
    output.write_json(
        {
            "schema": "torchid.simulation/1",
            "robot": found.name,
            "file": target.name,
            "noise": noise,
            "closed_loop": moves,
            "effects": [one.record(values) for one, values in effects],
            "seed": seed,
            "samples": log.samples,
            "trajectories": list(log.names),
            "torque_rms": log.tau.square().mean(0).sqrt().tolist(),
        },
        "simulation.json",
    )


def _under_control(
    robot: "Robot",
    references: "Log",
    effects: "list[Valued]",
    noise: "NoiseModel",
    seed: int,
    rate: float | None,
    frequency: float,
) -> "Log":
    """The log of the arm with effects, each trajectory from its own beginning."""
    from torchid.effects.registry import nominal_effects
    from torchid.excitation.synthetic import PaperNoise
    from torchid.log.model import Log
    from torchid.simulation.closed_loop import closed_loop
    from torchid.simulation.controller import Controller
    from torchid.simulation.sensors import Sensors, measured_log, sensed_log

    if isinstance(noise, PaperNoise):
        raise TorchidError(
            "paper noise is for a torque that is computed from the trajectory.",
            got="--noise paper with --effect or --closed-loop",
            available=["--noise none", "--noise honest"],
        )
    parts = references.trajectories()
    logs = closed_loop(
        robot, parts, [effects] * len(parts), rate=rate, controller=Controller(frequency)
    )
    true = Log.concatenate(logs).replace(source=logs[0].source)
    sensed = [*nominal_effects(robot), *effects]
    if noise is None:
        return sensed_log(true, sensed)
    return measured_log(robot, true, sensed, Sensors(noise), seed)
