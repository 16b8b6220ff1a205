"""What the search found, as checks: order, signs, gains, and what cannot be told."""

import math
from collections.abc import Collection, Sequence

import numpy as np

from torchid.doctor.check import TEXTS, Check, Choice, judged, said, with_choices
from torchid.doctor.hypothesis import Hypothesis, Judge, profile
from torchid.doctor.moves import LEAST_GAIN, Move, invisible_groups, least_groups
from torchid.doctor.repair import TORQUE, Scale, of_signals
from torchid.doctor.search import CLEAR, Found, Search
from torchid.doctor.size import nominal_loss
from torchid.robot.model import joint_list

CHECK_OF = {
    "torque sign": "torque sign",
    "position sign": "position sign",
    "joint sign": "position sign",
    "torque order": "joint order",
    "position order": "joint order",
    "joint order": "joint order",
    "gain": "gain of a joint",
    "position unit": "position unit, by torque",
    "zero": "zero of positions",
}
_ALWAYS = ("joint order", "torque sign", "position sign", "gain of a joint")
"""Checks that are there without a fault, too."""
_UNSEEN = (
    "torque sign", "position sign", "joint sign", "joint order", "torque order", "position order",
)  # fmt: skip
_TOLD = 4
MOST_LEFT = 0.45
"""Share of the spread of a joint's torque that is left at most where a fault of it is told."""
_MODELLED = ("joint order", "torque sign", "position sign")
"""Checks that nominal parameters bear out, or not."""


def fault_checks(judge: Judge, result: Search, fixes: Collection[str] = ()) -> list[Check]:
    """One check a fault, and one line for each kind that has none."""
    live = judge.live(result.final.hypothesis)
    found = [f for f in result.found if f.move.kind in CHECK_OF]
    checks = [_explained(result, live), *(_check(judge, result, f, fixes) for f in found)]
    names = {c.name for c in checks}
    for name in _ALWAYS:
        if name in names:
            continue
        if not live or (len(live) < 2 and name in ("joint order", "gain of a joint")):
            checks.append(judged(name, "cannot tell", "fewer than two joints move with a torque"))
        elif not result.explained:
            checks.append(judged(name, "cannot tell", "the torque is not explained either way"))
        else:
            checks.append(said(name, "fine"))
    return checks


def unseen_faults(judge: Judge, result: Search) -> list[Check]:
    """Faults that would not show in this log: having them costs too little."""
    out = []
    for kind in _UNSEEN:
        groups = [m.joints for cost, m in result.costs if m.kind == kind and cost < CLEAR]
        if kind == "joint sign":
            # Of groups, those that the robot's geometry allows; what they make up is not said.
            mirrored = invisible_groups(judge.robot, result.final.hypothesis.gravity)
            least = [tuple(sorted(g)) for g in least_groups(mirrored)]
            groups = [*(g for g in groups if len(g) == 1), *(g for g in least if len(g) > 1)]
        told = list(dict.fromkeys(joint_list(g) for g in sorted(groups, key=len)))
        if not told:
            continue
        if len(told) > _TOLD:
            told[_TOLD:] = [f"{len(told) - _TOLD} more"]
        joints = sorted({k for g in groups for k in g})
        out.append(said(f"unseen {kind}", "cannot tell", " or of ".join(told), joints=joints))
    return out


def _explained(result: Search, live: Sequence[int]) -> Check:
    """What bodies, friction, rotors and offsets leave of the torque, everything mended."""
    if not live:
        return judged("torque explained", "cannot tell", "nothing moves with a torque")
    left = result.left[list(live)]
    text = "bodies that can exist, friction and offsets leave " + ", ".join(
        f"{100 * x:.0f} % (joint {k + 1})" for k, x in zip(live, left, strict=True)
    )
    verdict = "fine" if result.explained else "doubtful"
    text = f"{text} of the torque's spread, on time held out"
    return said("torque explained", verdict, joints=live, estimate=tuple(left.tolist()), text=text)


def _check(judge: Judge, result: Search, found: Found, fixes: Collection[str]) -> Check:
    move = found.move
    first, *others = choices_of(found)
    estimate: float | tuple[float, ...] | None = None
    interval: tuple[float, float] | None = None
    text = improvement_text(found)
    if move.kind == "gain":
        # The joint's torque over what it should be, refined with everything else mended.
        one = move.joints[0]
        end = result.final.hypothesis
        fine = profile(
            judge, lambda x: end.scaled((one,), tau=math.exp(x)), (-0.3, 0.3), start=0.0, step=0.1
        )
        share = next(r for r in move.repairs if isinstance(r, Scale)).factors[one]
        values = [1.0 / (share * math.exp(x)) for x in (fine.value, fine.high, fine.low)]
        factor, interval = values[0], (min(values[1:]), max(values[1:]))
        factors = tuple(1.0 / factor if k == one else 1.0 for k in range(judge.robot.n))
        scale = of_signals(Scale(TORQUE, factors), judge.samples.signals)
        first = Choice.by(first.name, scale)
        estimate = factor
        text = (
            f"torque is {factor:.3g} ({interval[0]:.3g} to {interval[1]:.3g}) times what the other "
            f"joints' torques predict; {text}"
        )
    if move.kind == "position unit":
        whole = next(r for r in move.repairs if isinstance(r, Scale))
        estimate = 1.0 / whole.factors[move.joints[0]]
        text = f"{estimate:.4g} times the angles that explain the torque; {text}"
    # Of a torque that nothing explains (a limit, a controller's) another sign explains no more.
    concerned = list(move.joints or judge.live(result.final.hypothesis))
    unsure = not result.explained or float(np.median(result.left[concerned])) > MOST_LEFT
    if interval is not None:
        # A gain that may as well be right.
        unsure |= interval[0] < LEAST_GAIN and interval[1] > 1.0 / LEAST_GAIN
    if found.rivals:
        text += "; as good: " + ", ".join(_name(r) for r in found.rivals)
    doubtful = CHECK_OF[move.kind] in _MODELLED and _nominal_objects(judge, result, found)
    if doubtful:
        text += "; the robot's own parameters do not confirm it"
    check = judged(
        CHECK_OF[move.kind],
        "cannot tell" if unsure else "doubtful" if doubtful else "wrong",
        f"{_name(move)}: {text}",
        joints=move.joints,
        estimate=estimate,
        interval=interval,
        unit="ratio" if move.kind == "gain" else "",
    )
    return check if unsure else with_choices(check, [first, *others], fixes)


def _nominal_objects(judge: Judge, result: Search, found: Found) -> bool:
    """Whether the robot has parameters that explain the torque no better with a fault mended: two
    witnesses, for free bodies find more than one way to explain a slow or narrow motion."""
    if judge.robot.parameters is None or not judge.robot.parameters.pi.any():
        return False
    place = result.found.index(found)
    before = result.found[place - 1].move.after if place else Hypothesis.literal(judge.robot)
    gain = nominal_loss(judge, before) - nominal_loss(judge, found.move.after)
    return gain < CLEAR


def choices_of(found: Found) -> list[Choice]:
    """The fault that was found and those that would explain the log as well."""
    return [
        Choice(m.name, gravity_fix(m.after.gravity), m.repairs)
        if m.kind == "gravity"
        else Choice.by(m.name, *m.repairs)
        for m in (found.move, *found.rivals)
    ]


def gravity_fix(gravity: Sequence[float] | np.ndarray) -> str:
    """Where to write down the direction of gravity (3,) [m/s^2]."""
    vector = ", ".join(f"{x:.2f}" for x in gravity)
    return (
        f"gravity: [{vector}] in the robot's yaml (of arm.urdf: arm.urdf.effects.yaml beside it, "
        "with `joints: [their names]`)"
    )


def improvement_text(found: Found) -> str:
    """What mending does to the error of the joints it matters to most, held out."""
    ratio = found.before / found.after
    worst = [int(k) for k in np.argsort(-ratio)[:3] if ratio[k] > 1.1]
    changes = ", ".join(
        f"joint {k + 1} {100 * found.before[k]:.0f} % -> {100 * found.after[k]:.1f} %"
        for k in worst
    )
    return f"held-out error {changes}, better in {found.blocks[0]} of {found.blocks[1]} blocks"


def _name(move: Move) -> str:
    words = TEXTS["moves"][move.kind]
    return f"{words} {joint_list(move.joints)}" if move.joints else words
