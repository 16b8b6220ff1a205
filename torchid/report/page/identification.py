"""An identification as a page."""

import math
from collections.abc import Sequence

from torchid.identification.identify import Identification
from torchid.identification.result import UNEXPLAINED
from torchid.report.figures import parameter_figure, torque_figure
from torchid.report.identification import (
    effect_tables,
    error_table,
    percent_words,
    poor_names,
    shown_errors,
)
from torchid.report.page.document import Page, Picture, result_page
from torchid.report.page.origin import Origin
from torchid.report.table import Table, unit_words
from torchid.report.text import joint_unit, listed, short

MOST_TRAJECTORIES = 3
"""Shown as pictures."""
_MOST_NAMED = 3


def identification_page(result: Identification, origin: Origin) -> Page:
    """The page of an identification."""
    n, every = result.base.n_rigid, len(result.base)
    tables = [t.on_page() for t in (error_table(result), *effect_tables(result))]
    tables.append(coefficient_table(result, range(n), "Base parameters"))
    if every > n:
        tables.append(coefficient_table(result, range(n, every), "Coefficients of the effects"))
    shown, held = shown_errors(result)
    known = [v for v in shown.relative_percent_moving.tolist() if math.isfinite(v)]
    mean = _percent(sum(known) / len(known)) if known else "-"
    return result_page(
        f"Identified dynamics of {result.robot.name}",
        verdict(result),
        (
            (f"Mean error, {'held-out' if held else 'fitted'}, moving", mean),
            ("Base parameters", str(n)),
            ("Coefficients of effects", str(every - n)),
            ("Cut-off", "no filter" if result.cutoff is None else f"{result.cutoff:g} Hz"),
            ("Condition number, scaled", f"{result.scaled_condition_number:.0f}"),
        ),
        origin,
        pictures=_pictures(result),
        tables=tables,
        notes=result.warnings,
    )


def verdict(result: Identification) -> str:
    """One sentence: how well the torque is predicted, and what is poorly determined."""
    shown, held = shown_errors(result)
    where = "motion that was held out"
    if not held:
        where = "the motion it was fitted to (none was held out)"
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
    total = f"{len(result.base)} coefficients"
    never, poor = result.undetermined, poor_names(result)
    parts = [f"{len(never)} not determined at all ({_named(never)})"] if never else []
    if poor:
        parts.append(f"{len(poor)} cannot be told from zero ({_named(poor)})")
    known_of = (
        f"of {total}, {listed(parts)}"
        if parts
        else f"all {total} that were estimated can be told from zero"
    )
    return f"{said[0].upper()}{said[1:]}; {known_of}."


def _percent(value: float) -> str:
    return f"{value:.1f} %" if value >= 1 else f"{value:.2g} %"


def _named(names: Sequence[str]) -> str:
    shown = [short(name, 30) for name in names[:_MOST_NAMED]]
    more = len(names) - _MOST_NAMED
    return f"{', '.join(shown)} and {more} more" if more > 0 else listed(shown)


def coefficient_table(result: Identification, which: Sequence[int], title: str) -> Table:
    """Values with standard deviations and 95 % intervals.

    Args:
        result: what was identified.
        which: positions in `base.names`.
        title: of the table.
    """
    ends = result.interval().tolist()
    rows = []
    for k in which:
        spread, std = ("held at 0", "-", "-"), float(result.std[k])
        if bool(result.free[k]):
            low, high = (_to_digits(end, std) for end in ends[k])
            relative = percent_words(float(result.relative_std_percent[k]))
            spread = (f"{std:.3g}", f"[{low}, {high}]", relative)
        unit = unit_words(result.base.units[k])
        rows.append((result.base.names[k], f"{float(result.values[k]):.6g}", unit, *spread))
    return Table(
        title,
        ("name", "value", "unit", "std", "95 % interval", "std, % of value"),
        rows,
        names=("name", "unit"),
        note="Standard deviations from a block jackknife: neighbouring residuals are alike.",
    )


def _to_digits(value: float, std: float) -> str:
    """A number to a hundredth of its standard deviation, six digits at most."""
    if not (value and std > 0 and math.isfinite(value) and math.isfinite(std)):
        return f"{value:.6g}"
    digits = 3 + math.floor(math.log10(abs(value))) - math.floor(math.log10(std))
    return f"{value:.{min(6, max(1, digits))}g}"


def _pictures(result: Identification) -> list[Picture]:
    held = bool(result.held_out_predictions)
    shown = result.held_out_predictions if held else result.fit_predictions
    words = "held-out data" if held else "fitted data"
    units = [joint_unit(result.robot, j) for j in range(result.robot.n)]
    out = []
    for k, p in enumerate(shown[:MOST_TRAJECTORIES], start=1):
        place = f" (trajectory {k} of {len(shown)})" if len(shown) > 1 else ""
        out.append(
            Picture(
                f"torque_{k}",
                f"Measured and predicted torque of every joint in {p.name}, {words}{place}."
                f"{_RESIDUAL if k == 1 else ''}",
                f"Measured and predicted torque over time in {p.name}, and their difference.",
                lambda p=p: torque_figure(p, units, f"{p.name} ({words})"),  # type: ignore[misc]
            )
        )
    poor = f"{len(poor_names(result))} of {len(result.base)}"
    out.append(
        Picture(
            "parameters",
            "How well each coefficient is known: half of its 95 % interval in percent of its "
            "value, on a logarithmic scale. Green is well known, orange roughly; red bars beyond "
            f"the line at 100 % cannot be told from zero ({poor}).",
            f"Bars, one a coefficient: {poor} cannot be told from zero.",
            lambda: parameter_figure(result),
        )
    )
    return out


_RESIDUAL = (
    " At the right what the model leaves, on its own scale, with its size relative to the torque. "
    "It should look like noise: steps where a joint turns back are friction, slow waves inertia or "
    "gravity. Grey: the joint rests, and friction can hold any torque."
)
