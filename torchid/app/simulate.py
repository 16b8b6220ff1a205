"""`torchid simulate`: a synthetic log along a trajectory."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from torchid.app import options as opt
from torchid.app.output import Computed
from torchid.app.signature import Switch, command
from torchid.errors import TorchidError

if TYPE_CHECKING:
    from torchid.excitation.synthetic import NoiseModel


@command
def simulate_command(
    *,
    arm: opt.Arm,
    trajectory: Annotated[Path, typer.Argument(metavar="TRAJECTORY")],
    to: opt.Written = None,
    noise: Literal["none", "paper", "honest"] = "honest",
    snr: float = 30.0,
    torque_noise: float = 0.01,
    encoder_bits: int = 18,
    colour: opt.Hertz = None,
    velocity_noise: float | None = None,
    effect: Annotated[list[str] | None, typer.Option(metavar="NAME:KEY=VALUE,..")] = None,
    closed_loop: Switch = False,
    rate: opt.Hertz = None,
    control_frequency: Annotated[float, typer.Option(metavar="HZ")] = 5.0,
    seed: opt.Seed = 0,
    output: Computed,
    device_name: opt.Device = "cpu",
) -> None:
    """Write the log that the robot would give along a trajectory.

    Without effects the nominal robot moves exactly along it. With `--effect` or `--closed-loop` a
    controller that knows the nominal robot follows it, and forward simulation tells how far the
    arm gets: effects change the motion, as they do on a real arm.

    Example: `torchid simulate kuka_lwr4_friction motion/trajectory.csv --to log.parquet`

    Example: `torchid simulate 3r motion/trajectory.csv --effect coulomb_friction:joint=2,Fc=0.6
    --effect torque_gain:joint=1,gain=0.05 --to log.parquet`

    Args:
        trajectory: File with t, q1.., dq1.., ddq1.. .
        to: Log file (.parquet, .csv, .npz).
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
    """
    from torchid.effects.written import effect_written
    from torchid.excitation.synthetic import HonestNoise, PaperNoise
    from torchid.excitation.synthetic import simulate as simulated
    from torchid.log.readers import read_log, write_log
    from torchid.simulation.controller import Controller

    target = to or (output.out and output.out / "log.parquet")
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
    found = arm.load()
    effects = [effect_written(text, found, "--effect") for text in effect or []]
    moves = closed_loop or bool(effects)
    if moves and noise == "paper":
        raise TorchidError(
            "paper noise is for a torque that is computed from the trajectory.",
            got="--noise paper with --effect or --closed-loop",
            available=["--noise none", "--noise honest"],
        )
    if rate is not None and not moves:
        raise TorchidError("--rate needs --closed-loop or --effect.", got=f"--rate {rate:g}")
    motion = read_log(trajectory)
    with output.progress("simulating"):
        log = simulated(
            found,
            motion,
            effects=effects,
            noise=model,
            closed_loop=moves,
            rate=rate,
            controller=Controller(control_frequency) if moves else None,
            seed=seed,
            device="cpu" if moves else opt.device(device_name),
        )
    write_log(log, target)
    output.written.append(target)
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
    output.warn(log.warnings)
    output.say(f"{log.samples} samples of {log.trajectory_count} trajectories")
