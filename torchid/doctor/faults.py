"""What the search found, as checks: order, signs, gains, and what cannot be told."""

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from torchid.doctor.check import Check, Choice, judged, with_choices, worded_check
from torchid.doctor.hypothesis import Hypothesis, Judge, factors_of, profile
from torchid.doctor.moves import FAULTS, TENTH, Move, invisible_groups, least_groups
from torchid.doctor.record import Verdict
from torchid.doctor.repair import MappedColumns
from torchid.doctor.search import FoundFault, Search, percent
from torchid.doctor.size import nominal_loss, nominal_slopes, other_moments
from torchid.robot.model import joint_list
from torchid.statistics.criteria import CLEAR_GAIN, LEAST_GAIN, TOLD, UNEXPLAINED

_ALWAYS = ("joint order", "torque sign", "position sign", "gain of a joint")
"""Checks that are there without a fault, too."""
UNTOLD = "the torque is not explained either way"
"""Of what bodies do not explain."""


def denied_faults(judge: Judge, result: Search) -> list[FoundFault]:
    """Faults that the robot's own parameters do not confirm."""
    modelled = [f for f in result.faults if FAULTS[f.move.kind].modelled]
    return [f for f in modelled if _nominal_objects(judge, f)]


def confirmed(result: Search, denied: Sequence[FoundFault]) -> Hypothesis:
    """Where a search ended, or stood before the first fault that the robot's own parameters do not
    confirm: what they say of the torque's size holds for motion as it is logged."""
    return denied[0].move.before if denied else result.final.hypothesis


def fault_checks(
    judge: Judge,
    result: Search,
    denied: Collection[FoundFault],
    fixes: Collection[str] = (),
    before: Sequence[Check] = (),
) -> list[Check]:
    """One check a fault, and one line for each kind that has none.

    Args:
        judge, result: of the log, and of the search for faults.
        denied: as of `denied_faults`.
        fixes: names of those that are chosen.
        before: checks of the signals, which may have scaled the positions.
    """
    unit = _taken_unit(before)
    live = judge.live(result.final.hypothesis)
    checked = [f for f in result.faults if FAULTS[f.move.kind].check]
    checks = [
        _explained(judge, result, live),
        *(_check(judge, result, f, f in denied, fixes, unit) for f in checked),
    ]
    names = {c.name for c in checks}
    for name in _ALWAYS:
        if name in names:
            continue
        if not live or (len(live) < 2 and name in ("joint order", "gain of a joint")):
            checks.append(judged(name, "cannot tell", "fewer than two joints move with a torque"))
        elif not result.explained:
            checks.append(judged(name, "cannot tell", UNTOLD))
        else:
            checks.append(worded_check(name, "fine"))
    return checks


def unseen_faults(judge: Judge, result: Search) -> list[Check]:
    """Faults that would not show in this log: having them costs too little."""
    out = []
    # Groups of joints that are named
    most_named = 4
    for kind in (kind for kind, fault in FAULTS.items() if fault.hides):
        groups = [m.joints for cost, m in result.costs if m.kind == kind and cost < CLEAR_GAIN]
        if kind == "joint sign":
            # Of groups, those that the robot's geometry allows; what they make up is not said.
            mirrored = invisible_groups(judge.robot, result.final.hypothesis.gravity)
            least = [tuple(sorted(g)) for g in least_groups(mirrored)]
            groups = [*(g for g in groups if len(g) == 1), *(g for g in least if len(g) > 1)]
        if kind == "gain":
            groups = [(k,) for k in _of_any_size(judge, result)]
        places = list(dict.fromkeys(joint_list(g) for g in sorted(groups, key=len)))
        if not places:
            continue
        if len(places) > most_named:
            places[most_named:] = [f"{len(places) - most_named} more"]
        joints = sorted({k for g in groups for k in g})
        out.append(
            worded_check(f"unseen {kind}", "cannot tell", " or of ".join(places), joints=joints)
        )
    return out


def _of_any_size(judge: Judge, result: Search) -> list[int]:
    """Joints whose torque bodies explain about as well ten times as large or as small, and of whose
    size nominal parameters say nothing."""
    end, weights = result.final.hypothesis, result.final.fit.weights
    known = nominal_slopes(judge, end).joints if judge.robot.parameters else ()
    some = [k for k in judge.live(end) if k not in known] if len(judge.live(end)) > 1 else []
    sizes = {k: [end.scaled((k,), tau=math.exp(x)) for x in (TENTH, -TENTH)] for k in some}
    most = result.final.loss + CLEAR_GAIN
    return [k for k in some if min(judge.score(h, weights).loss for h in sizes[k]) < most]


def _explained(judge: Judge, result: Search, live: Sequence[int]) -> Check:
    """What bodies, friction, rotors and offsets leave of the torque, everything mended."""
    if not live:
        return judged("torque explained", "cannot tell", "nothing moves with a torque")
    left = result.left[list(live)]
    text = "bodies that can exist, friction and offsets leave " + ", ".join(
        f"{percent(x)} (joint {k + 1})" for k, x in zip(live, left, strict=True)
    )
    verdict = "fine" if result.explained else "doubtful"
    text = f"{text} of the torque's spread, on time held out"
    odd = [k for k, x in zip(live, left, strict=True) if x > UNEXPLAINED]
    for joints, moment in moments_of(judge, result, odd):
        text += f"; the torque of {joint_list(joints)} is {moment}"
    return worded_check(
        "torque explained", verdict, joints=live, estimate=tuple(left.tolist()), text=text
    )


def moments_of(judge: Judge, result: Search, joints: Sequence[int]) -> list[tuple[list[int], str]]:
    """Joints (from 0) whose torque is another component of what the joint passes on, grouped by
    that component in words."""
    groups: dict[str, list[int]] = {}
    for k, axis in other_moments(judge, result.final.hypothesis, joints).items():
        groups.setdefault(axis, []).append(k)
    words = "the moment about {} of the link's frame, not the axis"
    return [(groups[axis], words.format(axis)) for axis in sorted(groups)]


def _taken_unit(before: Sequence[Check]) -> dict[int, float]:
    """What positions were multiplied by for their unit, by joint; empty where they were not."""
    maps = [
        r.map.factors
        for c in before
        if c.name == "position unit"
        for r in c.repairs
        if isinstance(r, MappedColumns) and "q" in r.signals
    ]
    return dict(enumerate(maps[0])) if maps else {}


def _check(
    judge: Judge,
    result: Search,
    one_fault: FoundFault,
    denied: bool,
    fixes: Collection[str],
    unit: dict[int, float],
) -> Check:
    move, end, fault = one_fault.move, result.final.hypothesis, FAULTS[one_fault.move.kind]
    assert fault.check is not None
    choices, own = choices_of(one_fault), dict[str, Any](joints=move.joints)
    first, last = "", ""
    # Of a torque that nothing explains (a limit, a controller's) another sign explains no more.
    concerned = list(move.joints or judge.live(end))
    unsure = not result.explained or float(np.median(result.left[concerned])) > TOLD
    if move.kind == "gain":
        # The joint's torque over what it should be, refined with everything else mended.
        (one,) = move.joints
        fine = profile(
            judge, lambda x: end.scaled((one,), tau=math.exp(x)), (-0.3, 0.3), start=0.0, step=0.1
        )
        share = move.columns[0].map.factors[one]
        factor, *ends = (1 / (share * math.exp(x)) for x in (fine.value, fine.high, fine.low))
        low, high = min(ends), max(ends)
        scale = factors_of((one,), judge.robot.n, 1.0 / factor)
        choices[0] = Choice.by(choices[0].name, replace(move.columns[0], map=scale))
        first = (
            f"torque is {factor:.3g} ({low:.3g} to {high:.3g}) times what the other joints' "
            "torques predict; "
        )
        own |= {"estimate": factor, "interval": (low, high), "unit": "ratio"}
        # A gain that may as well be right.
        unsure |= low < LEAST_GAIN and high > 1.0 / LEAST_GAIN
    if move.kind == "position unit":
        factor = 1.0 / move.columns[0].map.factors[move.joints[0]]
        first = f"{factor:.4g} times the angles that explain the torque; "
        if unit:
            factor /= unit[move.joints[0]]
            last = (
                f"; the log's are {factor:.4g} times the joints' angles: motors before their gears?"
            )
        own |= {"estimate": factor}
    rivals = ", ".join(_name(r) for r in one_fault.rivals)
    text = first + improvement_text(one_fault) + (f"; as good: {rivals}" if rivals else "")
    if denied:
        text += "; the robot's own parameters do not confirm it"
    doubtful = denied or not one_fault.needed
    verdict: Verdict = "cannot tell" if unsure else "doubtful" if doubtful else "wrong"
    check = judged(fault.check, verdict, f"{_name(move)}: {text}{last}", **own)
    return check if unsure else with_choices(check, choices, fixes, sure=not doubtful)


def _nominal_objects(judge: Judge, fault: FoundFault) -> bool:
    """Whether the robot has parameters that explain the torque no better with a fault mended: two
    witnesses, for free bodies find more than one way to explain a slow or narrow motion."""
    if judge.robot.parameters is None or not judge.robot.parameters.pi.any():
        return False
    if fault.move.kind == "gain":
        # Of every size it explains as much: mended, it is nearer to the other joints' size.
        (joint,) = fault.move.joints
        before, after = (_odd_size(judge, h, joint) for h in (fault.move.before, fault.move.after))
        return not after < before
    gain = nominal_loss(judge, fault.move.before) - nominal_loss(judge, fault.move.after)
    return gain < CLEAR_GAIN


def _odd_size(judge: Judge, hypothesis: Hypothesis, joint: int) -> float:
    """Logarithm of the factor between one joint's torque over nominal torque and the others'
    median; infinite where either is not clear."""
    slopes = nominal_slopes(judge, hypothesis)
    own = np.array(slopes.joints) == joint
    others = slopes.value[slopes.clear & ~own]
    if not (slopes.clear & own).any() or not len(others):
        return math.inf
    return abs(math.log(float(slopes.value[own][0] / np.median(others))))


def choices_of(fault: FoundFault) -> list[Choice]:
    """The fault that was found and those that would explain the log as well."""
    return [
        Choice(m.name, gravity_fix(m.after.gravity), m.repairs)
        if m.kind == "gravity"
        else Choice.by(m.name, *m.repairs)
        for m in (fault.move, *fault.rivals)
    ]


def gravity_fix(gravity: Sequence[float] | np.ndarray) -> str:
    """Where to write down the direction of gravity (3,) [m/s^2]."""
    vector = ", ".join(f"{x:.2f}" for x in gravity)
    return (
        f"gravity: [{vector}] in the robot's yaml (of arm.urdf: arm.urdf.effects.yaml beside it, "
        "with `joints: [their names]`)"
    )


def improvement_text(fault: FoundFault) -> str:
    """What mending does to the error of the joints it matters to most, held out."""
    ratio = fault.before / fault.after
    worst = [int(k) for k in np.argsort(-ratio)[:3] if fault.helped[k]]
    changes = ", ".join(
        f"joint {k + 1} {percent(fault.before[k])} -> {percent(fault.after[k])}" for k in worst
    )
    return f"held-out error {changes}, better in {fault.blocks[0]} of {fault.blocks[1]} blocks"


def _name(move: Move) -> str:
    words = FAULTS[move.kind].words
    return f"{words} {joint_list(move.joints)}" if move.joints else words
