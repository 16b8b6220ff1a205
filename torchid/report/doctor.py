"""What an examination of a log finds, for people."""

from functools import partial
from itertools import groupby

import numpy as np
from rich.text import Text

from torchid.doctor.examine import Examination, conclusion
from torchid.doctor.search import percent
from torchid.report.colours import BLUE, ORANGE
from torchid.report.panels import Figure, finish, joint_rows
from torchid.report.table import Report, Table
from torchid.robot.model import joint_unit

_STYLE = {"wrong": "bold red", "doubtful": "yellow", "cannot tell": "bright_black"}


def doctor_table(examination: Examination) -> Table:
    """What is not fine, wrong first."""
    odd = [c for c in examination.by_verdict() if c.verdict != "fine"]
    rows = []
    for (verdict, evidence, fix), group in groupby(odd, lambda c: (c.verdict, c.evidence, c.fix)):
        names = "\n".join(c.name for c in group)
        rows.append((Text(verdict, _STYLE[verdict]), names, evidence, fix or ""))
    columns = ("verdict", "check", "evidence", "fix")
    title = f"log of {examination.robot.name}"
    return Table(title, columns, rows, "llpp")


def report_of_examination(examination: Examination) -> Report:
    """All that there is to see of an examination."""
    names = [c.name for c in examination.checks if c.verdict == "fine"]
    fine = f"fine: {', '.join(names)}" if names else "nothing is fine"
    remedy = next((c.fix for c in examination.by_verdict() if c.verdict == "wrong" and c.fix), "")
    first = f" Do first: {remedy.rstrip('.')}." if remedy else ""
    return Report(
        verdict=f"{conclusion(examination)}{first}",
        parts=[doctor_table(examination), fine, choices(examination)],
        figures={"doctor": partial(torque_figure, examination)},
    )


def choices(examination: Examination) -> str:
    """What somebody has to choose, with the option that does."""
    lines = []
    for check in examination.undecided:
        lines.append(f"{check.name}: explanations that this log cannot tell apart, none is applied")
        lines += [f'  --fix "{c.name}": {c.fix}' for c in check.choices]
    offered = [c for c in examination.checks if len(c.choices) == 1 and c.chosen is None]
    lines += [f'if you know it to be so: --fix "{c.choices[0].name}"' for c in offered]
    if examination.waiting:
        lines.append(f"{examination.waiting} more of the fixes wait for this choice")
    return "\n".join(lines)


def torque_figure(examination: Examination) -> Figure | None:
    """Torque of each joint as the log has it, once mended, and what bodies explain of it."""
    judge, search = examination.judge, examination.search
    if judge is None or search is None:
        return None
    end = search.final.hypothesis
    rows = judge.columns(end).rows
    measured, moving = judge.torque(end), judge.moving(end)
    explained = np.where(moving, (rows @ search.final.fit.x).T, np.nan)
    n, x = examination.robot.n, "low-passed samples, all trajectories"
    figure, grid = joint_rows(n, ("",), (10, 0.8 + 1.3 * n), x=x)
    for k, axes in enumerate(grid[:, 0]):
        axes.plot(measured[:, k], color=BLUE, linewidth=1.2, label="measured, mended")
        axes.plot(explained[:, k], color=ORANGE, linewidth=1.0, label="best bodies, while moving")
        unit, left = joint_unit(examination.robot, k), percent(search.left[k])
        axes.set_ylabel(f"joint {k + 1} [{unit}]\n{left} left")
    title = f"{examination.robot.name}: torque, explained by bodies; % left on time held out"
    return finish(figure, title, grid[0, 0])
