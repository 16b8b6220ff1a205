"""What torque tells with an interval: where gravity points, and how late torque is logged."""

import math
from collections.abc import Callable, Collection
from dataclasses import replace

import numpy as np
import torch
from msgspec import structs

from torchid.doctor.check import Check, judged, said, with_choices
from torchid.doctor.cone import OWN, fit
from torchid.doctor.faults import choices_of, gravity_fix, improvement_text
from torchid.doctor.hypothesis import Hypothesis, Judge, lowest, minimum, profile
from torchid.doctor.repair import ShiftTorque
from torchid.doctor.runs import PIECES, loss_of, pieces_of_runs
from torchid.doctor.search import CLEAR, EXPLAINED, TIE, Search
from torchid.log.model import Log
from torchid.robot.model import joint_list
from torchid.statistics.jackknife import from_left_out

TILT = math.radians(5.0)
"""Tilts below this are within what a floor, a flange and a model of the friction make."""
_LOOSE = math.radians(20.0)
_STEP = math.radians(4.0)
LATE_S = 0.008
"""Lags that are shorter, or"""
LATE_STEPS = 0.5
"""shorter than this many sampling steps, are not worth mending."""
LIKELY = 0.5 * CLEAR
"""What a lag must be worth when its interval lies beyond those: heavy friction, which no lag of
this size explains away, leaves less to gain. On healthy logs it was 0.12 at most."""
_LOOPS = tuple(math.log(0.03 * 2**k) for k in range(6))
"""Logarithms of the shares of half a joint's range that are tried for a loop over position."""
_GRID = (-0.04, -0.02, 0.02, 0.04)
_SHARES = np.linspace(-0.5, 2.5, 13)
"""Of a lag of all runs, that a run's own may be."""


def check_gravity(judge: Judge, result: Search, fixes: Collection[str] = ()) -> Check:
    """Estimated gravity with an interval of its tilt; the model's if nothing speaks against it."""
    end = result.final.hypothesis
    model = np.array(judge.robot.gravity.tolist())
    size = float(np.linalg.norm(model))
    flat = [cost for cost, m in result.costs if m.kind == "gravity"]
    if size == 0.0 or not judge.live(end):
        return judged("gravity", "cannot tell", "no gravity in the model, or nothing moves")
    turned = [f for f in result.found if f.move.kind == "gravity"]
    if flat and min(flat) < TIE and not turned:
        return judged("gravity", "cannot tell", "another direction of gravity explains it as well")
    estimate, tilt, half, gain = _estimate(judge, end)
    angle = math.acos(float(np.clip(estimate @ model / size**2, -1.0, 1.0)))
    where = "({:.2f}, {:.2f}, {:.2f})".format(*estimate)
    text = (
        f"torque says {where} m/s^2, {math.degrees(angle):.1f} deg from the model's "
        f"(± {math.degrees(half):.1f} deg)"
    )
    interval = math.degrees(max(0.0, angle - half)), math.degrees(angle + half)
    known = {"estimate": tuple(estimate.tolist()), "interval": interval}
    base = said("gravity", "fine", text=text, **known)
    fix = gravity_fix(estimate)
    if turned and result.explained:
        text = f"mounted {mounting_text(estimate)}: {text}; {improvement_text(turned[0])}"
        first, *others = choices_of(turned[0])
        own = structs.replace(first, fix=fix)
        return with_choices(
            structs.replace(base, verdict="wrong", evidence=text), [own, *others], fixes
        )
    if half > _LOOSE or not result.explained:
        return structs.replace(base, verdict="cannot tell")
    if tilt - half > TILT and gain > CLEAR:
        return structs.replace(base, verdict="doubtful", fix=fix)
    return base


def mounting_text(gravity: np.ndarray) -> str:
    """Floor, ceiling or wall, of the base frame's nearest axis."""
    axis = int(np.argmax(np.abs(gravity)))
    if axis == 2:
        return "on the floor" if gravity[2] < 0 else "on the ceiling"
    return f"on a wall, {'-' if gravity[axis] < 0 else '+'}{'xy'[axis]} down"


def _estimate(judge: Judge, end: Hypothesis) -> tuple[np.ndarray, float, float, float]:
    """Gravity (3,), its tilt from the hypothesis's, the 95 % half-width [rad], and by how much
    the loss falls; two turns, one after the other."""
    down = np.array(end.gravity)
    size = float(np.linalg.norm(down))
    down = down / size
    across = np.linalg.svd(down[None])[2][1:]

    def turned(x: float, y: float) -> Hypothesis:
        axis = x * across[0] + y * across[1]
        angle = float(np.linalg.norm(axis))
        if angle == 0.0:
            return end
        vector = math.cos(angle) * down + math.sin(angle) * axis / angle
        return replace(end, gravity=tuple((size * vector).tolist()))

    first = profile(judge, lambda x: turned(x, 0.0), (), 0.0, _STEP)
    second = profile(judge, lambda y: turned(first.value, y), (), 0.0, _STEP)
    half = math.hypot(0.5 * (first.high - first.low), 0.5 * (second.high - second.low))
    tilt = math.hypot(first.value, second.value)
    found = np.array(turned(first.value, second.value).gravity)
    return found, tilt, half, first.gain + second.gain


def looped(judge: Judge, result: Search) -> Judge | None:
    """A judge with a loop over position in the place of dry friction that steps, where a log's
    torque looks late and this explains it better: a lag is one time at all speeds and amplitudes,
    a loop is one distance. None where the torque is late, or nothing is."""
    lag, end = check_lag(judge, result, by_run=False), result.final.hypothesis
    if lag.verdict not in ("wrong", "doubtful") or not isinstance(lag.estimate, float):
        return None
    late = judge.score(replace(end, late=lag.estimate)).loss
    starts = {Hypothesis.literal(judge.robot), replace(end, late=0.0)}
    found: list[tuple[float, float]] = []
    for sign in (1.0, -1.0):

        def loss(share: float, sign: float = sign) -> float:
            loop = Judge(judge.robot, judge.samples.looped(sign * math.exp(share)))
            found.append((min(loop.score(start).loss for start in starts), loop.samples.loop))
            return found[-1][0]

        minimum(loss, _LOOPS, 0.2)
    least, share = min(found)
    return Judge(judge.robot, judge.samples.looped(share)) if least < late else None


def check_lag(judge: Judge, result: Search, *, by_run: bool = True) -> Check:
    """Lag of torque behind position [s], with an interval; it is none where runs differ in theirs.

    Args:
        judge: of the log.
        result: of the search for faults.
        by_run: whether each run's own is looked at.
    """
    end = result.final.hypothesis
    reach = judge.samples.reach - 1e-6
    if not judge.live(end):
        return judged("lag", "cannot tell", "nothing moves with a torque")

    def at(late: float) -> Hypothesis:
        return replace(end, late=float(np.clip(late, -reach, reach)))

    step = min(0.01, 0.1 * reach)
    found = profile(judge, at, [end.late + x for x in _GRID], end.late, step)
    searched = [f for f in result.found if f.move.kind == "lag"]
    gain = found.gain + sum(f.gain for f in searched)
    text = (
        f"torque is {1e3 * found.value:.1f} ms late ({1e3 * found.low:.1f} to "
        f"{1e3 * found.high:.1f} ms)"
        + ("; a loop over position explains more than a lag" if judge.samples.loop else "")
    )
    least = max(LATE_S, LATE_STEPS * judge.samples.step)
    away = max(found.low, -found.high, 0.0)
    long = abs(found.value) > least and away > 0.0
    half = 0.5 * (found.high - found.low)
    interval = found.low, found.high
    check = said("lag", "fine", estimate=found.value, interval=interval, text=text)
    clear = long and gain > CLEAR
    likely = away > least and gain > LIKELY
    if (clear or likely) and result.explained:
        if by_run and (apart := _lags_apart(judge, at, found.value)):
            evidence = f"{text}; {apart}: a lag would be one time in all of them"
            return structs.replace(check, verdict="cannot tell", evidence=evidence)
        repair = ShiftTorque(float(f"{found.value:.4g}"))
        # A delay, gears or friction of the arm's own look the same where bodies explain the torque.
        live = judge.live(end)
        sure = clear and any(f.before[live].max() > EXPLAINED for f in searched)
        return structs.replace(check, verdict="wrong" if sure else "doubtful").mended_by(repair)
    if half > 0.05 or searched or long or not result.explained:
        return structs.replace(check, verdict="cannot tell")
    return check


def _lags_apart(judge: Judge, at: Callable[[float], Hypothesis], late: float) -> str:
    """The runs whose own lags are farthest apart, in words; empty where they may be the lag of all
    [s], or differ by less than half of it. Bodies are those of all runs at each lag."""
    runs, pieces = pieces_of_runs(judge)
    if len(runs) < 2:
        return ""
    lags = (late * _SHARES).tolist()
    parts = np.arange(PIECES * len(runs)).reshape(-1, PIECES)
    # Of each run all pieces, then all but one after the other.
    some = [[own, *(np.delete(own, k) for k in range(PIECES))] for own in parts]
    losses = []
    for lag in lags:
        normal = judge.normal(at(lag), pieces)
        x = fit(normal, judge.cone).x
        losses.append([[loss_of(normal, left, x) for left in own] for own in some])
    own = []
    for run, each in zip(runs, np.array(losses).transpose(1, 2, 0), strict=True):
        best, *without = (lowest(lags, x.tolist()) for x in each)
        left_out = torch.tensor(without, dtype=torch.float64).unsqueeze(1)
        ends = from_left_out(left_out).interval(left_out.new_tensor([best]))[0].tolist()
        own.append((best, *ends, judge.samples.names[run]))
    (least, _, below, first), (most, above, _, last) = min(own), max(own)
    if below >= above or most - least < 0.5 * abs(late):
        return ""
    return f"{1e3 * least:.1f} ms in {first} and {1e3 * most:.1f} ms in {last}"


CONDITION = 300.0
"""Of a joint's own columns, each scaled to one, from which they cannot be told apart."""
SMALL = 0.1
"""Range of a position that excites too little [rad or m]."""


def check_excitation(judge: Judge, hypothesis: Hypothesis, log: Log) -> Check:
    """Condition of each joint's own columns: speed, direction, acceleration, offset, gravity."""
    live = judge.live(hypothesis)
    extent = (log.q.amax(0) - log.q.amin(0)).tolist()
    conditions = {k: _condition(judge, hypothesis, k) for k in live}
    # In a log of small motions by the farthest joint: how it moves is asked of the condition.
    small = SMALL * min(1.0, max(extent))
    weak = [k for k in range(judge.robot.n) if k not in live or extent[k] < small]
    alike = [k for k, c in conditions.items() if c > CONDITION and k not in weak]
    worst = max(conditions.values(), default=np.inf)
    if not weak and not alike:
        return said("excitation", "fine", estimate=worst, worst=worst, least=min(extent))
    words = []
    if weak:
        words.append(
            f"{joint_list(weak)} hardly move"
            + ("s" if len(weak) == 1 else "")
            + " ("
            + ", ".join(f"{extent[k]:.2g}" for k in weak)
            + " rad or m, or never with a varying torque)"
        )
    if alike:
        words.append(
            f"speed, direction, acceleration and gravity of {joint_list(alike)} vary together "
            "(condition " + ", ".join(f"{conditions[k]:.3g}" for k in alike) + ")"
        )
    joints = tuple(sorted({*weak, *alike}))
    estimate = tuple(conditions.get(k, float("inf")) for k in joints)
    text = "; ".join(words)
    return said("excitation", "doubtful", joints=joints, estimate=estimate, text=text)


def _condition(judge: Judge, hypothesis: Hypothesis, joint: int) -> float:
    """Of dq, direction, ddq and one in the joint's own torque."""
    n = judge.robot.n
    own = np.arange(OWN) + 10 * n + OWN * joint
    gram = judge.normal(hypothesis).gram.sum(0)[joint][np.ix_(own, own)]
    size = np.sqrt(np.diagonal(gram))
    if (size == 0).any():
        return float("inf")
    values = np.linalg.eigvalsh(gram / np.outer(size, size))
    return float(np.sqrt(values[-1] / max(values[0], 1e-300)))
