"""What these data could show: visibility of every effect, and the smallest size that would have
been found."""

import math
from collections.abc import Sequence

from torchid.effects.base import Effect
from torchid.gap.diagnosis import NotTestable
from torchid.gap.problem import BASE, FRICTION, LINK, Problem, Term, term_of
from torchid.gap.projection import Projector
from torchid.robot.model import JointType, Robot
from torchid.typing import Tensor

VISIBLE = 0.02
"""Share of a column's square that must be left beside the model for its effect to be testable."""

LARGE = 0.5
"""Torque, as a share of the joint's own, below which a testable effect must be detectable."""

MARGIN = 2.0
"""On the gain: an effect of just the threshold's size is found in half of the cases."""


def not_testable(
    problem: Problem, model: Projector, robot: Robot, torque: Tensor, found: Sequence[Term]
) -> list[NotTestable]:
    """Effects that these data cannot show, one entry an effect and place.

    Args:
        problem: rows and candidates.
        model: what is in the model: free base parameters hide other effects than trusted ones.
        robot: for units.
        found: accepted terms, which are not listed.
        torque: (n,) RMS of each joint's whitened torque, as a measure of what is large.
    """
    out = []
    accepted = {term.key for term in found}
    for bank in problem.banks:
        if bank.name in (BASE, LINK, FRICTION) or term_of(bank).key in accepted:
            continue
        effect = bank.members[0][0]
        column = bank.columns[:, 0]
        rows = model.rows_of(bank.place)
        size = column.square().sum(1)
        left = size - (column @ model.q[:, rows].T).square().sum(1)
        k = int(left.argmax())
        share = float(left[k] / size[k]) if float(size[k]) > 0 else 0.0
        unit = _unit(effect, robot)
        if float(size[k]) <= 1e-12 * problem.noise:
            out.append(_entry(effect, None, unit, "the motion does not excite it"))
            continue
        smallest = math.sqrt(MARGIN * problem.threshold(1) / max(float(left[k]), 1e-300))
        if share < 1e-6:
            reason = "exactly a combination of parameters that are fitted"
            out.append(_entry(effect, None, unit, reason))
        elif share < VISIBLE:
            reason = f"only {100 * share:.2g} % of it is not a combination of what is fitted"
            out.append(_entry(effect, smallest, unit, reason))
        elif bank.place is not None:
            largest = LARGE * float(torque[bank.place]) * math.sqrt(problem.y.shape[1])
            if smallest * float(size[k].sqrt()) > largest:
                reason = "noise hides it up to half of the joint's torque"
                out.append(_entry(effect, smallest, unit, reason))
    return out


def _entry(effect: Effect, smallest: float | None, unit: str, reason: str) -> NotTestable:
    return NotTestable(effect.name, effect.joints, smallest, unit, reason)


def _unit(effect: Effect, robot: Robot) -> str:
    joints = effect.joints
    prismatic = bool(joints) and robot.joint_types[joints[0]] is JointType.PRISMATIC
    return effect.coefficients[0].unit_for(prismatic)
