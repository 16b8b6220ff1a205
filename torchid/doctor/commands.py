"""Commands: how late each joint follows, how far it stays away, and what unit a channel is in."""

import math

import numpy as np
import torch

from torchid.doctor.check import Check
from torchid.doctor.repair import Scale
from torchid.log.checks import own_units
from torchid.log.model import Log
from torchid.robot.model import joint_list

LATEST_S = 0.5
"""Longest lag that is looked for [s]."""
EVEN = 0.1
"""A joint whose motion per command differs from 1 by more is in another unit, or held back [1]."""
MOVES = 0.02
"""A command that varies by less moves nothing [rad or m]."""


def check_commands(log: Log) -> Check:
    """Lag of every joint behind its command, and how much of the command it makes."""
    assert log.u is not None
    step = float(torch.cat([log.t[rows].diff() for rows in log.slices()]).median())
    joints = [k for k in range(log.n) if float(log.u[:, k].max() - log.u[:, k].min()) > MOVES]
    if not joints or not step > 0:
        return Check("commands", "cannot tell", "no command moves a joint")
    lags, gains = zip(*(_follow(log, k, step) for k in joints), strict=True)
    said = ", ".join(
        f"joint {k + 1} {1e3 * lag:.0f} ms" for k, lag in zip(joints, lags, strict=True)
    )
    odd = [k for k, g in zip(joints, gains, strict=True) if abs(g - 1) > EVEN]
    evidence = f"positions follow the commands late by {said}"
    if odd:
        shares = ", ".join(f"{g:.2f}" for k, g in zip(joints, gains, strict=True) if k in odd)
        make = f"makes {shares} of its" if len(odd) == 1 else f"make {shares} of their"
        evidence += f"; {joint_list(odd)} {make} command"
    return Check(
        "commands",
        "doubtful" if odd else "fine",
        evidence,
        joints=tuple(joints),
        estimate=lags,
        unit="s",
        fix="u and q may be in different units, or the joint is held back: look at it"
        if odd
        else None,
    )


def _follow(log: Log, k: int, step: float) -> tuple[float, float]:
    """The delay at which the command fits a joint best, and the slope there, within motions."""
    best = math.inf, 0.0, 0.0
    for shift in range(round(LATEST_S / step) + 1):
        us, qs = [], []
        for rows in log.slices():
            u, q = log.u[rows, k].numpy(), log.q[rows, k].numpy()  # type: ignore[index]
            if len(u) > shift + 1:
                us.append(u[: len(u) - shift] - u.mean())
                qs.append(q[shift:] - q.mean())
        u, q = np.concatenate(us), np.concatenate(qs)
        slope = float(u @ q) / max(float(u @ u), 1e-300)
        left = float(np.square(q - slope * u).mean())
        if left < best[0]:
            best = left, shift * step, slope
    return best[1], best[2]


def check_channel_units(log: Log) -> Check:
    """Positions whose measured velocities are in another unit: a fraction of a range."""
    if log.dq is None:
        return Check("channel units", "cannot tell", "no velocity is measured to compare with")
    odd = own_units(log)
    if not odd:
        return Check("channel units", "fine", "no q and u are in a unit of their own")
    said = ", ".join(
        f"dq{k + 1} is {factor:.3g} times the rate of q{k + 1}" for k, factor in odd.items()
    )
    return Check(
        "channel units",
        "doubtful",
        f"{said}: that joint's q and u are in another unit, such as a fraction of its range",
        joints=tuple(odd),
        estimate=tuple(odd.values()),
        unit="1",
    ).mended_by(Scale(("q", "u"), tuple(odd.get(k, 1.0) for k in range(log.n))))
