"""`torchid demo`: the main job on the report's robots, in under a minute."""

from pathlib import Path
from typing import Annotated, Any

from torchid.app import options as opt
from torchid.app.output import Output, stage
from torchid.app.signature import Fields, command


@command
def demo_command(
    *,
    seed: opt.Seed = 0,
    output: Annotated[Output, Fields("json_file", "quiet", "threads", out=Path("demo"))],
    device_name: opt.Device = "cpu",
) -> None:
    """Identify the report's 3R and KUKA LWR IV+ from synthetic logs, and compare with the truth.

    Example: `torchid demo --out demo`

    Args:
        out: Folder for results.
    """
    report, report_told = _paper()
    kuka, kuka_told = _kuka(output, seed, opt.device(device_name))
    output.write_json({"schema": "torchid.demo/1", "paper_3r": report, "kuka": kuka}, "demo.json")
    output.say(*report_told, *kuka_told)


def _paper() -> tuple[dict[str, Any], list[Any]]:
    """The report's 3R: table 5.1's trajectories, 30 dB noise on them, table A.1."""
    from torchid.excitation.synthetic import PaperNoise, synthetic_log
    from torchid.excitation.trajectories import paper_trajectories_3r, trajectory_log
    from torchid.identification.base_parameters import nominal_values
    from torchid.identification.identify import Settings, identify
    from torchid.report.table import Table
    from torchid.robot.library import load_robot

    robot = load_robot("3r")
    motion = trajectory_log(paper_trajectories_3r(), 100.0)
    log = synthetic_log(robot, motion, PaperNoise(snr_db=30.0), seed=0)
    result = identify(robot, log, settings=Settings(effects=(), cutoff=None, method="ols"))
    truth = nominal_values(robot, result.base)
    found = list(zip(result.base.names, result.values.tolist(), truth.tolist(), strict=True))
    table = Table(
        "The report's 3R (table A.1). Its noise of 30 dB is on the trajectory, and the torque "
        "is\ncomputed from it, so least squares recovers the parameters to rounding",
        ("base parameter", "identified", "true", "error"),
        [(name, f"{v:.6g}", f"{true:.6g}", f"{v - true:.0e}") for name, v, true in found],
        words=("base parameter",),
    )
    record = {
        "parameters": [{"name": name, "value": v, "true": true} for name, v, true in found],
        "largest_error": float((result.values - truth).abs().max()),
    }
    return record, [table]


def _kuka(output: Output, seed: int, device: str) -> tuple[dict[str, Any], list[Any]]:
    """The KUKA with friction: a designed trajectory, honest noise, validation on new motion."""
    import torch
    from rich.markup import escape

    from torchid.effects.registry import on_every_joint
    from torchid.excitation.design import optimise_trajectory
    from torchid.excitation.synthetic import HonestNoise, synthetic_log
    from torchid.excitation.trajectories import sinusoid, trajectory_log
    from torchid.identification.base_parameters import nominal_values
    from torchid.identification.identify import Settings, identify
    from torchid.identification.record import record
    from torchid.log.model import Log
    from torchid.report.identification import (
        effect_tables,
        error_table,
        headline,
        torque_figure,
        truth_figure,
    )
    from torchid.report.log import trajectory_figure
    from torchid.robot.library import load_robot

    robot = load_robot("kuka_lwr4_friction")
    names = ("viscous_friction", "coulomb_friction", "torque_offset")
    with output.progress() as progress:
        design = optimise_trajectory(
            robot,
            on_every_joint(names, robot.n),
            seed=seed,
            device=device,
            progress=stage(progress, "designing the trajectory"),
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
    told = [
        f"KUKA LWR IV+ with friction: designed trajectory, condition number "
        f"{design.start_condition:.0f} -> {design.condition_after:.0f}; encoder of 18 bits, torque "
        "noise of 1 %\n",
        *effect_tables(result),
        error_table(result),
        *(f"! {escape(warning)}" for warning in result.warnings),
        f"\n{headline(result)}",
        f"{int(inside.sum())} of {len(inside)} true values lie inside their 95 % intervals "
        "(the report's own f_v6 is negative, so signs are left free here).",
    ]
    shown = result.held_out_predictions[0]
    title = "torque on a motion never used for the fit"
    output.draw(
        lambda: {
            "trajectory": trajectory_figure(robot, motion, "designed trajectory"),
            "validation": torque_figure(shown, ["N m"] * robot.n, title),
            "parameters": truth_figure(result, truth),
        }
    )
    data = {
        **record(result),
        "true": truth.tolist(),
        "inside_95": int(torch.count_nonzero(inside)),
        "condition_number_of_motion": [design.start_condition, design.condition_after],
    }
    return data, told
