"""What `torchid demo` shows."""

from functools import partial

from torchid.report import identification as one
from torchid.report.log import trajectory_figure
from torchid.report.table import Shown, Table
from torchid.study.demo import Demo


def shown(paper: Demo, kuka: Demo) -> Shown:
    """For the terminal, and as figures of motion, held-out torque and parameters."""
    design, inside, result = kuka.design, kuka.inside, kuka.result
    robot, new = result.robot, result.held_out_predictions[0]
    title = "torque on a motion never used for the fit"
    conditions = f"{design.start_condition:.0f} -> {design.condition_after:.0f}" if design else "-"
    return Shown(
        parts=[
            Table(
                "The report's 3R (table A.1). Its noise of 30 dB is on the trajectory, and the "
                "torque is\ncomputed from it, so least squares recovers the parameters to rounding",
                ("base parameter", "identified", "true", "error"),
                [(n, f"{v:.6g}", f"{true:.6g}", f"{v - true:.0e}") for n, v, true in paper.found],
                words=("base parameter",),
            ),
            f"KUKA LWR IV+ with friction: designed trajectory, condition number {conditions}; "
            "encoder of 18 bits, torque noise of 1 %\n",
            *one.effect_tables(result),
            one.error_table(result),
            *(f"! {warning}" for warning in result.warnings),
            f"\n{one.headline(result)}",
            f"{int(inside.sum())} of {len(inside)} true values lie inside their 95 % intervals "
            "(the report's own f_v6 is negative, so signs are left free here).",
        ],
        figures={
            "trajectory": partial(trajectory_figure, robot, kuka.motion, "designed trajectory"),
            "validation": partial(one.torque_figure, new, ["N m"] * robot.n, title),
            "parameters": partial(one.truth_figure, result, kuka.truth),
        },
    )
