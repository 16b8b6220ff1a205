"""An examination of a log as a table and a figure for people."""

from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np
from rich.text import Text

from torchid.doctor.examine import Examination
from torchid.report.colours import BLUE, ORANGE
from torchid.report.panels import label, new_figure, styled
from torchid.report.table import Table
from torchid.report.text import joint_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STYLE = {"wrong": "bold red", "doubtful": "yellow", "cannot tell": "bright_black"}


def tables(examination: Examination) -> list[Table]:
    """What is not fine, wrong first; nothing where all is fine."""
    found = [c for c in examination.by_verdict() if c.verdict != "fine"]
    rows = []
    for (verdict, evidence, fix), group in groupby(found, lambda c: (c.verdict, c.evidence, c.fix)):
        names = "\n".join(c.name for c in group)
        rows.append((Text(verdict, _STYLE[verdict]), names, evidence, fix or ""))
    columns = ("verdict", "check", "evidence", "fix")
    title = f"log of {examination.robot.name}"
    return [Table(title, columns, rows, names=columns[:2], words=columns[2:])] if rows else []


def fine(examination: Examination) -> str:
    """The checks that found nothing, in one line."""
    names = [c.name for c in examination.checks if c.verdict == "fine"]
    return "fine: " + ", ".join(names) if names else "nothing is fine"


def choices(examination: Examination) -> str:
    """What somebody has to choose, with the option that does."""
    lines = []
    for check in examination.undecided:
        lines.append(f"{check.name}: explanations that this log cannot tell apart, none is applied")
        lines += [f'  --fix "{c.name}": {c.fix}' for c in check.choices]
    if examination.waiting:
        lines.append(f"{examination.waiting} more of the fixes wait for this choice")
    return "\n".join(lines)


def torque_figure(examination: Examination) -> "Figure | None":
    """Torque of each joint as the log has it, once mended, and what bodies explain of it."""
    judge, search = examination.judge, examination.search
    if judge is None or search is None:
        return None
    end = search.final.hypothesis
    columns, _ = judge.columns(end)
    measured, moving = judge.torque(end), judge.moving(end)
    explained = np.where(moving, columns @ search.final.fit.x, np.nan)
    n = examination.robot.n
    figure = new_figure(10, 0.8 + 1.3 * n)
    for k, axes in enumerate(figure.subplots(n, 1, sharex=True, squeeze=False)[:, 0]):
        styled(axes)
        unit = joint_unit(examination.robot, k)
        axes.plot(measured[:, k], color=BLUE, linewidth=1.2, label="measured, mended")
        axes.plot(explained[:, k], color=ORANGE, linewidth=1.0, label="best bodies, while moving")
        error = 100 * search.final.errors[k]
        label(axes, y=f"joint {k + 1} [{unit}]\n{error:.1f} %")
        if k == 0:
            where = {"loc": "lower right", "bbox_to_anchor": (1, 1)}
            axes.legend(**where, fontsize=8, ncols=2, frameon=False)
    axes.set_xlabel("low-passed samples, all trajectories", fontsize=8)
    return figure
