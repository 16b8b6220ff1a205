"""A diagnosis as tables for people, and as a page."""

import math
import re
from functools import partial
from typing import Any

from torchid.effects.registry import KINDS
from torchid.gap.diagnosis import INERTIA_MEANING, INERTIA_REMEDY, Diagnosis, unit_of
from torchid.gap.record import Experiment, NotTestable, Replication
from torchid.report import gap_figures
from torchid.report import gap_words as words
from torchid.report.gap_answer import answer_table
from torchid.report.page.document import Origin, Page
from torchid.report.panels import Picture
from torchid.report.robot import simulator_block
from torchid.report.table import (
    Shown,
    Table,
    cells,
    filled,
    interval,
    joint_numbers,
    joint_unit,
    listed,
    percent,
    torque_unit,
    unit_words,
)
from torchid.results.record import as_plain
from torchid.simulation.two_models import Rollout
from torchid.statistics.proportion import HALF_95

_MOST_REGIMES = 3
_MOST_NUMBERS = 12
_NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w])")


def shown(diagnosis: Diagnosis) -> Shown:
    """All that there is to see of a diagnosis."""
    return Shown(
        verdict=words.verdict(diagnosis),
        parts=[*tables(diagnosis), *remarks(diagnosis)],
        warnings=diagnosis.warnings,
        figures=gap_figures.figures(diagnosis),
        page=partial(gap_page, diagnosis),
    )


def tables(diagnosis: Diagnosis) -> list[Table]:
    """The answer; then where, which, what it means, how far, what could not be tested, what to do
    next."""
    return filled(answer_table(diagnosis), *lower_tables(diagnosis))


def lower_tables(diagnosis: Diagnosis) -> list[Table]:
    """What stands below the answer."""
    d, rollout, experiment = diagnosis, diagnosis.how_far.rollout, diagnosis.next_experiment
    return filled(
        where_table(d) if stands_out(d) else None,
        which_table(d),
        small_table(d),
        known_table(d),
        open_table(d),
        meaning_table(d),
        how_far_table(d),
        budget_table(d),
        rollout_table(rollout) if rollout else None,
        not_testable_table(d),
        experiment_table(experiment) if experiment else None,
    )


def stands_out(diagnosis: Diagnosis) -> bool:
    """Whether a kind of motion holds more than its share of some joint's gap."""
    return any(words.clear_regimes(diagnosis, gap.joint) for gap in diagnosis.joints)


def where_table(diagnosis: Diagnosis) -> Table:
    """Joints: size and share of the gap, and the regimes that hold more than their share."""
    rows = []
    for gap in diagnosis.joints:
        said = []
        for r in words.clear_regimes(diagnosis, gap.joint)[:_MOST_REGIMES]:
            text = words.excess_words(r)
            if r.times:
                starts: dict[str, list[str]] = {}
                for window in r.times[:_MOST_REGIMES]:
                    starts.setdefault(window.trajectory, []).append(f"{window.from_s:.1f}")
                places = "; ".join(f"{', '.join(at)} s of {name}" for name, at in starts.items())
                text += f" at {places}{' ...' if len(r.times) > _MOST_REGIMES else ''}"
            said.append(text)
        low, high = gap.noise_floor_rms
        rows.append(
            (
                str(gap.joint + 1), f"{gap.gap_rms:.3g} {joint_unit(diagnosis.robot, gap.joint)}",
                f"{low:.3g} - {high:.3g}", percent(gap.share), ", ".join(said) or "-",
            )
        )  # fmt: skip
    regimes = f"holds more than its share (excess [95 %], p < {words.CLEAR:g})"
    return Table(
        f"where: torque the model lacks, below {diagnosis.band:g} Hz",
        ("joint", "gap, RMS", "noise, RMS", "share", regimes),
        rows,
        words=("joint", regimes),
    )


def which_table(diagnosis: Diagnosis) -> Table:
    """Accepted effects with their coefficients."""
    rows = []
    for f in diagnosis.findings:
        values = words.coefficients(f, diagnosis.robot)
        if f.changed:
            values = [words.change_words(c) for c in f.changed]
        elif words.corrects(f, diagnosis.robot):
            values = [f"change of {value}" for value in values]
        values = [*values[:_MOST_NUMBERS], *(["..."] if len(values) > _MOST_NUMBERS else [])]
        if f.effect.shapes:
            values.append(f"({', '.join(words.shapes(f, diagnosis.robot))})")
        joints = ", ".join(str(j + 1) for j in f.joints) or "all"
        shares = (percent(f.share), percent(f.first), _sure(f.how_sure), _repeats(f.replication))
        what = words.effect_words(f.effect.name)
        rows.append((what, joints, "\n".join(values), _others(f.ambiguous_with), *shares))
    for p in diagnosis.parametric:
        links = [str(link + 1) for link in p.links]
        what = f"inertia of link {listed(links)}" if links else "all base parameters"
        rows.append(
            (
                what, ", ".join(links) or "all", "see the corrected model",
                _others(p.ambiguous_with), percent(p.share), "-", _sure(p.how_sure), "-",
            )
        )  # fmt: skip
    columns = (
        "effect", "joints", "value", "cannot be told from", "closes\nin its turn", "closes\nalone",
        "how sure", "repeats",
    )  # fmt: skip
    title = "which: effects the model lacks (value ± std)"
    return Table(title, columns, rows, names=columns[:3], words=columns[3:4])


def small_table(diagnosis: Diagnosis) -> Table:
    """Effects that are there, of a size below what was asked for."""
    rows = []
    for e in diagnosis.small:
        values = [
            f"{name} = {words.measure(v, e.std.get(name), '' if unit == '1' else unit)}"
            for name, unit in e.unit.items()
            if isinstance(v := e.parameters[name], float | int)
        ]
        place = ", ".join(str(j + 1) for j in e.joints) or "all"
        torque = f"{e.closes_rms:.2g}"
        sure = (_sure(e.how_sure), _repeats(e.replication))
        rows.append((words.effect_words(e.effect), place, "\n".join(values), torque, *sure))
    columns = ("effect", "joints", "value", "takes away, RMS", "how sure", "repeats")
    title = "small: there, and below what was asked for (`worthwhile`)"
    return Table(title, columns, rows, names=columns[:3])


def known_table(diagnosis: Diagnosis) -> Table:
    """Coefficients of the model's effects before this log and after it."""
    known, rows = diagnosis.knowledge, []
    for c in () if known is None else known.coefficients:
        unit = "" if c.unit == "1" else unit_words(c.unit)
        moved = "changed" if c.changed else "as known"
        before, after = ((c.before, c.before_std), (c.after, c.after_std))
        name, place = c.name.rsplit(" ", 1)
        rows.append(
            (f"{words.effect_words(name)} {place}", words.measure(*before, unit),
             words.measure(*after, unit), moved)
        )  # fmt: skip
    sources = "" if known is None else ", ".join(known.sources)
    columns = ("coefficient", "known before", "with this log", "")
    return Table(f"known: what this log adds to {sources}", columns, rows, names=columns[:1])


def open_table(diagnosis: Diagnosis) -> Table:
    """Joints on which the model left torque open that could hide a cause."""
    known = diagnosis.knowledge
    rows = [
        (str(j.joint + 1), f"{j.added_rms:.3g} {joint_unit(diagnosis.robot, j.joint)}", j.motion)
        for j in (() if known is None else known.joints)
        if j.hides
    ]
    columns = ("joint", "open before this log, RMS", "to be sure")
    title = "open: torque that what was known before did not determine"
    return Table(title, columns, rows, names=columns[:1], words=columns[2:])


def meaning_table(diagnosis: Diagnosis) -> Table:
    """What each effect means and what to do; an effect on several joints once."""
    rows = []
    for name in dict.fromkeys(f.effect.name for f in diagnosis.findings):
        same = [f for f in diagnosis.findings if f.effect.name == name]
        kind = same[0].effect
        notes = [f"{words.joints_words(f.located)}: {note}" for f in same for note in f.notes]
        remedy = kind.remedy
        if any(words.corrects(f, diagnosis.robot) for f in same):
            remedy += " Where the model has it, the value is a change of the model's."
        rows.append((words.effect_words(name), "\n".join([kind.meaning, *notes]), remedy))
    if diagnosis.parametric:
        rows.append(("inertial parameters", INERTIA_MEANING, INERTIA_REMEDY))
    columns = ("effect", "what it means", "what to do")
    return Table(
        "what it means, and what to do", columns, rows, names=columns[:1], words=columns[1:]
    )


def how_far_table(diagnosis: Diagnosis) -> Table:
    """RMS per joint before and after, beside the noise."""
    far, floor = diagnosis.how_far, diagnosis.floor
    units = {joint_unit(diagnosis.robot, j) for j in range(diagnosis.robot.n)}
    rows = [
        # Newtons and newton metres have no sum.
        (name, *cells(level), f"{float(level.norm()):.3g}" if len(units) == 1 else "-")
        for name, level in (
            ("as given", far.rms_before), ("corrected", far.rms_after),
            ("noise, at least", floor.low), ("noise, at most", floor.high),
        )
    ]  # fmt: skip
    title = f"how far: RMS of what the model lacks [{torque_unit(diagnosis.robot)}]"
    columns = ("model", *joint_numbers(diagnosis.robot.n), "all")
    return Table(title, columns, rows, words=("model",))


def budget_table(diagnosis: Diagnosis) -> Table:
    """Shares of the gap, the closed fraction, and rollouts."""
    far, budget = diagnosis.how_far, diagnosis.budget
    parts = (budget.parametric, budget.structural, budget.unexplained)
    shares = ["-"] * 3 if far.closed is None else [percent(x) for x in parts]
    columns = ("base parameters", "effects", "unexplained", "closed [95 %]")
    return Table("budget: what closes the gap", columns, [(*shares, closed_words(diagnosis))])


def closed_words(diagnosis: Diagnosis) -> str:
    """The share of the gap that is closed, with its interval."""
    far = diagnosis.how_far
    if far.closed is None or far.closed_ci95 is None:
        quiet = {"no_gap": "the gap may be noise", "negligible": "too little to say"}
        return quiet.get(diagnosis.status, "nothing of it")
    return f"{percent(far.closed)} {interval(far.closed_ci95)}"


def rollout_table(rollout: Rollout) -> Table:
    """Position errors of short simulations, corrected model relative to the given one."""
    rows = []
    for row in rollout.horizons:
        if row.ratio is None:
            continue
        within = row.ratio_ci95
        span = f" [{within[0]:.2f}, {within[1]:.2f}]" if within else ""
        lost = percent(row.diverged_before), percent(row.diverged_after)
        rows.append((f"{row.horizon_s:g} s", f"{row.ratio:.2f}{span}", *lost))
    columns = ("horizon", "ratio [95 %]", "lost before", "lost after")
    return Table("simulated motion: position error after to before", columns, rows)


def remarks(diagnosis: Diagnosis) -> list[str]:
    """What to know about the tables, one sentence each."""
    known = "repeats of a trajectory" if diagnosis.floor.source == "repeats" else "the residual"
    out = [
        f"How far: on data used for no choice, while each joint moves, below {diagnosis.band:g} "
        f"Hz; the fit is below {diagnosis.cutoff:g} Hz; noise from {known}.",
        "Share: of the squared gap beyond the noise, each joint in units of its own noise.",
    ]
    if not stands_out(diagnosis):
        out.insert(0, "Where: no kind of motion holds more of the gap than its share of time.")
    if diagnosis.knowledge is not None:
        out += [f"{note[0].upper()}{note[1:]}." for note in diagnosis.knowledge.notes]
    rollout = diagnosis.how_far.rollout
    return out if rollout is None else [*out, *rollout.sentences]


def not_testable_table(diagnosis: Diagnosis) -> Table:
    """Effects these data could not show, joints of one reason on one line."""
    groups: dict[tuple[str, str], list[NotTestable]] = {}
    for x in diagnosis.not_testable:
        groups.setdefault((x.effect, _NUMBER.sub("#", x.reason)), []).append(x)
    rows = []
    for (effect, _), members in groups.items():
        # Joints on which no size would do stand together, behind the others.
        sizes, never = [], []
        for x in members:
            place = " and ".join(str(j + 1) for j in x.joints) or "the arm"
            if x.smallest_detectable is None:
                never.append(place)
            else:
                sizes.append(f"{place}: {x.smallest_detectable:.3g} {x.unit}".rstrip())
        sizes += [f"{', '.join(never)}: no size"] if never else []
        rows.append((words.effect_words(effect), "; ".join(sizes), _reason(members)))
    columns = ("effect", "joint: smallest size that would have been seen", "why")
    return Table(
        "not testable with these data", columns, rows, names=columns[:1], words=columns[1:]
    )


def _reason(members: list[NotTestable]) -> str:
    """The reason, which differs in its numbers only; of several, from the least to the greatest."""
    found = [_NUMBER.findall(x.reason) for x in members]
    spans = []
    for same in zip(*found, strict=True):
        low, high = min(same, key=float), max(same, key=float)
        spans.append(low if low == high else f"{low} to {high}")
    each = iter(spans)
    return _NUMBER.sub(lambda _: next(each), members[0].reason)


def experiment_table(experiment: Experiment) -> Table:
    """What to record next."""
    entries = as_plain(experiment).items()
    texts = {key.replace("_", " "): _value(value) for key, value in entries}
    rows = [(key, text) for key, text in texts.items() if text]
    return Table("next experiment", ("", " "), rows, names=("",), words=(" ",))


def _value(value: Any) -> str:
    """Short text of a value; long arrays are left to the JSON."""
    if isinstance(value, dict):
        return "; ".join(f"{k.replace('_', ' ')}: {_value(v)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        nested = any(isinstance(v, list | tuple | dict) for v in value)
        if len(value) > _MOST_NUMBERS or nested:
            return f"{len(value)} values (see the JSON)"
        return ", ".join(_value(v) for v in value)
    if isinstance(value, float):
        return f"{value:.4g}"
    return "" if value is None else words.effect_words(value) if value in KINDS else str(value)


def _others(names: tuple[str, ...]) -> str:
    return "\n".join(words.effect_words(name) for name in names) or "-"


def _repeats(found: Replication | None) -> str:
    """`5 of 6`: motions that want the effect with the same sign and size, of those that can
    tell."""
    return "-" if found is None else f"{found.repeats} of {found.asked}"


def _sure(value: float | None) -> str:
    if value is None:
        return "-"
    return "> 99 %" if value > 0.99 else f"{100 * value:.0f} %"


STATUS = {
    "no_gap": "no gap",
    "negligible": "too small to matter",
    "parametric_only": "wrong parameters only",
    "explained": "explained",
    "detected_unexplained": "not fully explained",
    "not_testable": "cannot tell",
}
"""What a status says, in the fewest words."""


def gap_page(diagnosis: Diagnosis, origin: Origin) -> Page:
    """The page of a diagnosis."""
    d, far, unit = diagnosis, diagnosis.how_far, torque_unit(diagnosis.robot)
    numbers = [table.on_page() for table in lower_tables(d)]
    if d.findings:
        numbers.insert(2, coefficient_table(d))
    low, high = float(d.floor.low.norm()), float(d.floor.high.norm())
    return Page(
        f"Sim-to-real gap of {d.robot.name}",
        words.verdict(d),
        (
            ("Status", STATUS[d.status]),
            ("Closed [95 %]", closed_words(d)),
            ("Gap before, RMS", f"{float(far.rms_before.norm()):.3g} {unit}"),
            ("Gap after, RMS", f"{float(far.rms_after.norm()):.3g} {unit}"),
            ("Noise, RMS", f"{low:.3g} to {high:.3g} {unit}"),
        ),
        origin,
        answer=[answer_table(d).on_page()],
        pictures=_pictures(d),
        tables=numbers,
        notes=list(dict.fromkeys([*d.warnings, *d.floor.notes, *remarks(d)])),
        block=simulator_block(d.corrected) if d.findings else "",
    )


def coefficient_table(diagnosis: Diagnosis) -> Table:
    """Every coefficient of every accepted effect, with its interval."""
    rows = []
    for f in diagnosis.findings:
        for c, value, std in zip(f.effect.coefficients, f.values, f.std, strict=True):
            half = HALF_95 * std
            spread = (f"{std:.3g}", f"[{value - half:.6g}, {value + half:.6g}]")
            unit = unit_of(c.unit, f.located or f.joints, diagnosis.robot)
            rows.append(
                (
                    words.effect_words(f.effect.name), words.joints_words(f.located), c.name,
                    f"{value:.6g}", *(spread if math.isfinite(std) else ("-", "-")),
                    "-" if unit == "1" else unit_words(unit),
                )
            )  # fmt: skip
    return Table(
        "Coefficients of the effects",
        ("effect", "place", "coefficient", "value", "std", "95 % interval", "unit"),
        rows,
        names=("effect", "place", "coefficient", "unit"),
        note=f"Interval: value ± {HALF_95} std; std over blocks of the log, because neighbouring "
        "residuals are alike. A dash: the data do not tell.",
    )


def _pictures(d: Diagnosis) -> list[Picture]:
    """Where, the worst joints, what closes the gap."""
    unit, far, budget = torque_unit(d.robot), d.how_far, d.budget
    # The joint with the largest share, and when.
    worst = gap_figures.worst_joints(d, 1)[0]
    clear = words.clear_regimes(d, worst)
    when = f"above all {listed([words.REGIMES[r.regime] for r in clear])}"
    share = next(gap.share for gap in d.joints if gap.joint == worst)
    shares = [f"joint {gap.joint + 1} {percent(gap.share)}" for gap in d.joints]
    out: list[Picture] = []
    where = [
        Picture(
            "where",
            "Where the gap lies. Rows are joints, columns are kinds of motion: a blue cell holds "
            "more of the joint's gap than its share of time would. The bars say which joints "
            "matter, each gap beside its joint's noise: a pattern on a joint with a small share "
            f"matters little. Joint {worst + 1} holds {percent(share)} of the gap, "
            f"{when if clear else 'at no time more than at others'}.",
            f"Map of joints and kinds of motion. Shares of the gap: {', '.join(shares)}.",
            partial(gap_figures.map_figure, d),
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
                f"torque_{number}",
                f"Torque of joint {number} on data not fitted, where its gap is largest."
                f"{'' if k else _OVER_TIME}",
                f"Measured and modelled torque of joint {number} over time: {change}.",
                partial(gap_figures.torque_figure, d, joint),
            ),
            Picture(
                f"joint_{number}",
                f"What the model lacks on joint {number}: {change}.{'' if k else _AGAINST}",
                f"Gap of joint {number} against velocity, position, acceleration, torque and time, "
                f"and its spectrum: {change}.",
                partial(gap_figures.joint_figure, d, joint),
            ),
        ]
    # The torque of the worst joint comes first; then where the gap lies, if that says anything.
    out[1:1] = where if stands_out(d) else []
    pairs = zip(far.rms_before.tolist(), far.rms_after.tolist(), strict=True)
    said = [f"joint {j} {b:.3g} to {a:.3g}" for j, (b, a) in enumerate(pairs, start=1)]
    out.append(
        Picture(
            "how_far",
            "How far the gap shrinks, joint by joint, on data that took part in no choice. No "
            "model can be better than the grey noise; what of the blue bar rises above it is "
            "unexplained.",
            f"Bars of the gap before and after [{unit}]: {', '.join(said)}.",
            partial(gap_figures.bar_figure, d),
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
                partial(gap_figures.budget_figure, d),
            )
        )
    if d.knowledge is not None and d.knowledge.coefficients:
        out.append(
            Picture(
                "known",
                "What this log makes of what was known. Intervals hold 95 %; those before the log "
                "hold the change from one session to the next. A diamond marks a coefficient that "
                "has changed.",
                "Known coefficients before this log and with it.",
                partial(gap_figures.known_figure, d),
            )
        )
    if any(f.replication for f in d.findings):
        out.append(
            Picture(
                "repeats",
                "Is it the same in every motion? By which factor each part of the data, of about "
                "ten seconds, wants a cause: 1 is as it was fitted to all, 0 not at all. The grey "
                "band is where the next motion's would lie. A law repeats; what one motion alone "
                "wants is misfit.",
                "Factor of each cause, part by part of the data.",
                partial(gap_figures.repeats_figure, d),
            )
        )
    if any(f.planted for f in d.findings):
        out.append(
            Picture(
                "planted",
                "What this log would show, if what is left were noise: each cause, and its "
                "likeliest others, are planted again into shuffled blocks of it, and sought. A "
                "cause whose row is told as another cannot be told from it here; the curve says "
                "from which size on the cause is told, alone or in a set. It is the best that can "
                "be hoped for: what is left of a real arm holds other causes, too.",
                "Shares of draws in which each planted cause is told, and by size of the cause.",
                partial(gap_figures.planted_figure, d),
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
