"""The pairs that a motion must separate: each open explanation against every form of the other."""

import math
from collections.abc import Iterator, Sequence
from itertools import product

from torchid.effects.base import JointEffect, ModelEffect
from torchid.effects.registry import KINDS
from torchid.excitation.fourier import FourierTrajectory
from torchid.next_motion.ambiguity import INERTIAL, LINK, Open, Question
from torchid.next_motion.rows import Group, Rows
from torchid.next_motion.separation import Explanation, Rival, imitation
from torchid.robot.model import Robot

PLAUSIBLE = 0.1
"""Torque of an effect that a log could not show, as a share of its joints' own: what is asked to be
seen."""


def rivals(found: Open, plain: FourierTrajectory) -> tuple[Rival, ...]:
    """Every member of every ambiguity as truth, against every other one; an alternative has the
    size with which it imitates the accepted effect on `plain`."""
    rows = Rows(found.setting, plain)
    out: list[Rival] = []
    sets: dict[Explanation, list[str]] = {}
    for question in found.questions:
        if question.other:
            sets.setdefault(question.truth, []).append(question.other)
        else:
            out.append(_seen(question, rows))
    for truth, names in sets.items():
        out += _among(truth, names, found.setting.robot, rows)
    return tuple(out)


def _seen(question: Question, rows: Rows) -> Rival:
    """The effect in its most visible coefficient, at a tenth of the torque of the joints it acts on
    or its largest plausible size."""
    effects = question.truth.effects
    columns = rows.columns(effects)
    used = list(effects[0].essential or range(columns.shape[1]))
    best = used[int(rows.beside(columns[:, used]).square().sum(0).argmax())]
    own = columns[:, best].reshape(rows.torque.shape).norm(dim=-1)
    acts = own > 1e-6 * own.max()
    size = effects[0].coefficients[best].largest
    if bool(acts.any()):
        size = min(size, PLAUSIBLE * float(rows.torque[acts].norm() / own[acts].norm()))
    values = [0.0] * columns.shape[1]
    values[best] = size if math.isfinite(size) else 1.0
    return Rival(Explanation(effects, tuple(values)), (), "")


def _among(
    accepted: Explanation, names: Sequence[str], robot: Robot, rows: Rows
) -> Iterator[Rival]:
    leaving = accepted.effects
    members = {accepted.effect.name: accepted}
    for name in names:
        forms = instances(LINK if name in INERTIAL else name, leaving, robot, rows)
        like = imitation(rows, accepted, forms, leaving)
        if like is not None:
            members[name] = like
    for (one, truth), other in product(members.items(), members):
        if one == other or (one in INERTIAL and other in INERTIAL):
            continue
        # A link is blamed for what base parameters could do.
        forms = () if other in INERTIAL else instances(other, truth.effects, robot, rows)
        if forms or other in INERTIAL:
            yield Rival(truth, forms, other, leaving)


def instances(name: str, like: Group, robot: Robot, rows: Rows) -> tuple[Group, ...]:
    """Places and shapes of an effect that act where another does; all of them where that acts on
    several joints."""
    kind, place = KINDS[name], rows.place(like)
    if issubclass(kind, ModelEffect):
        every = tuple(kind.candidates(robot))
        near = [(e,) for e in every if place is None or rows.place((e,)) in (None, place)]
        return (*near, every) if kind.shared else tuple(near)
    assert issubclass(kind, JointEffect)
    names = [s.name for s in kind.shapes]
    return tuple(
        (kind(j, **dict(zip(names, shapes, strict=True))),)
        for j in (range(robot.n) if place is None else (place,))
        for shapes in kind.grid(rows.motions, j, rows.cutoff).tolist()
    )
