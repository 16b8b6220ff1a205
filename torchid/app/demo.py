"""`torchid demo`: the main job on the report's robots, in under a minute."""

from pathlib import Path
from typing import Annotated, Any

import typer

from torchid.app.options import Device, Json, Quiet, Seed, Threads, device
from torchid.app.output import Output, open_output, progress_bar


def demo_command(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for results.")] = Path(
        "demo"
    ),
    json_file: Json = None,
    seed: Seed = 0,
    quiet: Quiet = False,
    threads: Threads = None,
    device_name: Device = "cpu",
) -> None:
    """Identify the report's 3R and KUKA LWR IV+ from synthetic logs, and compare with the truth.

    Example: `torchid demo --out demo`
    """
    output = open_output(json_file, out, quiet, threads)
    report = _paper(output)
    kuka = _kuka(output, seed, device(device_name))
    output.write_json({"schema": "torchid.demo/1", "paper_3r": report, "kuka": kuka}, "demo.json")
    output.say(f"\nfigures and JSON are in {out}")


def _paper(output: Output) -> dict[str, Any]:
    """The report's 3R: table 5.1's trajectories, 30 dB noise on them, table A.1."""
    from torchid.excitation.synthetic import PaperNoise, synthetic_log
    from torchid.excitation.trajectories import paper_trajectories_3r, trajectory_log
    from torchid.identification.base_parameters import nominal_values
    from torchid.identification.identify import Settings, identify
    from torchid.report.identification import compact
    from torchid.robot.library import load_robot

    robot = load_robot("3r")
    motion = trajectory_log(paper_trajectories_3r(), 100.0)
    log = synthetic_log(robot, motion, PaperNoise(snr_db=30.0), seed=0)
    result = identify(robot, log, settings=Settings(effects=(), cutoff=None, method="ols"))
    truth = nominal_values(robot, result.base)
    table = compact(
        "The report's 3R (table A.1). Its noise of 30 dB is on the trajectory, and the torque is\n"
        "computed from it, so least squares recovers the parameters to rounding"
    )
    for heading in ("base parameter", "identified", "true", "error"):
        table.add_column(heading, justify="left" if heading == "base parameter" else "right")
    rows = zip(result.base.names, result.values.tolist(), truth.tolist(), strict=True)
    for name, value, true in rows:
        table.add_row(name, f"{value:.6g}", f"{true:.6g}", f"{value - true:.0e}")
    output.say(table)
    return {
        "parameters": [
            {"name": n, "value": v, "true": t}
            for n, v, t in zip(
                result.base.names, result.values.tolist(), truth.tolist(), strict=True
            )
        ],
        "largest_error": float((result.values - truth).abs().max()),
    }


def _kuka(output: Output, seed: int, device: str) -> dict[str, Any]:
    """The KUKA with friction: a designed trajectory, honest noise, validation on new motion."""
    import torch

    from torchid.effects.registry import on_every_joint
    from torchid.excitation.design import optimise_trajectory
    from torchid.excitation.synthetic import HonestNoise, synthetic_log
    from torchid.excitation.trajectories import sinusoid, trajectory_log
    from torchid.identification.base_parameters import nominal_values
    from torchid.identification.identify import Settings, identify
    from torchid.identification.record import record
    from torchid.log.model import Log
    from torchid.report.excitation import trajectory_figure
    from torchid.report.figures import save, torque_figure, truth_figure
    from torchid.report.identification import effect_table, error_table, headline
    from torchid.robot.library import load_robot

    robot = load_robot("kuka_lwr4_friction")
    names = ("viscous_friction", "coulomb_friction", "torque_offset")
    with progress_bar(output) as progress:
        design = optimise_trajectory(
            robot,
            on_every_joint(names, robot.n),
            seed=seed,
            device=device,
            progress=None
            if progress is None
            else (lambda done, total: progress("designing the trajectory", done, total)),
        )
        motion = trajectory_log(design.trajectory, 200.0)
        log = synthetic_log(robot, motion, HonestNoise(), seed)
        checks = [trajectory_log(sinusoid(robot, seed + k), 200.0) for k in range(2)]
        new = synthetic_log(robot, Log.concatenate(checks), HonestNoise(), seed + 1)
        # The report's f_v6 is negative: the signs are left free to find it.
        settings = Settings(effects=names, signs="free")
        result = identify(
            robot, log, held_out=new, settings=settings, device=device, progress=progress
        )
    truth = nominal_values(robot, result.base)
    interval = result.interval()
    inside = (interval[:, 0] <= truth) & (truth <= interval[:, 1])
    output.say(
        f"KUKA LWR IV+ with friction: designed trajectory, condition number "
        f"{design.start_condition:.0f} -> {design.condition_after:.0f}; encoder of 18 bits, torque "
        "noise of 1 %\n"
    )
    output.say(effect_table(result))
    output.say(error_table(result))
    output.warn(result.warnings)
    output.say(f"\n{headline(result)}")
    output.say(
        f"{int(inside.sum())} of {len(inside)} true values lie inside their 95 % intervals "
        "(the report's own f_v6 is negative, so signs are left free here)."
    )
    assert output.folder is not None
    save(trajectory_figure(robot, motion, "designed trajectory"), output.folder / "trajectory.png")
    shown = result.held_out_predictions[0]
    torque = torque_figure(shown, ["N m"] * robot.n, "torque on a motion never used for the fit")
    save(torque, output.folder / "validation.png")
    save(truth_figure(result, truth), output.folder / "parameters.png")
    return {
        **record(result),
        "true": truth.tolist(),
        "inside_95": int(torch.count_nonzero(inside)),
        "condition_number_of_motion": [design.start_condition, design.condition_after],
    }
