"""A diagnosis as tables for people."""

import re
from typing import Any

from torchid.effects.registry import KINDS
from torchid.gap.diagnosis import Diagnosis, NotTestable
from torchid.gap.record import INERTIA_MEANING, INERTIA_REMEDY
from torchid.report.gap_words import (
    CLEAR,
    coefficients,
    effect_words,
    joints_words,
    listed,
    regime_words,
    shapes,
)  # fmt: skip
from torchid.report.table import Table
from torchid.report.text import interval, joint_unit, percent, torque_unit

_MOST_REGIMES = 3
_MOST_NUMBERS = 12
_NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w])")


def tables(diagnosis: Diagnosis) -> list[Table]:
    """Where, which, what it means, how far, what could not be tested, what to do next."""
    out = [where_table(diagnosis)]
    if diagnosis.findings or diagnosis.parametric:
        out += [which_table(diagnosis), meaning_table(diagnosis)]
    out += [how_far_table(diagnosis), budget_table(diagnosis)]
    if diagnosis.how_far.rollout:
        out.append(rollout_table(diagnosis.how_far.rollout))
    if diagnosis.not_testable:
        out.append(not_testable_table(diagnosis))
    if diagnosis.next_experiment:
        out.append(experiment_table(diagnosis.next_experiment))
    return out


def where_table(diagnosis: Diagnosis) -> Table:
    """Joints: size and share of the gap, and the regimes that hold more than their share."""
    rows = []
    for gap in diagnosis.joints:
        clear = [
            r for r in diagnosis.regimes if r.joint == gap.joint and r.p < CLEAR and r.excess > 0
        ]
        said = []
        for r in sorted(clear, key=lambda r: -r.excess)[:_MOST_REGIMES]:
            text = f"{regime_words(r.regime)} {percent(r.excess)} {interval(r.ci95)}"
            if r.times:
                starts: dict[str, list[str]] = {}
                for name, start, _ in r.times[:_MOST_REGIMES]:
                    starts.setdefault(name, []).append(f"{start:.1f}")
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
    regimes = f"holds more than its share (excess [95 %], p < {CLEAR:g})"
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
        values = coefficients(f, diagnosis.robot)
        values = [*values[:_MOST_NUMBERS], *(["..."] if len(values) > _MOST_NUMBERS else [])]
        if f.effect.shapes:
            values.append(f"({', '.join(shapes(f, diagnosis.robot))})")
        joints = ", ".join(str(j + 1) for j in f.joints) or "all"
        shares = (percent(f.share), percent(f.first), _p(f.p_value))
        what = effect_words(f.effect.name)
        rows.append((what, joints, "\n".join(values), _others(f.ambiguous_with), *shares))
    for p in diagnosis.parametric:
        links = [str(link + 1) for link in p.links]
        what = f"inertia of link {listed(links)}" if links else "all base parameters"
        rows.append(
            (
                what, ", ".join(links) or "all", "see the corrected model",
                _others(p.ambiguous_with), percent(p.share), "-", _p(p.p_value),
            )
        )  # fmt: skip
    columns = (
        "effect", "joints", "value", "cannot be told from", "lost\nwithout it", "closes\nalone",
        "p",
    )  # fmt: skip
    title = "which: effects the model lacks (value ± std)"
    return Table(title, columns, rows, names=columns[:3], words=columns[3:4])


def meaning_table(diagnosis: Diagnosis) -> Table:
    """What each effect means and what to do; an effect on several joints once."""
    rows = []
    for name in dict.fromkeys(f.effect.name for f in diagnosis.findings):
        same = [f for f in diagnosis.findings if f.effect.name == name]
        kind = same[0].effect
        notes = [f"{joints_words(f.located)}: {note}" for f in same for note in f.notes]
        rows.append((effect_words(name), "\n".join([kind.meaning, *notes]), kind.remedy))
    if diagnosis.parametric:
        rows.append(("inertial parameters", INERTIA_MEANING, INERTIA_REMEDY))
    columns = ("effect", "what it means", "what to do")
    return Table(
        "what it means, and what to do", columns, rows, names=columns[:1], words=columns[1:]
    )


def how_far_table(diagnosis: Diagnosis) -> Table:
    """RMS per joint before and after, beside the noise."""
    far, floor = diagnosis.how_far, diagnosis.floor
    rows = [
        (name, *(f"{v:.3g}" for v in level.tolist()), f"{float(level.norm()):.3g}")
        for name, level in (
            ("as given", far.rms_before), ("corrected", far.rms_after),
            ("noise, at least", floor.low), ("noise, at most", floor.high),
        )
    ]  # fmt: skip
    joints = (str(j + 1) for j in range(diagnosis.robot.n))
    title = f"how far: RMS of what the model lacks [{torque_unit(diagnosis.robot)}]"
    return Table(title, ["model", *joints, "all"], rows, words=("model",))


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
        return "the gap may be noise"
    return f"{percent(far.closed)} {interval(far.closed_ci95)}"


def rollout_table(rollout: dict[str, Any]) -> Table:
    """Position errors of short simulations, corrected model relative to the given one."""
    rows = []
    for row in rollout.get("horizons", ()):
        if row.get("ratio") is None:
            continue
        within = row.get("ratio_ci95")
        span = f" [{within[0]:.2f}, {within[1]:.2f}]" if within else ""
        lost = [percent(row[key]) for key in ("diverged_before", "diverged_after")]
        rows.append((f"{row['horizon_s']:g} s", f"{row['ratio']:.2f}{span}", *lost))
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
    return [*out, *(diagnosis.how_far.rollout or {}).get("sentences", ())]


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
        rows.append((effect_words(effect), "; ".join(sizes), _reason(members)))
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


def experiment_table(experiment: dict[str, Any]) -> Table:
    """What to record next."""
    texts = {key.replace("_", " "): _value(value) for key, value in experiment.items()}
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
    return "" if value is None else effect_words(value) if value in KINDS else str(value)


def _others(names: tuple[str, ...]) -> str:
    return "\n".join(effect_words(name) for name in names) or "-"


def _p(value: float | None) -> str:
    if value is None:
        return "-"
    return "< 0.001" if value < 1e-3 else f"{value:.3f}"
