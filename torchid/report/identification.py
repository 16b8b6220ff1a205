"""An identification as tables for people."""

import math
from collections.abc import Iterable

from torchid.design.motion import MOVING
from torchid.effects.base import JointEffect
from torchid.identification.identify import Identification
from torchid.identification.validation import Errors
from torchid.report.table import Table
from torchid.report.table import compact as compact  # the catalogue takes it from here
from torchid.report.text import joint_unit
from torchid.robot.model import JointType

_ZERO = 100.0
"""Half-width of the 95 % interval in % of the value: beyond it, zero is possible."""


def tables(result: Identification) -> list[Table]:
    """Base parameters, effects per joint, errors per joint."""
    effects = [effect_table(result)] if result.effects else []
    return [parameter_table(result), *effects, error_table(result)]


def shown_errors(result: Identification) -> tuple[Errors, bool]:
    """The errors that count, and whether they are on held-out data."""
    held = result.held_out
    return (result.fit, False) if held is None else (held, True)


def headline(result: Identification) -> str:
    """One sentence: what was identified, and how well it predicts."""
    shown, held = shown_errors(result)
    percent = ", ".join(f"{v:.1f}" for v in shown.relative_percent.tolist())
    moving = ", ".join(f"{v:.1f}" for v in shown.relative_percent_moving.tolist())
    cutoff = "no filter" if result.cutoff is None else f"cut-off {result.cutoff:g} Hz"
    count, every = len(poor_names(result)), len(result.base)
    poor = f" {count} of {every} cannot be told from zero (95 %)." if count else ""
    return (
        f"{result.base.n_rigid} base parameters of {result.robot.name} and "
        f"{every - result.base.n_rigid} coefficients of effects ({cutoff}, condition "
        f"number {result.scaled_condition_number:.0f} with scaled columns). Torque error on "
        f"{'held-out data' if held else 'the fitted data'}, % per joint: {percent} (while moving: "
        f"{moving}).{poor}"
    )


def poor_names(result: Identification) -> list[str]:
    """Names of estimated coefficients whose 95 % interval holds zero, the worst first."""
    half = result.uncertainty.quantile() * result.relative_std_percent
    bad = [k for k in range(len(result.base)) if bool(result.free[k]) and float(half[k]) > _ZERO]
    return [result.base.names[k] for k in sorted(bad, key=lambda k: -float(half[k]))]


def parameter_table(result: Identification) -> Table:
    """Names, values, standard deviations."""
    base, rows = result.base, []
    for k in range(base.n_rigid):
        spread = ("-", "held at 0")
        if bool(result.free[k]):
            relative = percent_words(float(result.relative_std_percent[k]))
            spread = (f"{float(result.std[k]):.2g}", relative)
        rows.append((base.names[k], f"{float(result.values[k]):.5g}", base.units[k], *spread))
    return Table(
        f"{base.n_rigid} base parameters of {result.robot.name}",
        ("base parameter", "value", "unit", "std", "std %"),
        rows,
        names=("unit",),
        words=("base parameter",),
    )


def percent_words(relative: float) -> str:
    """A standard deviation in percent of its value."""
    return f"{relative:.1f}" if relative < 1e4 else "> 10⁴"


def effect_table(result: Identification) -> Table:
    """Coefficients with standard deviations, joints as rows."""
    base, robot = result.base, result.robot
    mixed = len(set(robot.joint_types)) > 1
    position = {base.parameter_names[k]: b for b, k in enumerate(base.independent)}
    cells = {}
    for name in base.parameter_names[base.n_rigid_parameters :]:
        b = position.get(name)
        if b is None or not base.is_single(b):
            cells[name] = "in a sum"
        elif not bool(result.free[b]):
            cells[name] = "0 (held)"
        else:
            unit = f" {base.units[b]}" if mixed else ""
            cells[name] = f"{float(result.values[b]):.4g} ± {float(result.std[b]):.2g}{unit}"
    kinds: dict[str, JointEffect] = {}
    for effect in result.effects:
        kinds.setdefault(effect.name, effect)
    coefficients = [c for kind in kinds.values() for c in kind.coefficients]
    prismatic = robot.joint_types[0] is JointType.PRISMATIC
    headings = [
        f"{c.meaning}\n{c.name}" + ("" if mixed else f" [{c.unit_for(prismatic)}]")
        for c in coefficients
    ]
    rows = [
        (str(joint), *(cells[f"{c.name}{joint}"] for c in coefficients))
        for joint in range(1, robot.n + 1)
    ]
    title = "effects on the joints (value ± std)"
    return Table(title, ("joint", *headings), rows, words=("joint",))


def error_table(result: Identification) -> Table:
    """Relative errors per joint, in percent, and RMSE."""

    def cells(values: Iterable[float]) -> list[str]:
        return [f"{v:.2f}" if math.isfinite(v) else "-" for v in values]

    unit = "; ".join(dict.fromkeys(joint_unit(result.robot, j) for j in range(result.robot.n)))
    rows: list[list[str]] = []
    for label, errors in (("fit", result.fit), ("held out", result.held_out)):
        if errors is None:
            continue
        for name, percent in (
            ("all", errors.relative_percent),
            ("moving", errors.relative_percent_moving),
            ("raw torque", errors.relative_percent_raw),
        ):
            values = percent.tolist()
            rows.append([f"{label}, {name}", *cells([*values, sum(values) / len(values)])])
        rmse = [f"{v:.3g}" for v in errors.rmse.tolist()]
        rows += [[f"{label}, RMSE [{unit}]", *rmse, ""], []]
    band = result.settings.error_cutoff or result.cutoff
    note = "unfiltered" if band is None else f"filtered at {band:g} Hz"
    return Table(
        f"torque error, 100 ||tau - model|| / ||tau||, per joint ({note}; "
        f"moving: |dq| > {MOVING:g})",
        ("data, rows", *(str(j + 1) for j in range(result.robot.n)), "mean"),
        rows,
        words=("data, rows",),
    )
