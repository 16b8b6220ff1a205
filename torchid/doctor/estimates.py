"""What torque tells with an interval: where gravity points, and how late torque is logged."""

import math
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
import torch
from msgspec import structs

from torchid.doctor.check import Check, Choice, judged, with_choices, worded_check
from torchid.doctor.cone import fit
from torchid.doctor.faults import choices_of, gravity_fix, improvement_text
from torchid.doctor.hypothesis import Hypothesis, Judge, Profile, lowest, profile
from torchid.doctor.repair import ShiftTorque
from torchid.doctor.runs import PIECES, loss_of, pieces_of_runs
from torchid.doctor.search import Search
from torchid.robot.model import joint_list
from torchid.statistics.criteria import (
    CLEAR_GAIN,
    EXPLAINED,
    LATE_TORQUE_S,
    TIED_GAIN,
    TILT_RAD,
)
from torchid.statistics.jackknife import from_left_out

_LOOSE = math.radians(20.0)
_STEP = math.radians(4.0)
_GRID = (-0.04, -0.02, 0.02, 0.04)
LIKELY = 0.5 * CLEAR_GAIN
"""What a lag must be worth when its interval lies beyond those that are not worth mending: heavy
friction, which no lag of this size explains away, leaves less to gain. On healthy logs it was .3 of
a clear gain at most."""
_SHARES = np.linspace(-0.5, 2.5, 13)
"""Of a lag of all runs, that a run's own may be."""


def check_gravity(judge: Judge, result: Search, fixes: Collection[str] = ()) -> Check:
    """Estimated gravity with an interval of its tilt; the model's if nothing speaks against it."""
    end = result.final.hypothesis
    model = np.array(judge.robot.gravity.tolist())
    size = float(np.linalg.norm(model))
    if size == 0.0 or not judge.live(end):
        return judged("gravity", "cannot tell", "no gravity in the model, or nothing moves")
    turned = [f for f in result.faults if f.move.kind == "gravity"]
    least = min((cost for cost, m in result.costs if m.kind == "gravity"), default=math.inf)
    if least < TIED_GAIN and not turned:
        return judged("gravity", "cannot tell", "another direction of gravity explains it as well")
    estimate, tilt, half, gain = _estimate(judge, end)
    angle = math.acos(float(np.clip(estimate @ model / size**2, -1.0, 1.0)))
    where = "({:.2f}, {:.2f}, {:.2f})".format(*estimate)
    text = (
        f"torque says {where} m/s^2, {math.degrees(angle):.1f} deg from the model's "
        f"(± {math.degrees(half):.1f} deg)"
    )
    verdict, fix, choices = "fine", gravity_fix(estimate), list[Choice]()
    if turned and result.explained:
        verdict = "wrong"
        text = f"mounted {mounting_text(estimate)}: {text}; {improvement_text(turned[0])}"
        choices = choices_of(turned[0])
        choices[0] = structs.replace(choices[0], fix=fix)
    elif half > _LOOSE or not result.explained:
        verdict = "cannot tell"
    elif tilt - half > TILT_RAD and gain > CLEAR_GAIN:
        verdict, choices = "doubtful", [Choice("gravity", fix)]
    interval = math.degrees(max(0.0, angle - half)), math.degrees(angle + half)
    check = worded_check(
        "gravity", verdict, estimate=tuple(estimate.tolist()), interval=interval, text=text
    )
    return with_choices(check, choices, fixes) if choices else check


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
    gravity = np.array(turned(first.value, second.value).gravity)
    return gravity, tilt, half, first.gain + second.gain


def lag_of(judge: Judge, result: Search, *, first: bool = False) -> Profile | None:
    """How late torque is [s] with all else mended, beside friction that builds up over a distance
    after each reversal, which looks as late; None where nothing moves with a torque.

    Args:
        judge: of the log.
        result: of the search for faults.
        first: without an interval where the lag gains too little for any to make it a fault.
    """
    end, reach = result.final.hypothesis, judge.samples.reach - 1e-6
    if not judge.live(end):
        return None
    grid, step = [end.late + x for x in (*_GRID, 0.0)], min(0.01, 0.1 * reach)
    least = LIKELY if first else -math.inf
    return profile(judge.looped, lambda late: _late(judge, end, late), grid, 0.0, step, least)


def _late(judge: Judge, end: Hypothesis, late: float) -> Hypothesis:
    reach = judge.samples.reach - 1e-6
    return replace(end, late=float(np.clip(late, -reach, reach)))


def _lateness(judge: Judge, result: Search, lag: Profile) -> str:
    """`clear`, `likely` (its interval lies beyond what is worth mending), `long` (but nothing bears
    it out), or empty."""
    # 0.5: lags that are shorter than this many sampling steps are not worth mending
    least = max(LATE_TORQUE_S, 0.5 * judge.samples.step)
    away = max(lag.low, -lag.high, 0.0)
    long = abs(lag.value) > least and away > 0.0
    # 0.5: share of a lag that may be left once it is mended: of one less known, or at the end of
    # what is tried, where its interval has no width, nothing is mended
    known = result.explained and away >= 0.5 * abs(lag.value) and lag.low < lag.high
    if known and long and lag.gain > CLEAR_GAIN:
        return "clear"
    if known and away > least and lag.gain > LIKELY:
        return "likely"
    return "long" if long else ""


def check_lag(judge: Judge, result: Search, lag: Profile | None) -> Check:
    """Lag of torque behind position [s], with an interval; it is none where joints or runs differ
    in theirs.

    Args:
        judge: of the log.
        result: of the search for faults.
        lag: as of `lag_of`.
    """
    if lag is None:
        return judged("lag", "cannot tell", "nothing moves with a torque")
    end = result.final.hypothesis
    searched = [f for f in result.faults if f.move.kind == "lag"]
    sign, word = (1e3, "late") if lag.value >= 0.0 else (-1e3, "early")
    text, interval = f"torque is {sign * lag.value:.1f} ms {word}", None
    if math.isfinite(lag.high):
        interval = lag.low, lag.high
        text += " ({:.1f} to {:.1f} ms)".format(*sorted(sign * end for end in interval))
    else:
        text += ", which gains too little for a fault"
    check = worded_check("lag", "fine", estimate=lag.value, interval=interval, text=text)
    late = _lateness(judge, result, lag)
    if late in ("clear", "likely"):
        live = judge.live(end)
        if apart := _shown_by(lag, live) or _lags_apart(judge.looped, end, lag.value):
            evidence = f"{text}; {apart}: a lag would be one time in all of them"
            return structs.replace(check, verdict="cannot tell", evidence=evidence)
        repair = ShiftTorque(float(f"{lag.value:.4g}"))
        # A delay of the arm's own looks the same where bodies explain the torque, or of one joint.
        sure = late == "clear" and any(f.before[live].max() > EXPLAINED for f in searched)
        sure &= len(live) > 1
        return structs.replace(check, verdict="wrong" if sure else "doubtful").mended_by(repair)
    # 0.05: half-width of an interval from which it says nothing of a lag [s]
    loose = interval is not None and 0.5 * (lag.high - lag.low) > 0.05
    if loose or searched or late or not result.explained:
        return structs.replace(check, verdict="cannot tell")
    return check


def _shown_by(lag: Profile, live: Sequence[int]) -> str:
    """The joints that show a lag, in words, where fewer than two of several do, or no more than
    have less than half of it: what one joint has alone is its own; empty otherwise."""
    if len(live) < 2 or lag.own is None:
        return ""
    sign = math.copysign(1.0, lag.value)
    ends = np.sort(sign * lag.own[live, 1:], 1)
    less = [k for k, (_, high) in zip(live, ends, strict=True) if high < 0.5 * abs(lag.value)]
    shows = [k for k, (low, _) in zip(live, ends, strict=True) if low > 0]
    if len(shows) > max(1, len(less)):
        return ""
    most = f"it shows in {joint_list(shows)} alone" if shows else "no joint shows it by itself"
    return most + (f", and less than half of it in {joint_list(less)}" if less else "")


def _lags_apart(judge: Judge, end: Hypothesis, late: float) -> str:
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
        normal = judge.normal(_late(judge, end, lag), pieces)
        x = fit(normal, judge.cone).x
        losses.append([[loss_of(normal, left, x) for left in own] for own in some])
    own = []
    for run, each in zip(runs, np.array(losses).transpose(1, 2, 0), strict=True):
        best, *without = (lowest(lags, x.tolist()) for x in each)
        left_out = torch.tensor(without, dtype=torch.float64).unsqueeze(1)
        ends = from_left_out(left_out).interval(left_out.new_tensor([best]))[0].tolist()
        own.append((best, *ends, judge.samples.log.names[run]))
    (least, _, below, first), (most, above, _, last) = min(own), max(own)
    if below >= above or most - least < 0.5 * abs(late):
        return ""
    return f"{1e3 * least:.1f} ms in {first} and {1e3 * most:.1f} ms in {last}"
