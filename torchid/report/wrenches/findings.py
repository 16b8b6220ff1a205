"""What a study of sets with equal torque says, in sentences that follow its intervals."""

import math

from torchid.study.equal_torque.statistics import Across
from torchid.study.equal_torque.study import EqualTorqueStudy
from torchid.wrenches.compare import EffectSize
from torchid.wrenches.resampling import Estimate

_NEARLY_ALL = 0.1
"""Share of the force error that may be missing where it is called the carried mass's weight."""
_COMPARED = (
    ("inertia only", "feasible"), ("CoM only", "feasible"), ("CoM only", "inertia only"),
)  # fmt: skip
"""Classes whose difference is told."""
_WORDS = {"inertia": "inertia", "com": "centres of mass"}


def findings(study: EqualTorqueStudy) -> list[str]:
    """What the numbers say, a sentence each; `cannot tell` where an interval says so."""
    told = [
        f"The torque is equal: the largest difference of any set at any joint is "
        f"{float(study.torque_relative.max()):.0e} of that joint's torque.",
        weight_sentence(study.static_share),
    ]
    effects = study.comparison.effects
    told += [_effect_sentence(e) for e in effects if (e.first, e.second) in _COMPARED]
    for c in study.statistics.correlations:
        if c.kind in ("feasible", "inertia", "com"):
            told.append(_degree_sentence(c.kind, c.degree))
    told += [_across_sentence(a) for a in study.statistics.across if a.kind in ("inertia", "com")]
    # What any set can do, feasible ones first.
    reach = {r.kind: r for r in study.reach}
    if "feasible" in reach:
        greatest = float(reach["feasible"].reached.max())
        told.append(f"Even feasible sets can be off by {greatest:.3g} N.")
        for kind in (kind for kind in ("inertia", "com") if kind in reach):
            times = (reach[kind].reached / reach["feasible"].bound).clamp(min=1.0).tolist()
            told.append(
                f"With {_WORDS[kind]} violated alone, the greatest error of any set is at least "
                f"{', '.join(f'{t:.2f}' for t in times)} times that of feasible ones (joint by "
                "joint)."
            )
    if study.to_nominal is not None:
        classes = [c for c in study.to_nominal.classes if c.median is not None]
        medians = ", ".join(f"{c.name} {c.median:.3g}" for c in classes)
        told.append(
            "Against the nominal parameters, which have another torque and are not feasible, the "
            f"medians are {medians} N; the reference itself is {study.reference_to_nominal:.3g} N "
            "away."
        )
    return told


def weight_sentence(share: tuple[float, float, float]) -> str:
    """How much of the largest force error is the weight of the carried mass's error: the median
    over the sets and the ends of their 95 % range. Only where it is nearly all of it in nearly all
    sets, of whatever kind, do the masses alone count."""
    middle, low, high = share
    apart = max(abs(1 - low), abs(1 - high))
    if apart <= _NEARLY_ALL:
        return (
            f"The force error is the weight of the carried mass's error to {100 * apart:.2g} % "
            "(95 % of all sets): what counts is how far the masses are off, whatever the reason "
            "for which a set is infeasible."
        )
    return (
        f"The weight of the carried mass's error is {100 * middle:.3g} % of the force error (95 % "
        f"of all sets: {100 * low:.3g} to {100 * high:.3g} %): in this motion first moments and "
        "accelerations count as well."
    )


def _effect_sentence(effect: EffectSize) -> str:
    ratio = effect.ratio
    names = {"inertia only": "inertia", "CoM only": "centres of mass"}
    who = f"Drawn sets that violate {names[effect.first]} only"
    against = (
        "drawn feasible sets"
        if effect.second == "feasible"
        else f"those that violate {names[effect.second]} only"
    )
    if math.isnan(ratio.low):
        return f"{who}, against {against}: too few independent chains to tell."
    how = f"{ratio.value:.2f} times the force error (95 %: {ratio.low:.2f} to {ratio.high:.2f})"
    if ratio.low <= 1 <= ratio.high:
        return f"{who} cannot be told from {against}: {how}."
    return f"{who} have {how} of {against}."


def _degree_sentence(kind: str, rho: Estimate) -> str:
    among = "feasible sets" if kind == "feasible" else f"sets that violate {_WORDS[kind]} only"
    if math.isnan(rho.low):
        return f"Among {among}: too few independent chains to tell whether the degree matters."
    how = f"rho = {rho.value:.2f} (95 %: {rho.low:.2f} to {rho.high:.2f})"
    if rho.low <= 0 <= rho.high:
        return f"Among {among} no effect of the degree can be told: {how}."
    which = "firmer" if kind == "feasible" else "less violating"
    side = "smaller" if rho.value < 0 else "larger"
    return f"Among {among} {which} ones have {side} errors: {how}."


def _across_sentence(across: Across) -> str:
    what = f"Just outside and just inside the boundary of {_WORDS[across.kind]}"
    low, high = across.ratio.low, across.ratio.high
    if math.isnan(low):
        return f"{what}: too few independent chains to tell whether the error jumps."
    how = f"{across.ratio.value:.2f} times (95 %: {low:.2f} to {high:.2f})"
    if low <= 1 <= high:
        return f"{what} no jump of the error can be told: {how}."
    return f"{what} the errors differ: {how}; their tightest conditions need not be the same ones."
