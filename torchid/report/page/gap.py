"""A diagnosis of the sim-to-real gap as a page."""

import math

from torchid.gap.diagnosis import Diagnosis
from torchid.gap.record import unit_of
from torchid.report import gap_figures
from torchid.report.gap import closed_words, remarks, tables
from torchid.report.gap_joint_figures import joint_figure
from torchid.report.gap_words import CLEAR, REGIMES, effect_words, joints_words, verdict
from torchid.report.page.document import Page, Picture, result_page
from torchid.report.page.origin import Origin
from torchid.report.table import Table, unit_words
from torchid.report.text import listed, percent, torque_unit

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
    d, far, unit = diagnosis, diagnosis.how_far, torque_unit(diagnosis.robot)
    numbers = [table.on_page() for table in tables(d)]
    if d.findings:
        numbers.insert(2, coefficient_table(d))
    low, high = float(d.floor.low.norm()), float(d.floor.high.norm())
    return result_page(
        f"Sim-to-real gap of {d.robot.name}",
        verdict(d),
        (
            ("Status", STATUS[d.status]),
            ("Closed [95 %]", closed_words(d)),
            ("Gap before, RMS", f"{float(far.rms_before.norm()):.3g} {unit}"),
            ("Gap after, RMS", f"{float(far.rms_after.norm()):.3g} {unit}"),
            ("Noise, RMS", f"{low:.3g} to {high:.3g} {unit}"),
        ),
        origin,
        pictures=_pictures(d),
        tables=numbers,
        notes=dict.fromkeys([*d.warnings, *d.floor.notes, *remarks(d)]),
    )


def coefficient_table(diagnosis: Diagnosis) -> Table:
    """Every coefficient of every accepted effect, with its interval."""
    rows = []
    for f in diagnosis.findings:
        for c, value, std in zip(f.effect.coefficients, f.values, f.std, strict=True):
            half = _NORMAL * std
            spread = (f"{std:.3g}", f"[{value - half:.6g}, {value + half:.6g}]")
            unit = unit_of(c.unit, f.located or f.joints, diagnosis.robot)
            rows.append(
                (
                    effect_words(f.effect.name), joints_words(f.located), c.name, f"{value:.6g}",
                    *(spread if math.isfinite(std) else ("-", "-")),
                    "-" if unit == "1" else unit_words(unit),
                )
            )  # fmt: skip
    return Table(
        "Coefficients of the effects",
        ("effect", "place", "coefficient", "value", "std", "95 % interval", "unit"),
        rows,
        names=("effect", "place", "coefficient", "unit"),
        note=f"Interval: value ± {_NORMAL} std; std over blocks of the log, because neighbouring "
        "residuals are alike. A dash: the data do not tell.",
    )


def _pictures(d: Diagnosis) -> list[Picture]:
    """Where, the worst joints, what closes the gap."""
    unit, far, budget = torque_unit(d.robot), d.how_far, d.budget
    # The joint with the largest share, and when.
    worst = gap_figures.worst_joints(d, 1)[0]
    clear = [r for r in d.regimes if r.joint == worst and r.p < CLEAR and r.excess > 0]
    clear.sort(key=lambda r: -r.excess)
    when = f"above all {listed([REGIMES[r.regime] for r in clear])}"
    share = next(gap.share for gap in d.joints if gap.joint == worst)
    shares = [f"joint {gap.joint + 1} {percent(gap.share)}" for gap in d.joints]
    out = [
        Picture(
            "where",
            "Where the gap lies. Rows are joints, columns are kinds of motion: a blue cell holds "
            "more of the joint's gap than its share of time would. The bars say which joints "
            "matter, each gap beside its joint's noise: a pattern on a joint with a small share "
            f"matters little. Joint {worst + 1} holds {percent(share)} of the gap, "
            f"{when if clear else 'at no time more than at others'}.",
            f"Map of joints and kinds of motion. Shares of the gap: {', '.join(shares)}.",
            lambda: gap_figures.map_figure(d),
        )
    ]
    for k, joint in enumerate(gap_figures.worst_joints(d) if d.traces else ()):
        number = joint + 1
        change = (
            f"RMS {float(far.rms_before[joint]):.3g} {unit} before and "
            f"{float(far.rms_after[joint]):.3g} after"
        )
        # The first joint's pictures say how to read them.
        out += [
            Picture(
                f"joint_{number}",
                f"What the model lacks on joint {number}: {change}.{'' if k else _AGAINST}",
                f"Gap of joint {number} against velocity, position, acceleration, torque and time, "
                f"and its spectrum: {change}.",
                lambda joint=joint: joint_figure(d, joint),  # type: ignore[misc]
            ),
            Picture(
                f"torque_{number}",
                f"Torque of joint {number} on data not fitted, where its gap is largest."
                f"{'' if k else _OVER_TIME}",
                f"Measured and modelled torque of joint {number} over time: {change}.",
                lambda joint=joint: gap_figures.torque_figure(d, joint),  # type: ignore[misc]
            ),
        ]
    pairs = zip(far.rms_before.tolist(), far.rms_after.tolist(), strict=True)
    said = [f"joint {j} {b:.3g} to {a:.3g}" for j, (b, a) in enumerate(pairs, start=1)]
    out.append(
        Picture(
            "how_far",
            "How far the gap shrinks, joint by joint, on data that took part in no choice. No "
            "model can be better than the grey noise; what of the blue bar rises above it is "
            "unexplained.",
            f"Bars of the gap before and after [{unit}]: {', '.join(said)}.",
            lambda: gap_figures.bar_figure(d),
        )
    )
    if any((budget.parametric, budget.structural, budget.unexplained)):
        out.append(
            Picture(
                "budget",
                "What closes the gap: other values of the model's own inertial parameters, effects "
                "that it lacks, and nothing. A share of the parameters alone means that the model "
                "needs no new effect, only better numbers.",
                f"Shares of the gap: base parameters {percent(budget.parametric)}, effects "
                f"{percent(budget.structural)}, unexplained {percent(budget.unexplained)}.",
                lambda: gap_figures.budget_figure(d),
            )
        )
    return out


_AGAINST = (
    " Points are samples, lines their means with 95 % intervals. An orange line that leaves the "
    "grey band of noise follows a quantity that the cause depends on; where the blue one stays in "
    "the band, nothing systematic is left."
)
_OVER_TIME = (
    " Above: measured, of the model as given, and with the effects found; below: what each of the "
    "two models leaves. What is left should look like noise."
)
