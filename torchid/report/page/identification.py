"""An identification as a page."""

import math
from collections.abc import Sequence

from torchid.identification.identify import Identification
from torchid.identification.result import UNEXPLAINED
from torchid.identification.validation import Prediction
from torchid.report.figures import parameter_figure, torque_figure
from torchid.report.gap_words import listed
from torchid.report.identification import effect_table, error_table, poor_names
from torchid.report.page.document import Page, Picture, Section, unit_words
from torchid.report.page.from_rich import sheet
from torchid.report.page.origin import Origin
from torchid.report.study.sheets import Sheet
from torchid.robot.model import JointType

MOST_TRAJECTORIES = 3
"""Shown as pictures."""
_MOST_NAMED = 3


def identification_page(result: Identification, origin: Origin) -> Page:
    """The page of an identification."""
    n = result.base.n_rigid
    sheets = [sheet(error_table(result))]
    if result.effects:
        sheets.append(sheet(effect_table(result)))
    sheets.append(coefficient_sheet(result, range(n), "Base parameters"))
    if len(result.base) > n:
        rest = range(n, len(result.base))
        sheets.append(coefficient_sheet(result, rest, "Coefficients of the effects"))
    return Page(
        title=f"Identified dynamics of {result.robot.name}",
        verdict=verdict(result),
        facts=_facts(result),
        sections=(
            Section("pictures", "Pictures", pictures=_pictures(result)),
            Section("numbers", "Numbers", sheets=tuple(sheets)),
            Section("remarks", "To bear in mind", notes=result.warnings),
        ),
        origin=origin,
    )


def verdict(result: Identification) -> str:
    """One sentence: how well the torque is predicted, and what is poorly determined."""
    shown, where = (
        (result.fit, "the motion it was fitted to (none was held out)")
        if result.held_out is None
        else (result.held_out, "motion that was held out")
    )
    errors = [(v, j) for j, v in enumerate(shown.relative_percent_moving.tolist(), start=1)]
    known = sorted(pair for pair in errors if math.isfinite(pair[0]))
    if not known:
        said = f"no joint moves in {where}, so how well the torque is predicted is not known"
    else:
        (low, best), (high, worst) = known[0], known[-1]
        span = f"{_percent(high)} of its size"
        if len(known) > 1:
            span = f"{_percent(low)} (joint {best}) to {_percent(high)} (joint {worst}) of its size"
        useless = " and is of no use there" if high > UNEXPLAINED else ""
        said = f"on {where} the model misses the torque by {span} while the joint moves{useless}"
    return f"{said[0].upper()}{said[1:]}; {_determined(result)}."


def _percent(value: float) -> str:
    return f"{value:.1f} %" if value >= 1 else f"{value:.2g} %"


def _determined(result: Identification) -> str:
    """What is poorly determined, or that nothing is."""
    total = f"{len(result.base)} coefficients"
    never, poor = result.undetermined, poor_names(result)
    parts = []
    if never:
        parts.append(f"{len(never)} not determined at all ({_named(never)})")
    if poor:
        parts.append(f"{len(poor)} cannot be told from zero ({_named(poor)})")
    if not parts:
        return f"all {total} that were estimated can be told from zero"
    return f"of {total}, {listed(parts)}"


def _named(names: Sequence[str]) -> str:
    shown, more = [_short(name) for name in names[:_MOST_NAMED]], len(names) - _MOST_NAMED
    return f"{', '.join(shown)} and {more} more" if more > 0 else listed(shown)


def _short(name: str, length: int = 30) -> str:
    return name if len(name) <= length else name[: length - 1] + "…"


def _facts(result: Identification) -> tuple[tuple[str, str], ...]:
    shown, label = (
        (result.fit, "fitted") if result.held_out is None else (result.held_out, "held-out")
    )
    known = [v for v in shown.relative_percent_moving.tolist() if math.isfinite(v)]
    mean = _percent(sum(known) / len(known)) if known else "-"
    return (
        (f"Mean error, {label}, moving", mean),
        ("Base parameters", str(result.base.n_rigid)),
        ("Coefficients of effects", str(len(result.base) - result.base.n_rigid)),
        ("Cut-off", "no filter" if result.cutoff is None else f"{result.cutoff:g} Hz"),
        ("Condition number, scaled", f"{result.scaled_condition_number:.0f}"),
    )


def coefficient_sheet(result: Identification, which: Sequence[int], title: str) -> Sheet:
    """Values with standard deviations and 95 % intervals.

    Args:
        result: what was identified.
        which: positions in `base.names`.
        title: of the table.
    """
    ends = result.interval().tolist()
    rows = []
    for k in which:
        relative = float(result.relative_std_percent[k])
        spread = ("held at 0", "-", "-")
        if bool(result.free[k]):
            spread = (
                f"{float(result.std[k]):.3g}",
                "[{}, {}]".format(*(_to_digits(end, float(result.std[k])) for end in ends[k])),
                f"{relative:.1f}" if relative < 1e4 else "> 10⁴",
            )
        rows.append(
            (
                result.base.names[k],
                f"{float(result.values[k]):.6g}",
                unit_words(result.base.units[k]),
                *spread,
            )
        )
    return Sheet(
        title,
        ("name", "value", "unit", "std", "95 % interval", "std, % of value"),
        tuple(rows),
        frozenset({"name", "unit"}),
        "Standard deviations from a block jackknife: neighbouring residuals are alike.",
    )


def _to_digits(value: float, std: float) -> str:
    """A number to a hundredth of its standard deviation, six digits at most."""
    if not (value and std > 0 and math.isfinite(value) and math.isfinite(std)):
        return f"{value:.6g}"
    digits = 3 + math.floor(math.log10(abs(value))) - math.floor(math.log10(std))
    return f"{value:.{min(6, max(1, digits))}g}"


def _pictures(result: Identification) -> tuple[Picture, ...]:
    held = bool(result.held_out_predictions)
    shown = result.held_out_predictions if held else result.fit_predictions
    out = [
        _torque_picture(result, p, k, held, len(shown))
        for k, p in enumerate(shown[:MOST_TRAJECTORIES], start=1)
    ]
    poor = len(poor_names(result))
    out.append(
        Picture(
            "parameters",
            "How well each coefficient is known: half of its 95 % interval in percent of its "
            "value, on a logarithmic scale. Green is well known, orange roughly; red bars beyond "
            f"the line at 100 % cannot be told from zero ({poor} of {len(result.base)}).",
            f"Bars, one a coefficient: {poor} of {len(result.base)} cannot be told from zero.",
            lambda: parameter_figure(result),
        )
    )
    return tuple(out)


def _torque_picture(
    result: Identification, p: Prediction, k: int, held: bool, total: int
) -> Picture:
    words = "held-out data" if held else "fitted data"
    units = ["N" if t is JointType.PRISMATIC else "N m" for t in result.robot.joint_types]
    place = f" (trajectory {k} of {total})" if total > 1 else ""
    return Picture(
        f"torque_{k}",
        f"Measured and predicted torque of every joint in {p.name}, {words}{place}."
        f"{_RESIDUAL if k == 1 else ''}",
        f"Measured and predicted torque over time in {p.name}, and their difference.",
        lambda: torque_figure(p, units, f"{p.name} ({words})"),
    )


_RESIDUAL = (
    " At the right what the model leaves, on its own scale, with its size relative to the torque. "
    "It should look like noise: steps where a joint turns back are friction, slow waves inertia or "
    "gravity. Grey: the joint rests, and friction can hold any torque."
)
