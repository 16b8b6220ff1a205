"""`torchid simulate`: a synthetic log along a trajectory."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from torchid.app.options import (
    Device,
    Json,
    Out,
    Quiet,
    RobotArgument,
    Seed,
    Threads,
    Tip,
    device,
    open_output,
)
from torchid.errors import TorchidError

if TYPE_CHECKING:
    from torchid.excitation.synthetic import NoiseModel


def simulate_command(
    robot: RobotArgument,
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
    tip: Tip = None,
    json_file: Json = None,
    out: Out = None,
    seed: Seed = 0,
    quiet: Quiet = False,
    threads: Threads = None,
    device_name: Device = "cpu",
) -> None:
    """Write the log that the nominal robot would give along a trajectory.

    Example: `torchid simulate kuka_lwr4_friction motion/trajectory.csv --to log.parquet`
    """
    output = open_output(json_file, out, quiet, threads)
    from torchid.excitation.synthetic import synthetic_log
    from torchid.log.readers import read_log, write_log
    from torchid.robot.library import load_robot

    target = to if to is not None else (None if out is None else out / "log.parquet")
    if target is None:
        raise TorchidError("nowhere to write the log.", expected="--to FILE or --out DIR")
    model = _noise(noise, snr, torque_noise, encoder_bits, colour, velocity_noise)
    found = load_robot(robot, tip=tip)
    log = synthetic_log(found, read_log(trajectory), model, seed, device=device(device_name))
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
            "seed": seed,
            "samples": log.samples,
            "trajectories": list(log.names),
            "torque_rms": log.tau.square().mean(0).sqrt().tolist(),
        },
        "simulation.json",
    )


def _noise(
    kind: str,
    snr: float,
    torque: float,
    bits: int,
    colour: float | None,
    velocity: float | None,
) -> "NoiseModel":
    from torchid.excitation.synthetic import HonestNoise, PaperNoise

    if kind == "none":
        return None
    if kind == "paper":
        return PaperNoise(snr_db=snr)
    if not 0 <= bits <= 40:
        raise TorchidError("--encoder-bits lies between 0 and 40.", got=bits)
    return HonestNoise(
        encoder_step=0.0 if bits == 0 else 2 * math.pi / 2**bits,
        torque_relative=torque,
        colour_hz=colour,
        include_velocity=velocity is not None,
        velocity_relative=velocity or 0.0,
    )
