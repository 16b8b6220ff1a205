"""A diagnosis of the sim-to-real gap as a page."""

import math

from torchid.gap.diagnosis import Diagnosis, Finding
from torchid.gap.record import unit_of
from torchid.report.gap import remarks, tables
from torchid.report.gap_figures import (
    bar_figure,
    budget_figure,
    map_figure,
    torque_figure,
    worst_joints,
)
from torchid.report.gap_joint_figures import joint_figure
from torchid.report.gap_words import (
    CLEAR,
    REGIMES,
    effect_words,
    joints_words,
    listed,
    torque_unit,
    verdict,
)
from torchid.report.page.document import Page, Picture, Section, unit_words
from torchid.report.page.from_rich import sheet
from torchid.report.page.origin import Origin
from torchid.report.study.sheets import Sheet
from torchid.report.text import interval, percent

STATUS = {
    "no_gap": "no gap",
    "parametric_only": "wrong parameters only",
    "explained": "explained",
    "detected_unexplained": "not fully explained",
    "not_testable": "cannot tell",
}
"""What a status says, in the fewest words."""

_NORMAL = 1.96
"""Half of a 95 % interval, in standard deviations."""


def gap_page(diagnosis: Diagnosis, origin: Origin) -> Page:
    """The page of a diagnosis."""
    numbers = [sheet(table) for table in tables(diagnosis)]
    if diagnosis.findings:
        numbers.insert(2, coefficient_sheet(diagnosis))
    return Page(
        title=f"Sim-to-real gap of {diagnosis.robot.name}",
        verdict=verdict(diagnosis),
        facts=_facts(diagnosis),
        sections=(
            Section("pictures", "Pictures", pictures=_pictures(diagnosis)),
            Section("numbers", "Numbers", sheets=tuple(numbers)),
            Section("remarks", "To bear in mind", notes=_notes(diagnosis)),
        ),
        origin=origin,
    )


def _facts(d: Diagnosis) -> tuple[tuple[str, str], ...]:
    far, unit = d.how_far, torque_unit(d.robot)
    low, high = float(d.floor.low.norm()), float(d.floor.high.norm())
    closed = "the gap may be noise"
    if far.closed is not None and far.closed_ci95 is not None:
        closed = f"{percent(far.closed)} {interval(far.closed_ci95)}"
    return (
        ("Status", STATUS[d.status]),
        ("Closed [95 %]", closed),
        ("Gap before, RMS", f"{float(far.rms_before.norm()):.3g} {unit}"),
        ("Gap after, RMS", f"{float(far.rms_after.norm()):.3g} {unit}"),
        ("Noise, RMS", f"{low:.3g} to {high:.3g} {unit}"),
    )


def _notes(d: Diagnosis) -> tuple[str, ...]:
    return tuple(dict.fromkeys([*d.warnings, *d.floor.notes, *remarks(d)]))


def coefficient_sheet(diagnosis: Diagnosis) -> Sheet:
    """Every coefficient of every accepted effect, with its interval."""
    return Sheet(
        "Coefficients of the effects",
        ("effect", "place", "coefficient", "value", "std", "95 % interval", "unit"),
        tuple(row for f in diagnosis.findings for row in _coefficients(diagnosis, f)),
        frozenset({"effect", "place", "coefficient", "unit"}),
        f"Interval: value ± {_NORMAL} std; std over blocks of the log, because neighbouring "
        "residuals are alike. A dash: the data do not tell.",
    )


def _coefficients(d: Diagnosis, f: Finding) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for c, value, std in zip(f.effect.coefficients, f.values, f.std, strict=True):
        known = math.isfinite(std)
        half = _NORMAL * std
        unit = unit_of(c.unit, f.located or f.joints, d.robot)
        rows.append(
            (
                effect_words(f.effect.name), joints_words(f.located), c.name, f"{value:.6g}",
                f"{std:.3g}" if known else "-",
                f"[{value - half:.6g}, {value + half:.6g}]" if known else "-",
                "-" if unit == "1" else unit_words(unit),
            )
        )  # fmt: skip
    return rows


def _pictures(d: Diagnosis) -> tuple[Picture, ...]:
    """Where, the worst joints, what closes the gap."""
    out = [Picture("where", _where_caption(d), _where_alt(d), lambda: map_figure(d))]
    for k, j in enumerate(worst_joints(d) if d.traces else ()):
        out += _joint_pictures(d, j, first=k == 0)
    out.append(Picture("how_far", _far_caption(d), _far_alt(d), lambda: bar_figure(d)))
    if any((d.budget.parametric, d.budget.structural, d.budget.unexplained)):
        out.append(Picture("budget", _BUDGET, _budget_alt(d), lambda: budget_figure(d)))
    return tuple(out)


def _where_caption(d: Diagnosis) -> str:
    return (
        "Where the gap lies. Rows are joints, columns are kinds of motion: a blue cell holds more "
        "of the joint's gap than its share of time would. The bars say which joints matter, each "
        "gap beside its joint's noise: a pattern on a joint with a small share matters little. "
        f"{_clear_words(d)}"
    )


def _clear_words(d: Diagnosis) -> str:
    """The joint with the largest share, and when."""
    joint = worst_joints(d, 1)[0]
    clear = [r for r in d.regimes if r.joint == joint and r.p < CLEAR and r.excess > 0]
    clear.sort(key=lambda r: -r.excess)
    share = next(gap.share for gap in d.joints if gap.joint == joint)
    when = f"above all {listed([REGIMES[r.regime] for r in clear])}"
    return (
        f"Joint {joint + 1} holds {percent(share)} of the gap, "
        f"{when if clear else 'at no time more than at others'}."
    )


def _where_alt(d: Diagnosis) -> str:
    shares = [f"joint {gap.joint + 1} {percent(gap.share)}" for gap in d.joints]
    return f"Map of joints and kinds of motion. Shares of the gap: {', '.join(shares)}."


def _joint_pictures(d: Diagnosis, joint: int, first: bool) -> list[Picture]:
    number, unit = joint + 1, torque_unit(d.robot)
    before, after = (float(x[joint]) for x in (d.how_far.rms_before, d.how_far.rms_after))
    change = f"RMS {before:.3g} {unit} before and {after:.3g} after"
    return [
        Picture(
            f"joint_{number}",
            f"What the model lacks on joint {number}: {change}.{_AGAINST if first else ''}",
            f"Gap of joint {number} against velocity, position, acceleration, torque and time, "
            f"and its spectrum: {change}.",
            lambda: joint_figure(d, joint),
        ),
        Picture(
            f"torque_{number}",
            f"Torque of joint {number} on data not fitted, where its gap is largest."
            f"{_OVER_TIME if first else ''}",
            f"Measured and modelled torque of joint {number} over time: {change}.",
            lambda: torque_figure(d, joint),
        ),
    ]


_AGAINST = (
    " Points are samples, lines their means with 95 % intervals. An orange line that leaves the "
    "grey band of noise follows a quantity that the cause depends on; where the blue one stays in "
    "the band, nothing systematic is left."
)
_OVER_TIME = (
    " Above: measured, of the model as given, and with the effects found; below: what each of the "
    "two models leaves. What is left should look like noise."
)


def _far_caption(d: Diagnosis) -> str:
    return (
        "How far the gap shrinks, joint by joint, on data that took part in no choice. No model "
        "can be better than the grey noise; what of the blue bar rises above it is unexplained."
    )


def _far_alt(d: Diagnosis) -> str:
    pairs = zip(d.how_far.rms_before.tolist(), d.how_far.rms_after.tolist(), strict=True)
    said = [f"joint {j} {b:.3g} to {a:.3g}" for j, (b, a) in enumerate(pairs, start=1)]
    return f"Bars of the gap before and after [{torque_unit(d.robot)}]: {', '.join(said)}."


_BUDGET = (
    "What closes the gap: other values of the model's own inertial parameters, effects that it "
    "lacks, and nothing. A share of the parameters alone means that the model needs no new "
    "effect, only better numbers."
)


def _budget_alt(d: Diagnosis) -> str:
    b = d.budget
    return (
        f"Shares of the gap: base parameters {percent(b.parametric)}, effects "
        f"{percent(b.structural)}, unexplained {percent(b.unexplained)}."
    )
