"""What `torchid demo` shows."""

from typing import Any

from matplotlib.figure import Figure

from torchid.report.identification import (
    effect_tables,
    error_table,
    headline,
    torque_figure,
    truth_figure,
)
from torchid.report.log import trajectory_figure
from torchid.report.table import Table
from torchid.study.demo import Demo


def _found(paper: Demo) -> list[tuple[str, float, float]]:
    """Name, identified and true value of every base parameter."""
    values, truth = paper.result.values.tolist(), paper.truth.tolist()
    return list(zip(paper.result.base.names, values, truth, strict=True))


def demo_record(paper: Demo, kuka: Demo) -> dict[str, Any]:
    """The schema torchid.demo/1."""
    design = kuka.design
    return {
        "schema": "torchid.demo/1",
        "paper_3r": {
            "parameters": [{"name": n, "value": v, "true": true} for n, v, true in _found(paper)],
            "largest_error": float((paper.result.values - paper.truth).abs().max()),
        },
        "kuka": {
            **kuka.result.plain(),
            "true": kuka.truth.tolist(),
            "inside_95": int(kuka.inside.sum()),
            "condition_number_of_motion": design
            and [design.start_condition, design.condition_after],
        },
    }


def tables(paper: Demo, kuka: Demo) -> list[Any]:
    """For the terminal."""
    design, inside = kuka.design, kuka.inside
    conditions = f"{design.start_condition:.0f} -> {design.condition_after:.0f}" if design else "-"
    return [
        Table(
            "The report's 3R (table A.1). Its noise of 30 dB is on the trajectory, and the torque "
            "is\ncomputed from it, so least squares recovers the parameters to rounding",
            ("base parameter", "identified", "true", "error"),
            [(n, f"{v:.6g}", f"{true:.6g}", f"{v - true:.0e}") for n, v, true in _found(paper)],
            words=("base parameter",),
        ),
        f"KUKA LWR IV+ with friction: designed trajectory, condition number {conditions}; encoder "
        "of 18 bits, torque noise of 1 %\n",
        *effect_tables(kuka.result),
        error_table(kuka.result),
        *(f"! {warning}" for warning in kuka.result.warnings),
        f"\n{headline(kuka.result)}",
        f"{int(inside.sum())} of {len(inside)} true values lie inside their 95 % intervals "
        "(the report's own f_v6 is negative, so signs are left free here).",
    ]


def figures(kuka: Demo) -> dict[str, Figure]:
    """Motion, held-out torque, parameters."""
    result, title = kuka.result, "torque on a motion never used for the fit"
    robot, shown = result.robot, result.held_out_predictions[0]
    return {
        "trajectory": trajectory_figure(robot, kuka.motion, "designed trajectory"),
        "validation": torque_figure(shown, ["N m"] * robot.n, title),
        "parameters": truth_figure(result, kuka.truth),
    }
