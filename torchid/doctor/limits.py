"""What acts only beyond a limit, and so shows before any fit of parameters: a joint's stop, a plane
that the tool meets, a knee above which the log says more torque than acts.

Bodies and friction act everywhere. Such a law acts at one end of a joint's travel, of the tool's
travel or of the torque alone, so that bodies cannot take its part.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.linalg import block_diag

from torchid.doctor.check import Check
from torchid.doctor.cone import Normal, fit
from torchid.doctor.hypothesis import Hypothesis, Judge, errors_left_out
from torchid.doctor.samples import BLOCKS
from torchid.doctor.search import AGREE, CLEAR, rms
from torchid.effects.base import Effect
from torchid.effects.motion import Motion
from torchid.effects.surroundings import EndStop, PlaneContact
from torchid.effects.transient import DriveSaturation
from torchid.robot.model import JointType, joint_list

SOME_BLOCKS = 3
"""Blocks of time in which a law must act: what comes once is an event, and no law."""


@dataclass(frozen=True)
class _Law:
    """An effect at one place.

    Attributes:
        effect: with its shape.
        column: (T, n) torque per unit of its first coefficient.
        beside: (T, n) of friction that grows with load, which more torque at high torque must not
            be: one for the effect's joint, none where all joints feel it.
        acts: (B,) the blocks of time in which it acts.
        gain: by how much the sum of log errors falls if the bodies stay as they are.
    """

    effect: Effect
    column: np.ndarray
    beside: tuple[np.ndarray, ...]
    acts: np.ndarray
    gain: float


def check_limits(judge: Judge, now: Hypothesis) -> list[Check]:
    """A check of the law that explains most of what bodies and friction leave, if one does so
    clearly, on held-out blocks of time; else none."""
    live = judge.live(now)
    if not live:
        return []
    # The law of each kind that what is left asks for most is fitted together with the bodies.
    best: dict[str, _Law] = {}
    for law in _laws(judge, now, live):
        name = law.effect.name
        if law.gain > (best[name].gain if name in best else CLEAR / BLOCKS):
            best[name] = law
    if not best:
        return []
    checks = [_judged(judge, now, law) for law in best.values()]
    clear = [x for x in checks if x is not None]
    return [min(clear, key=lambda x: x[0])[1]] if clear else []


def _laws(judge: Judge, now: Hypothesis, live: list[int]) -> Iterator[_Law]:
    """Laws at every place of their grids that act in several blocks of the log."""
    robot, bodies = judge.robot, judge.score(now).fit
    q, dq, ddq, sign = judge.motion(now).unbind(-1)
    torque = judge.columns(now)[0] @ bodies.x
    motion = Motion(q, dq, ddq, direction=sign, torque=torch.from_numpy(torque))
    effects: list[Effect] = []
    for j in live:
        effects += [EndStop(j, *row) for row in EndStop.grid([motion], j, np.inf).tolist()]
        largest = float(np.abs(torque[:, j]).max())
        effects += [DriveSaturation(j, largest * x) for x in DriveSaturation.shapes[0].grid]
    effects += PlaneContact.near_ends(robot, [motion])
    counted = judge.moving(now) & np.isin(np.arange(robot.n), live)
    left = (judge.torque(now) - torque) * counted
    weight = np.where(bodies.variance > 0, 1.0 / np.maximum(bodies.variance, 1e-300), 0.0)
    loaded = np.abs(torque) * sign.numpy() * counted
    before = (left**2).sum(0)
    some = before > 0
    for effect in effects:
        column = effect.torque_columns(motion, robot)[..., 0].numpy() * counted
        acts = np.array([column[m].any() for m in judge.members])
        if acts.sum() < SOME_BLOCKS:
            continue
        size = ((column * left).sum(0) @ weight) / ((column**2).sum(0) @ weight)
        after = ((left - max(0.0, size) * column) ** 2).sum(0)
        gain = 0.5 * np.log(before[some] / np.maximum(after[some], 1e-300)).sum()
        beside = tuple(loaded * (np.arange(robot.n) == j) for j in effect.joints)
        yield _Law(effect, column, beside, acts, float(gain))


def _judged(judge: Judge, now: Hypothesis, law: _Law) -> tuple[float, Check] | None:
    """The sum of held-out log errors with a law, and what the doctor says of it; None where the
    blocks in which it acts do not clearly want it."""
    without = errors_left_out(*_with(judge, now, law.beside))
    normal, bodies = _with(judge, now, (*law.beside, law.column))
    with_it = errors_left_out(normal, bodies)
    before, after = without[law.acts], with_it[law.acts]
    # Joints on which the law does not act are of no account.
    on = law.column.any(0)
    gains = np.nansum(np.log(before[:, on]) - np.log(after[:, on]), 1)
    agreeing = int((gains > 0).sum())
    if agreeing < AGREE * len(gains) or gains.mean() < CLEAR:
        return None
    size = float(fit(normal, bodies).x[-1])
    felt = [j for j in np.flatnonzero(on) if np.nanmedian(before[:, j] / after[:, j]) > 1.05]
    joints = tuple(int(j) for j in (felt or np.flatnonzero(on)))
    said = ", ".join(
        f"joint {j + 1} {100 * np.nanmedian(before[:, j]):.2g} % -> "
        f"{100 * np.nanmedian(after[:, j]):.2g} %"
        for j in joints
    )
    sliding = [judge.robot.joint_types[j] is JointType.PRISMATIC for j in law.effect.joints]
    unit = law.effect.coefficients[0].unit_for(any(sliding))
    place = _place(law.effect, size, unit)
    text = f"{place}: error {said}, better in {agreeing} of {len(gains)} blocks"
    check = Check(
        "limits",
        "doubtful",
        text,
        joints=joints,
        estimate=size,
        unit=unit,
        fix=f"{law.effect.experiment}; else add it to the robot's effects ({law.effect.name})",
    )
    return float(np.log(rms(with_it)).sum()), check


def _with(
    judge: Judge, now: Hypothesis, columns: Sequence[np.ndarray]
) -> tuple[Normal, np.ndarray]:
    """Normal equations and cone with more columns (T, n), each with a coefficient of zero or
    more."""
    normal, (a, _) = judge.normal(now), judge.columns(now)
    tau = judge.torque(now) * judge.moving(now)
    more = np.stack([np.zeros_like(tau), *columns], -1)[..., 1:]
    blocks, n, own, count = *normal.cross.shape, len(columns)
    gram = np.zeros((blocks, n, own + count, own + count))
    cross = np.zeros((blocks, n, own + count))
    gram[..., :own, :own], cross[..., :own] = normal.gram, normal.cross
    for b, m in enumerate(judge.members):
        beside = np.einsum("tnp,tnc->npc", a[m], more[m], optimize=True)
        gram[b, :, :own, own:], gram[b, :, own:, :own] = beside, beside.swapaxes(1, 2)
        gram[b, :, own:, own:] = np.einsum("tnc,tnd->ncd", more[m], more[m])
        cross[b, :, own:] = np.einsum("tnc,tn->nc", more[m], tau[m])
    return replace(normal, gram=gram, cross=cross), block_diag(judge.cone, np.eye(count))


def _place(effect: Effect, size: float, unit: str) -> str:
    """The law in words, with its place and size in this unit."""
    if isinstance(effect, EndStop):
        side = "above" if effect.towards > 0 else "below"
        return (
            f"torque of {joint_list((effect.joint,))} rises {side} {effect.limit:.4g} by "
            f"{size:.3g} {unit}, as at a stop"
        )
    if isinstance(effect, PlaneContact):
        return (
            f"torque rises where the tool is beyond {effect.side[1]} = {effect.height:.3g} m, by "
            f"{size:.3g} {unit}, as at a plane"
        )
    assert isinstance(effect, DriveSaturation)
    return (
        f"above {effect.limit:.3g} the torque of {joint_list((effect.joint,))} is "
        f"{100 * size:.2g} % more than bodies and friction need, as if the drive saturated"
    )
