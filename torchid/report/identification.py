"""An identification for people: tables, figures and page; and a payload."""

import math
from collections.abc import Sequence
from functools import partial

import numpy as np

from torchid.errors import TorchidError
from torchid.identification.identify import Identification
from torchid.identification.payload import Payload
from torchid.identification.record import Errors, IdentificationRecord
from torchid.identification.result import UNEXPLAINED
from torchid.identification.settings import Rows
from torchid.identification.validation import Prediction
from torchid.log.movement import RESTING
from torchid.report.cautions import caution_section
from torchid.report.colours import BLUE, GREEN, GREY, INK, ORANGE, RED
from torchid.report.page.document import Origin, Page
from torchid.report.panels import Figure, Figures, Picture, finish, joint_rows, note, panel, rows_of
from torchid.report.table import Report, Section, Table, joint_table, table_of
from torchid.results.words import effect_words, joints_words, listed, short, unit_words
from torchid.robot.model import joint_unit


def report_of_identification(result: Identification) -> Report:
    """All that there is to see of an identification."""
    return Report(
        parts=tables(result),
        warnings=result.warnings,
        verdict=verdict(result),
        figures={one.name: one.draw for one in _pictures(result)},
        page=partial(identification_page, result),
    )


def tables(result: Identification) -> list[Table]:
    """Base parameters, coefficients of effects, errors per joint."""
    n, condition = result.base.n_rigid, f"{result.scaled_condition_number:.0f}"
    shapes = [
        f"{s.name} = {x:.4g} {unit_words(s.unit)} of {effect_words(e.name)}, "
        f"{joints_words(e.joints)}"
        for e in result.effects
        for s, x in zip(e.shapes, e.shape_values, strict=True)
    ]
    sums = result.base.absorbed_effects()
    notes = (
        ("Standard deviations from a block jackknife: neighbouring residuals are alike.", True),
        (f"In sums with base parameters: {listed(sums)}.", sums),
        (f"Shapes, given or searched: {'; '.join(shapes)}.", shapes),
    )
    return [
        table_of(
            f"{n} base parameters of {result.robot.name} (condition number {condition} with scaled "
            "columns)",
            result.estimates[:n],
        ),
        table_of(
            "coefficients of the effects",
            result.estimates[n:],
            note=" ".join(text for text, said in notes if said),
        ),
        error_table(result),
    ]


def error_table(result: Identification) -> Table:
    """Relative errors per joint, in percent, and RMSE."""
    unit = "; ".join(dict.fromkeys(joint_unit(result.robot, j) for j in range(result.robot.n)))
    rows: list[tuple[str, list[float]]] = []
    for data, errors in (("fit", result.fit), ("held out", result.held_out)):
        if errors is None:
            continue
        for name, percent in (
            ("all", errors.relative_percent),
            ("moving", errors.relative_percent_moving),
            ("raw torque", errors.relative_percent_raw),
        ):
            rows.append((f"{data}, {name}", [*percent.tolist(), float(percent.mean())]))
        rows.append((f"{data}, RMSE [{unit}]", errors.rmse.tolist()))
    band = result.settings.error_cutoff or result.cutoff
    note = "unfiltered" if band is None else f"filtered at {band:g} Hz"
    how = f"{note}; moving: |dq| > {RESTING:g}, less in slow logs"
    title = f"torque error, 100 ||tau - model|| / ||tau||, per joint ({how})"
    return joint_table(title, rows, last=("mean",))


def shown_errors(result: Identification) -> tuple[Errors, bool]:
    """The errors that count, and whether they are on held-out data."""
    held = result.held_out
    return (result.fit, False) if held is None else (held, True)


def poor_names(result: Identification) -> list[str]:
    """Names of estimated coefficients whose 95 % interval holds zero, the worst first."""
    half = result.uncertainty.quantile() * result.relative_std_percent
    # 100.0: half-width of the 95 % interval in % of the value: beyond it, zero is possible
    bad = [k for k in range(len(result.base)) if bool(result.free[k]) and float(half[k]) > 100.0]
    return [result.base.names[k] for k in sorted(bad, key=lambda k: -float(half[k]))]


def torque_figure(
    prediction: Prediction, units: Sequence[str], title: str, rows: Rows = "moving"
) -> Figure:
    """Measured and predicted torque per joint, the residual beside it on its own scale.

    Args:
        prediction: of one trajectory.
        units: of the joints' torques.
        title: of the figure.
        rows: judged, as in the fit: they set the residual's scale and its size in percent. Others
            are grey.
    """
    n = prediction.measured.shape[1]
    figure, grid = joint_rows(n, ("", ""), (11, 1.2 + 1.35 * n), units, width_ratios=(3, 2))
    # 4000: points at most
    step = slice(None, None, max(1, len(prediction.t) // 4000))
    t = (prediction.t - prediction.t[0])[step].numpy()
    measured, predicted = (x[step].numpy() for x in (prediction.measured, prediction.predicted))
    moving = prediction.moving[step].numpy()
    for j, (left, right) in enumerate(grid):
        left.plot(t, measured[:, j], color=INK, linewidth=1.6, label="measured")
        left.plot(t, predicted[:, j], color=BLUE, linewidth=1.0, label="model")
        error = measured[:, j] - predicted[:, j]
        judged = moving[:, j] if rows == "moving" else np.ones_like(moving[:, j])
        shown = np.where(judged, error, np.nan)
        right.plot(t, shown, color=ORANGE, linewidth=0.9, label="measured - model")
        low, high = right.get_ylim() if judged.any() else (error.min(), error.max())
        right.plot(t, np.where(judged, np.nan, error), color=GREY, linewidth=0.9)
        right.fill_between(
            t, low, high, where=~moving[:, j], color=GREY, alpha=0.25, linewidth=0,
            label="joint at rest" + (", not judged" if rows == "moving" else ""),
        )  # fmt: skip
        right.set_ylim(low, high)
        # From all samples, as in the tables, not from those drawn.
        sums = prediction.sums
        parts = sums.error[j], sums.torque[j]
        if rows == "moving":
            parts = sums.moving_error[j], sums.moving_torque[j]
        left_over, size = (float(x) ** 0.5 for x in parts)
        note(right, f"{100 * left_over / size:.1f} %" if size else "at rest")
    return finish(figure, title, *grid[0])


def run_figure(result: Identification, run: Prediction, held_out: bool) -> Figure:
    """The torque of one trajectory of the result."""
    units = [joint_unit(result.robot, j) for j in range(result.robot.n)]
    return torque_figure(run, units, f"{run.name} ({_data(held_out)})", result.settings.rows)


def kinds(result: Identification) -> Figures:
    """What can be drawn, by kind; torque takes a `trajectory`, from 0, held-out ones first."""
    runs = (*result.held_out_predictions, *result.fit_predictions)

    def torque(trajectory: int = 0) -> Figure:
        if not 0 <= trajectory < len(runs):
            raise TorchidError(
                "there is no such trajectory.", got=trajectory, expected=f"0..{len(runs) - 1}"
            )
        held_out = trajectory < len(result.held_out_predictions)
        return run_figure(result, runs[trajectory], held_out)

    return {"parameters": partial(parameter_figure, result.record), "torque": torque}


def _data(held_out: bool) -> str:
    return "held-out data" if held_out else "fitted data"


def parameter_figure(result: IdentificationRecord) -> Figure:
    """Each estimated parameter's 95 % interval relative to its value: what the log determines."""
    std = result.covariance.diagonal().clamp(min=0).sqrt()
    relative = 100 * result.statistics.quantile95 * std / result.values.abs()
    left_out = {*result.undetermined, *result.bounded, *result.dropped}
    shown = [k for k, name in enumerate(result.base_names) if name not in left_out]
    order = sorted(shown, key=lambda k: float(relative[k]))
    figure, axes = panel(9, 1.4 + 0.19 * len(order))
    values = [max(1e-3, min(float(relative[k]), 1e3)) for k in order]
    colours = [GREEN if v < 30 else ORANGE if v < 100 else RED for v in values]
    axes.barh(range(len(order)), values, left=1e-3, color=colours, height=0.7)
    axes.set(xscale="log", xlim=(max(1e-3, min(values) / 2), 1.1e3))
    rows_of(axes, [short(result.base_names[k], 44) for k in order])
    axes.axvline(100, color=INK, linewidth=0.8)
    axes.set_xlabel(
        "half-width of the 95 % interval, % of the value (100 %: not distinguishable from zero)"
    )
    return finish(figure, f"{result.robot}: how well each parameter is known")


def identification_page(result: Identification, origin: Origin) -> Page:
    """The page of an identification."""
    n, every = result.base.n_rigid, len(result.base)
    shown, held = shown_errors(result)
    known = [v for v in shown.relative_percent_moving.tolist() if math.isfinite(v)]
    mean = _percent(sum(known) / len(known)) if known else "-"
    return Page(
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
        sections=[
            Section("Pictures", _pictures(result), folded=False),
            Section("Numbers", tables(result)[::-1]),
            caution_section(result.warnings),
        ],
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
        parts.append(f"{len(poor)} are not distinguishable from zero ({_named(poor)})")
    known_of = (
        f"of {total}, {listed(parts)}"
        if parts
        else f"all {total} that were estimated are distinguishable from zero"
    )
    return f"{said[0].upper()}{said[1:]}; {known_of}."


def _percent(value: float) -> str:
    return f"{value:.1f} %" if value >= 1 else f"{value:.2g} %"


def _named(names: Sequence[str]) -> str:
    # 3: names at most
    return listed((short(name, 30) for name in names), most=3)


def _pictures(result: Identification) -> list[Picture]:
    held = bool(result.held_out_predictions)
    shown = result.held_out_predictions if held else result.fit_predictions
    out = []
    # 3: shown as pictures
    for k, p in enumerate(shown[:3], start=1):
        place = f" (trajectory {k} of {len(shown)})" if len(shown) > 1 else ""
        out.append(
            Picture(
                f"torque_{k}",
                f"Measured and predicted torque of every joint in {p.name}, {_data(held)}{place}."
                f"{_RESIDUAL if k == 1 else ''}",
                f"Measured and predicted torque over time in {p.name}, and their difference.",
                partial(run_figure, result, p, held),
            )
        )
    poor = f"{len(poor_names(result))} of {len(result.base)}"
    out.append(
        Picture(
            "parameters",
            "How well each coefficient is known: half of its 95 % interval in percent of its "
            "value, on a logarithmic scale. Green is well known, orange roughly; red bars beyond "
            f"the line at 100 % are not distinguishable from zero ({poor}).",
            f"Bars, one a coefficient: {poor} are not distinguishable from zero.",
            partial(parameter_figure, result.record),
        )
    )
    return out


_RESIDUAL = (
    " At the right what the model leaves, on its own scale, with its size relative to the torque. "
    "It should look like noise: steps where a joint turns back are friction, slow waves inertia or "
    "gravity. Grey: the joint rests, and friction can hold any torque; such rows are not judged, "
    "unless they were fitted too (--rows all)."
)


def report_of_payload(payload: Payload) -> Report:
    """All that there is to see of a payload."""
    said = payload_headline(payload)
    return Report(verdict=said, parts=payload_tables(payload), warnings=payload.warnings)


def payload_tables(payload: Payload) -> list[Table]:
    """The body in the tool's and in the last link's frame, and what else changed, if anything."""
    title = "effects that changed with the load, not part of the payload"
    return [
        table_of(f"payload of {payload.robot} in the tool frame", payload.tool.quantities),
        table_of("the same in the last link's frame", payload.link.quantities),
        table_of(title, payload.friction_changes),
    ]


def payload_headline(payload: Payload) -> str:
    """One sentence: mass and centre of mass in the tool frame, and whether a body can have them."""
    mass, com = payload.tool.mass, payload.tool.com
    if bool(mass.high < 0):
        return (
            f"The logs with the payload carry {-float(mass.value):.4g} kg less than those without: "
            "are they exchanged?"
        )
    half = payload.quantile * float(mass.std)
    if payload.rejected:
        known = f"the nearest has {float(mass.value):.3g} ± {half:.2g} kg (95 %)"
        return (
            f"No rigid payload on the last link of {payload.robot} explains its change of torque: "
            f"{'its mass is not known' if math.isnan(half) else known}."
        )
    if bool(mass.value.isnan()):
        return f"The mass that {payload.robot} carries is not known from these logs."
    if not payload.seen:
        return f"No payload can be seen on the last link of {payload.robot}."
    verdict = "not physically consistent"
    if payload.consistent or payload.consistent_within:
        within = "" if payload.consistent else " within its interval"
        verdict = f"physically consistent{within}"
    place = ", ".join("?" if math.isnan(c) else f"{1e3 * c:.1f}" for c in com.value.tolist())
    return (
        f"{payload.robot} carries {float(mass.value):.4g} ± {half:.2g} kg (95 %), centre of mass "
        f"at ({place}) mm of the tool frame; {verdict}."
    )
