"""An identification as tables for people."""

import math

from rich import box
from rich.table import Table

from torchid.design.motion import MOVING
from torchid.effects.base import JointEffect
from torchid.identification.identify import Identification
from torchid.identification.validation import Errors
from torchid.robot.model import JointType

_ZERO = 100.0
"""Half-width of the 95 % interval in % of the value: beyond it, zero is possible."""


def tables(result: Identification) -> list[Table]:
    """Base parameters, effects per joint, errors per joint."""
    out = [parameter_table(result)]
    if result.effects:
        out.append(effect_table(result))
    out.append(error_table(result))
    return out


def headline(result: Identification) -> str:
    """One sentence: what was identified, and how well it predicts."""
    shown, where = (
        (result.fit, "the fitted data")
        if result.held_out is None
        else (result.held_out, "held-out data")
    )
    percent = ", ".join(f"{v:.1f}" for v in shown.relative_percent.tolist())
    moving = ", ".join(f"{v:.1f}" for v in shown.relative_percent_moving.tolist())
    cutoff = "no filter" if result.cutoff is None else f"cut-off {result.cutoff:g} Hz"
    return (
        f"{result.base.n_rigid} base parameters of {result.robot.name} and "
        f"{len(result.base) - result.base.n_rigid} coefficients of effects ({cutoff}, condition "
        f"number {result.scaled_condition_number:.0f} with scaled columns). Torque error on "
        f"{where}, % per joint: {percent} (while moving: {moving}).{_poor(result)}"
    )


def _poor(result: Identification) -> str:
    count = len(poor_names(result))
    return f" {count} of {len(result.base)} cannot be told from zero (95 %)." if count else ""


def poor_names(result: Identification) -> list[str]:
    """Names of estimated coefficients whose 95 % interval holds zero, the worst first."""
    half = result.uncertainty.quantile() * result.relative_std_percent
    bad = [k for k in range(len(result.base)) if bool(result.free[k]) and float(half[k]) > _ZERO]
    return [result.base.names[k] for k in sorted(bad, key=lambda k: -float(half[k]))]


def parameter_table(result: Identification) -> Table:
    """Names, values, standard deviations."""
    table = compact(f"{result.base.n_rigid} base parameters of {result.robot.name}")
    table.add_column("base parameter", overflow="fold", ratio=1)
    for heading in ("value", "unit", "std", "std %"):
        table.add_column(heading, justify="left" if heading == "unit" else "right", no_wrap=True)
    for k in range(result.base.n_rigid):
        table.add_row(
            result.base.names[k], f"{float(result.values[k]):.5g}", result.base.units[k],
            *_spread(result, k),
        )  # fmt: skip
    return table


def effect_table(result: Identification) -> Table:
    """Coefficients with standard deviations, joints as rows."""
    table = compact("effects on the joints (value ± std)")
    table.add_column("joint")
    kinds: dict[str, list[JointEffect]] = {}
    for effect in result.effects:
        kinds.setdefault(effect.name, []).append(effect)
    mixed = len(set(result.robot.joint_types)) > 1
    prismatic = result.robot.joint_types[0] is JointType.PRISMATIC
    for members in kinds.values():
        for c in members[0].coefficients:
            unit = "" if mixed else f" \\[{c.unit_for(prismatic)}]"
            table.add_column(f"{c.meaning}\n{c.name}{unit}", justify="right")
    cells = _effect_cells(result)
    for joint in range(result.robot.n):
        row = [
            cells[f"{c.name}{joint + 1}"]
            for members in kinds.values()
            for c in members[0].coefficients
        ]
        table.add_row(str(joint + 1), *row)
    return table


def _effect_cells(result: Identification) -> dict[str, str]:
    """Text for every effect coefficient by its name."""
    names = result.base.parameter_names
    position = {names[k]: b for b, k in enumerate(result.base.independent)}
    mixed = len(set(result.robot.joint_types)) > 1
    cells = {}
    for name in names[result.base.n_rigid_parameters :]:
        b = position.get(name)
        if b is None or not result.base.is_single(b):
            cells[name] = "in a sum"
        elif not bool(result.free[b]):
            cells[name] = "0 (held)"
        else:
            unit = f" {result.base.units[b]}" if mixed else ""
            cells[name] = f"{float(result.values[b]):.4g} ± {float(result.std[b]):.2g}{unit}"
    return cells


def error_table(result: Identification) -> Table:
    """Relative errors per joint, in percent, and RMSE."""
    band = result.settings.error_cutoff or result.cutoff
    note = "unfiltered" if band is None else f"filtered at {band:g} Hz"
    table = compact(
        f"torque error, 100 ||tau - model|| / ||tau||, per joint ({note}; "
        f"moving: |dq| > {MOVING:g})"
    )
    kinds = dict.fromkeys(result.robot.joint_types)
    unit = "; ".join("N" if kind is JointType.PRISMATIC else "N m" for kind in kinds)
    table.add_column("data, rows")
    for i in range(result.robot.n):
        table.add_column(str(i + 1), justify="right", no_wrap=True)
    table.add_column("mean", justify="right")
    for label, errors in (("fit", result.fit), ("held out", result.held_out)):
        if errors is not None:
            _error_rows(table, label, errors, unit)
    return table


def compact(title: str) -> Table:
    """An empty table in the house style."""
    return Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1))


def _error_rows(table: Table, label: str, e: Errors, unit: str) -> None:
    rows = (
        ("all", e.relative_percent),
        ("moving", e.relative_percent_moving),
        ("raw torque", e.relative_percent_raw),
    )
    for name, values in rows:
        listed = values.tolist()
        mean = sum(listed) / len(listed)
        table.add_row(f"{label}, {name}", *(_percent(v) for v in listed), _percent(mean))
    table.add_row(
        f"{label}, RMSE \\[{unit}]", *(f"{v:.3g}" for v in e.rmse.tolist()), "", end_section=True
    )


def _percent(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "-"


def _spread(result: Identification, k: int) -> tuple[str, str]:
    if not bool(result.free[k]):
        return "-", "held at 0"
    relative = float(result.relative_std_percent[k])
    return f"{float(result.std[k]):.2g}", f"{relative:.1f}" if relative < 1e4 else "> 10⁴"
