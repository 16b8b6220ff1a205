"""A diagnosis as tables for people."""

import re
from typing import Any

from rich.markup import escape
from rich.table import Table

from torchid.effects.registry import KINDS
from torchid.gap.diagnosis import Diagnosis, JointGap, NotTestable, RegimeGap
from torchid.gap.record import INERTIA_MEANING, INERTIA_REMEDY
from torchid.report.gap_words import (
    CLEAR,
    coefficients,
    effect_words,
    joints_words,
    listed,
    regime_words,
    shapes,
    torque_unit,
)
from torchid.report.identification import compact
from torchid.report.text import interval, percent
from torchid.robot.model import JointType

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
    table = compact(f"where: torque the model lacks, below {diagnosis.band:g} Hz")
    table.add_column("joint")
    for heading in ("gap, RMS", "noise, RMS", "share"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column(f"holds more than its share (excess [95 %], p < {CLEAR:g})", ratio=1)
    for gap in diagnosis.joints:
        table.add_row(
            str(gap.joint + 1), f"{gap.gap_rms:.3g} {_unit(diagnosis, gap.joint)}", _floor(gap),
            percent(gap.share), _regimes(diagnosis, gap),
        )  # fmt: skip
    return table


def _regimes(diagnosis: Diagnosis, gap: JointGap) -> str:
    clear = [r for r in diagnosis.regimes if r.joint == gap.joint and r.p < CLEAR and r.excess > 0]
    clear.sort(key=lambda r: -r.excess)
    return ", ".join(_regime(r) for r in clear[:_MOST_REGIMES]) or "-"


def _regime(r: RegimeGap) -> str:
    text = escape(f"{regime_words(r.regime)} {percent(r.excess)} {interval(r.ci95)}")
    if r.times:
        shown = r.times[:_MOST_REGIMES]
        starts: dict[str, list[str]] = {}
        for name, start, _ in shown:
            starts.setdefault(name, []).append(f"{start:.1f}")
        places = [f"{', '.join(at)} s of {escape(name)}" for name, at in starts.items()]
        text += f" at {'; '.join(places)}{' ...' if len(r.times) > len(shown) else ''}"
    return text


def which_table(diagnosis: Diagnosis) -> Table:
    """Accepted effects with their coefficients."""
    table = compact("which: effects the model lacks (value ± std)")
    table.add_column("effect", no_wrap=True)
    table.add_column("joints", no_wrap=True)
    table.add_column("value", no_wrap=True)
    table.add_column("cannot be told from")
    for heading in ("lost\nwithout it", "closes\nalone", "p"):
        table.add_column(heading, justify="right")
    for f in diagnosis.findings:
        values = coefficients(f, diagnosis.robot)
        values = [*values[:_MOST_NUMBERS], *(["..."] if len(values) > _MOST_NUMBERS else [])]
        shape = f"\n({', '.join(shapes(f, diagnosis.robot))})" if f.effect.shapes else ""
        table.add_row(
            effect_words(f.effect.name), _joints(f.joints), escape("\n".join(values) + shape),
            _others(f.ambiguous_with), percent(f.share), percent(f.first), _p(f.p_value),
        )  # fmt: skip
    for p in diagnosis.parametric:
        links = [str(link + 1) for link in p.links]
        what = "all base parameters" if not links else f"inertia of link {listed(links)}"
        table.add_row(
            what, _joints(p.links) if links else "all", "see the corrected model",
            _others(p.ambiguous_with), percent(p.share), "-", _p(p.p_value),
        )  # fmt: skip
    return table


def meaning_table(diagnosis: Diagnosis) -> Table:
    """What each effect means and what to do; an effect on several joints once."""
    table = compact("what it means, and what to do")
    table.add_column("effect", no_wrap=True)
    table.add_column("what it means", ratio=1)
    table.add_column("what to do", ratio=1)
    for name in dict.fromkeys(f.effect.name for f in diagnosis.findings):
        same = [f for f in diagnosis.findings if f.effect.name == name]
        kind = same[0].effect
        notes = [f"{joints_words(f.located)}: {note}" for f in same for note in f.notes]
        meaning = "\n".join([kind.meaning, *notes])
        table.add_row(effect_words(name), escape(meaning), escape(kind.remedy))
    if diagnosis.parametric:
        table.add_row("inertial parameters", INERTIA_MEANING, INERTIA_REMEDY)
    return table


def how_far_table(diagnosis: Diagnosis) -> Table:
    """RMS per joint before and after, beside the noise."""
    far, floor, n = diagnosis.how_far, diagnosis.floor, diagnosis.robot.n
    unit = torque_unit(diagnosis.robot)
    table = compact(f"how far: RMS of what the model lacks \\[{unit}]")
    table.add_column("model")
    for j in range(n):
        table.add_column(str(j + 1), justify="right", no_wrap=True)
    table.add_column("all", justify="right")
    for name, rms in (("as given", far.rms_before), ("corrected", far.rms_after)):
        cells = [f"{v:.3g}" for v in rms.tolist()]
        table.add_row(name, *cells, f"{float(rms.norm()):.3g}")
    for name, level in (("noise, at least", floor.low), ("noise, at most", floor.high)):
        table.add_row(name, *(f"{v:.3g}" for v in level.tolist()), f"{float(level.norm()):.3g}")
    return table


def budget_table(diagnosis: Diagnosis) -> Table:
    """Shares of the gap, the closed fraction, and rollouts."""
    far, budget = diagnosis.how_far, diagnosis.budget
    table = compact("budget: what closes the gap")
    for heading in ("base parameters", "effects", "unexplained", "closed \\[95 %]"):
        table.add_column(heading, justify="right")
    closed = "the gap may be noise"
    if far.closed is not None and far.closed_ci95 is not None:
        closed = escape(f"{percent(far.closed)} {interval(far.closed_ci95)}")
    parts = (budget.parametric, budget.structural, budget.unexplained)
    shares = ["-"] * 3 if far.closed is None else [percent(x) for x in parts]
    table.add_row(*shares, closed)
    return table


def rollout_table(rollout: dict[str, Any]) -> Table:
    """Position errors of short simulations, corrected model relative to the given one."""
    table = compact("simulated motion: position error after to before")
    for heading in ("horizon", "ratio \\[95 %]", "lost before", "lost after"):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rollout.get("horizons", ()):
        if row.get("ratio") is None:
            continue
        within = row.get("ratio_ci95")
        span = f" \\[{within[0]:.2f}, {within[1]:.2f}]" if within else ""
        lost = [percent(row[key]) for key in ("diverged_before", "diverged_after")]
        table.add_row(f"{row['horizon_s']:g} s", f"{row['ratio']:.2f}{span}", *lost)
    return table


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
    table = compact("not testable with these data")
    table.add_column("effect", no_wrap=True)
    table.add_column("joint: smallest size that would have been seen", ratio=1)
    table.add_column("why", ratio=1)
    groups: dict[tuple[str, str], list[NotTestable]] = {}
    for x in diagnosis.not_testable:
        groups.setdefault((x.effect, _NUMBER.sub("#", x.reason)), []).append(x)
    for (effect, _), members in groups.items():
        table.add_row(effect_words(effect), _smallest(members), escape(_reason(members)))
    return table


def _reason(members: list[NotTestable]) -> str:
    """The reason, which differs in its numbers only; of several, from the least to the greatest."""
    found = [_NUMBER.findall(x.reason) for x in members]
    spans = []
    for same in zip(*found, strict=True):
        low, high = min(same, key=float), max(same, key=float)
        spans.append(low if low == high else f"{low} to {high}")
    each = iter(spans)
    return _NUMBER.sub(lambda _: next(each), members[0].reason)


def _smallest(members: list[NotTestable]) -> str:
    """`2: 0.4 N m; joint 3: ...`; joints on which no size would do together."""
    never = [x for x in members if x.smallest_detectable is None]
    texts = [
        f"{_place(x)}: {x.smallest_detectable:.3g} {x.unit}".rstrip()
        for x in members
        if x.smallest_detectable is not None
    ]
    if never:
        texts.append(f"{', '.join(_place(x) for x in never)}: no size")
    return "; ".join(texts)


def _place(x: NotTestable) -> str:
    return " and ".join(str(j + 1) for j in x.joints) or "the arm"


def experiment_table(experiment: dict[str, Any]) -> Table:
    """What to record next."""
    table = compact("next experiment")
    table.add_column("", no_wrap=True)
    table.add_column("", ratio=1)
    table.show_header = False
    for key, value in experiment.items():
        text = _value(value)
        if text:
            table.add_row(key.replace("_", " "), escape(text))
    return table


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


def _unit(diagnosis: Diagnosis, joint: int) -> str:
    return "N" if diagnosis.robot.joint_types[joint] is JointType.PRISMATIC else "N m"


def _floor(gap: JointGap) -> str:
    low, high = gap.noise_floor_rms
    return f"{low:.3g} - {high:.3g}"


def _joints(joints: tuple[int, ...]) -> str:
    return ", ".join(str(j + 1) for j in joints) or "all"


def _others(names: tuple[str, ...]) -> str:
    return "\n".join(effect_words(name) for name in names) or "-"


def _p(value: float | None) -> str:
    if value is None:
        return "-"
    return "< 0.001" if value < 1e-3 else f"{value:.3f}"
