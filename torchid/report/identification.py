"""An identification as tables for people."""

import math
from collections import Counter
from collections.abc import Iterable

from torchid.design.motion import MOVING
from torchid.effects.base import Effect
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
    effects = effect_tables(result)
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


def effect_tables(result: Identification) -> list[Table]:
    """Coefficients with standard deviations: of effects on every joint with joints as rows, of
    those at some places one a row, with the shapes."""
    base, robot = result.base, result.robot
    mixed = len(set(robot.joint_types)) > 1
    prismatic = robot.joint_types[0] is JointType.PRISMATIC
    position = {k: b for b, k in enumerate(base.independent)}

    def value(k: int) -> str:
        """The coefficient in column k of all parameters."""
        b = position.get(k)
        if b is None or not base.is_single(b):
            return "in a sum"
        if not bool(result.free[b]):
            return "0 (held)"
        return f"{float(result.values[b]):.4g} ± {float(result.std[b]):.2g}"

    # Each effect with the texts of its coefficients.
    found: list[tuple[Effect, list[str]]] = []
    k = base.n_rigid_parameters
    for effect in result.effects:
        found.append((effect, [value(k + i) for i in range(len(effect.coefficients))]))
        k += len(effect.coefficients)
    counts = Counter(type(effect) for effect in result.effects)
    everywhere = [kind for kind, n in counts.items() if n == robot.n and not kind.shapes]
    if mixed:
        everywhere = []  # their units are not those of the column
    out = []
    if everywhere:
        columns = [
            f"{c.meaning}\n{c.name} [{c.unit_for(prismatic)}]"
            for kind in everywhere
            for c in kind.coefficients
        ]
        rows = []
        for j in range(robot.n):
            own = {type(e): texts for e, texts in found if e.joints == (j,)}
            rows.append((str(j + 1), *(text for kind in everywhere for text in own[kind])))
        title = "effects on the joints (value ± std)"
        out.append(Table(title, ("joint", *columns), rows, words=("joint",)))
    lines: list[tuple[str, ...]] = []
    for effect, texts in found:
        if type(effect) in everywhere:
            continue
        place = ", ".join(str(j + 1) for j in effect.joints)
        for c, text in zip(effect.coefficients, texts, strict=True):
            slides = robot.joint_types[effect.joints[0]] is JointType.PRISMATIC
            lines.append((effect.name, place, c.name, text, c.unit_for(slides)))
        for s, number in zip(effect.shapes, effect.shape_values, strict=True):
            lines.append((effect.name, place, s.name, f"{number:.4g}", s.unit))
    if lines:
        columns = ["effect", "joint", "", "value ± std", "unit"]
        title = "effects at their joints (shapes without a std are given, or were searched)"
        out.append(Table(title, columns, lines, names=("effect", "joint", "", "unit")))
    return out


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
