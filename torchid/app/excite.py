"""`torchid excite`: trajectories that make the parameters visible."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from torchid.app import options as opt
from torchid.app.excite_for import designed_for, read_result, torque_use
from torchid.app.output import Output, open_output, progress_bar, stage
from torchid.errors import TorchidError
from torchid.json_data import plain

if TYPE_CHECKING:
    from torchid.excitation.fourier import FourierTrajectory
    from torchid.excitation.torque import TorqueLimits
    from torchid.robot.model import Robot


def excite_command(
    robot: Annotated[
        str | None,
        typer.Argument(
            metavar="[ROBOT]",
            help="Built-in name, or a .yaml (ours), .urdf or .xml (MJCF) file; with --for, the one "
            "that the result records if absent.",
        ),
    ] = None,
    result: Annotated[
        Path | None,
        typer.Option(
            "--for",
            metavar="RESULT",
            help="The next motion for an identification.json (fixes the parameters it knows least) "
            "or a gap.json (separates what it cannot tell apart, or shows what it could not test).",
        ),
    ] = None,
    kind: Annotated[
        Literal["optimised", "random", "sinusoid", "paper"],
        typer.Option(
            help="Optimised Fourier series, random ones, sinusoids for validation, or the "
            "report's table 5.1 (3R only).",
        ),
    ] = "optimised",
    to: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Trajectory file (.csv, .parquet, .npz)."),
    ] = None,
    count: Annotated[int, typer.Option(min=1, help="How many trajectories.")] = 1,
    criterion: Annotated[
        Literal["condition", "d_optimal", "a_optimal"] | None,
        typer.Option(
            help="What to improve: the condition number (default) or the determinant of the "
            "information; with --for an identification, its least known parameters (a_optimal, "
            "default) or all (d_optimal)."
        ),
    ] = None,
    effects: Annotated[
        str,
        typer.Option(help="Effects to be identified with it, comma-separated; `none`."),
    ] = "viscous_friction,coulomb_friction,torque_offset",
    duration: Annotated[float, typer.Option(help="Seconds.")] = 20.0,
    rate: Annotated[float, typer.Option(help="Samples per second in the file [Hz].")] = 100.0,
    harmonics: Annotated[int, typer.Option(min=1, help="Harmonics of the series.")] = 5,
    restarts: Annotated[int, typer.Option(min=1, help="Random starts of the design.")] = 8,
    usage: Annotated[float, typer.Option(help="Share of the limits that may be used.")] = 1.0,
    max_velocity: Annotated[
        str | None,
        typer.Option(metavar="V|V1,V2,..", help="Velocity limits, in place of the robot's."),
    ] = None,
    max_acceleration: opt.MaxAcceleration = None,
    tip: opt.Tip = None,
    json_file: opt.Json = None,
    out: opt.Out = None,
    seed: opt.Seed = 0,
    quiet: opt.Quiet = False,
    threads: opt.Threads = None,
    device_name: opt.Device = "cpu",
) -> None:
    """Design an exciting trajectory within the robot's limits, at rest at both ends.

    Torque limits are kept by the robot's parameters, or those that RESULT holds, if there are any.

    Example: `torchid excite kuka_lwr4 --out motion`

    Example: `torchid excite --for result/identification.json --max-acceleration 5 --out next`
    """
    output = open_output(json_file, out, quiet, threads)
    from torchid.robot.library import load_robot
    from torchid.robot.record import recorded_robot

    target = to
    if to is None and out is not None:
        target = out / "trajectory.csv"
    if target is None and output.json_file is None:
        raise TorchidError(
            "nowhere to write the trajectory.", expected="--to FILE, --out DIR or --json FILE"
        )
    for name, value in (("--duration", duration), ("--rate", rate), ("--usage", usage)):
        if not value > 0:
            raise TorchidError(f"{name} must be positive.", got=value)
    if usage > 1:
        raise TorchidError("--usage is a share of the limits.", got=usage, expected="0..1")
    if duration * rate > 1e7:
        raise TorchidError(
            "the trajectory would have more than ten million samples.",
            got=f"{duration:g} s at {rate:g} Hz",
        )
    settings: dict[str, Any] = {"harmonics": harmonics, "duration": duration, "usage": usage}
    found = None if robot is None else load_robot(robot, tip=tip)
    if result is not None:
        if kind != "optimised" or count != 1:
            raise TorchidError(
                "--for RESULT designs one optimised trajectory.",
                got=f"--kind {kind} --count {count}",
            )
        data = read_result(result)
        found = found or recorded_robot(data, str(result))
    if found is None:
        if result is not None:
            raise TorchidError(
                f"'{result}' does not record its robot.", expected="torchid excite ROBOT"
            )
        raise TorchidError("which robot?", expected="torchid excite ROBOT, or --for RESULT")
    arm = opt.limited(found, max_velocity, max_acceleration)
    if result is not None:
        best, record, torque = designed_for(
            result, data, arm, seed, criterion, restarts, settings, output
        )
        made: list[Any] = [best]
        record |= {"result": result.name, "trajectories": _coefficients([best])}
    elif kind == "optimised":
        settings |= {"restarts": restarts, "criterion": criterion or "condition"}
        settings["device"] = opt.device(device_name)
        names = opt.effect_names(effects)
        made, record, torque = _optimised(arm, names, seed, count, settings, output)
    else:
        made, record, torque = _given(arm, kind, seed, count, settings)
    record |= torque_use(arm, torque, made, output)
    _write(arm, "next" if result else kind, made, rate, record, target, output)


def _given(
    robot: "Robot", kind: str, seed: int, count: int, settings: dict[str, Any]
) -> "tuple[list[Any], dict[str, Any], TorqueLimits | None]":
    from torchid.excitation.torque import nominal_torque_limits
    from torchid.excitation.trajectories import (
        paper_trajectories_3r,
        random_trajectory,
        sinusoid,
    )

    torque = nominal_torque_limits(robot, usage=settings["usage"])
    if kind == "sinusoid":
        made = [
            sinusoid(robot, seed + k, duration=settings["duration"], usage=settings["usage"])
            for k in range(count)
        ]
        return [torque.within(x) for x in made] if torque else made, {}, torque
    if kind == "paper":
        if not robot.name.startswith("3r"):
            raise TorchidError(
                "table 5.1 is for the 3R.", got=robot.name, available=["3r", "3r_friction"]
            )
        series = paper_trajectories_3r()
        three = _coefficients([series.select(k) for k in range(3)])
        return [series], {"trajectories": three}, torque
    series_list = [random_trajectory(robot, seed + k, fill=True, **settings) for k in range(count)]
    if torque is not None:
        series_list = [torque.within(x) for x in series_list]
    return list(series_list), {"trajectories": _coefficients(series_list)}, torque


def _optimised(
    robot: "Robot",
    effects: tuple[str, ...],
    seed: int,
    count: int,
    settings: dict[str, Any],
    output: Output,
) -> "tuple[list[Any], dict[str, Any], TorqueLimits | None]":
    from torchid.effects.registry import on_every_joint
    from torchid.excitation.design import optimise_trajectory

    found = []
    with progress_bar(output) as progress:
        for k in range(count):
            told = stage(progress, f"trajectory {k + 1} of {count}")
            every = on_every_joint(effects, robot.n)
            found.append(
                optimise_trajectory(robot, every, seed=seed + k, progress=told, **settings)
            )
    for k, design in enumerate(found, start=1):
        output.say(
            f"trajectory {k}: condition number {design.start_condition:.0f} (median random start) "
            f"-> {design.condition_after:.0f}"
        )
    record = {
        "criterion": settings["criterion"],
        "condition_number_before": [f.start_condition for f in found],
        "condition_number_after": [f.condition_after for f in found],
        "trajectories": _coefficients([f.trajectory for f in found]),
    }
    return [f.trajectory for f in found], record, found[0].torque


def _coefficients(series: "list[FourierTrajectory]") -> list[dict[str, Any]]:
    names = ("a", "b", "q0", "w_f", "duration", "ramp")
    return [{name: plain(getattr(s, name)) for name in names} for s in series]


def _write(
    robot: "Robot",
    kind: str,
    trajectories: list[Any],
    rate: float,
    record: dict[str, Any],
    target: Path | None,
    output: Output,
) -> None:
    """The log of the motions, their figures and their record."""
    from torchid.excitation.trajectories import trajectory_log
    from torchid.log.model import Log
    from torchid.log.readers import write_log
    from torchid.report.log import trajectory_figure

    logs = [trajectory_log(x, rate) for x in trajectories]
    log = Log.concatenate(logs) if len(logs) > 1 else logs[0]
    output.warn(log.warnings)
    written = []
    if target is not None:
        write_log(log, target)
        written.append(target)
    title = f"{robot.name}: {kind} trajectory"
    drawn = output.draw(
        lambda: {
            f"trajectory_{k}": trajectory_figure(robot, part, f"{title} {k}")
            for k, part in enumerate(log.trajectories(), start=1)
        }
    )
    written += [output.folder / name for name in drawn if output.folder is not None]
    output.write_json(
        {
            "schema": "torchid.excitation/1",
            "robot": robot.name,
            "kind": kind,
            "file": None if target is None else target.name,
            **record,
            "warnings": list(log.warnings),
        },
        "excitation.json",
    )
    if written:
        output.say("written: " + ", ".join(str(path) for path in written))
