"""Uneven time stamps: real, or rounded and given late?"""

import numpy as np

from torchid.doctor.check import Check
from torchid.doctor.retime import EvenTime
from torchid.log.model import Log
from torchid.log.sampling import SMALL_GAP, time_steps

SMOOTHER = 3.0
"""Stamps are taken for wrong when positions are this many times smoother over even ones."""
UNEVEN = 0.1
"""Steps that spread by less than this share of the median are even."""


def check_stamps(log: Log) -> Check:
    """Are uneven stamps real? Positions are smooth over the time at which they were taken."""
    steps = time_steps(log)
    text = "; ".join(dict.fromkeys(str(s) for s in steps[:3]))
    worst, share = 0.0, 0.0
    for part in log.trajectories():
        t = part.t.numpy()
        step = np.diff(t)
        inner = step[step < SMALL_GAP * np.median(step)]
        share = max(share, float(inner.std() / np.median(step)) if len(inner) else 0.0)
        worst = max(worst, _roughness_ratio(t, part.q.numpy()))
    if share < UNEVEN or worst < SMOOTHER:
        return Check("stamps", "fine", text, estimate=share)
    repair = EvenTime()
    return Check(
        "stamps",
        "wrong",
        f"steps spread by {100 * share:.0f} % of the median, and positions are {worst:.3g} times "
        f"smoother over even stamps: the stamps are rounded or were given late ({text})",
        estimate=worst,
        unit="ratio",
        fix=str(repair),
        repairs=(repair,),
    )


def _roughness_ratio(t: np.ndarray, q: np.ndarray) -> float:
    """How badly a cubic through four neighbours predicts a position, over the given stamps and
    over even ones: their ratio, the median over joints."""
    if len(t) < 50:
        return 1.0
    step = np.diff(t)
    windows = np.lib.stride_tricks.sliding_window_view(step, 4)
    clean = (windows < SMALL_GAP * np.median(step)).all(1)
    even = np.arange(len(t), dtype=float)
    ends = np.ptp(q, 0)
    moving = ends > 0.1 * ends.max()
    if not moving.any() or clean.sum() < 20:
        return 1.0
    errors = [_cubic_error(x, q[:, moving])[clean] for x in (t, even)]
    rms = [np.sqrt((e**2).mean(0)) for e in errors]
    return float(np.median(rms[0] / np.maximum(rms[1], 1e-12)))


def _cubic_error(t: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Each position minus the cubic through its two neighbours on either side (Lagrange)."""
    offsets = (0, 1, 3, 4)
    middle = t[2:-2]
    nodes = [t[k : len(t) - 4 + k] for k in offsets]
    error = q[2:-2].copy()
    for a, k in enumerate(offsets):
        weight = np.ones_like(middle)
        for b in range(4):
            if b != a:
                weight *= (middle - nodes[b]) / (nodes[a] - nodes[b])
        error -= weight[:, None] * q[k : len(t) - 4 + k]
    return error
