"""Is torque logged later, or earlier, than the position it belongs to?"""

from dataclasses import replace

import numpy as np

from torchid.doctor.check import Check, Verdict, fix_text
from torchid.doctor.hypothesis import Hypothesis, Judge
from torchid.doctor.profile import profile
from torchid.doctor.repair import ShiftTorque
from torchid.doctor.search import CLEAR, Search

LATE_S = 0.008
"""Lags that are shorter, or"""
LATE_STEPS = 0.5
"""shorter than this many sampling steps, are not worth mending."""
LIKELY = 0.5 * CLEAR
"""What a lag must be worth when its interval lies beyond those: heavy friction, which no lag of
this size explains away, leaves less to gain. On healthy logs it was 0.12 at most."""
_GRID = (-0.04, -0.02, 0.02, 0.04)


def check_lag(judge: Judge, result: Search) -> Check:
    """Lag of torque behind position [s], with an interval."""
    end = result.final.hypothesis
    reach = judge.samples.reach - 1e-6
    if not judge.live(end):
        return Check("lag", "cannot tell", "nothing moves with a torque")

    def at(late: float) -> Hypothesis:
        return replace(end, late=float(np.clip(late, -reach, reach)))

    step = min(0.01, 0.1 * reach)
    found = profile(judge, at, [end.late + x for x in _GRID], end.late, step)
    searched = [f for f in result.found if f.move.kind == "lag"]
    gain = found.gain + sum(f.gain for f in searched)
    text = (
        f"torque is {1e3 * found.value:.1f} ms late ({1e3 * found.low:.1f} to "
        f"{1e3 * found.high:.1f} ms)"
    )
    least = max(LATE_S, LATE_STEPS * judge.samples.step)
    away = max(found.low, -found.high, 0.0)
    long = abs(found.value) > least and away > 0.0
    half = 0.5 * (found.high - found.low)
    check = Check(
        "lag", "fine", text, estimate=found.value, interval=(found.low, found.high), unit="s"
    )
    clear = long and gain > CLEAR
    likely = away > least and gain > LIKELY
    if (clear or likely) and result.explained:
        repair = ShiftTorque(float(f"{found.value:.4g}"))
        verdict: Verdict = "wrong" if clear else "doubtful"
        return replace(check, verdict=verdict, fix=fix_text((repair,)), repairs=(repair,))
    if half > 0.05 or searched or long or not result.explained:
        return replace(check, verdict="cannot tell")
    return check
