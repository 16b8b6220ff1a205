"""What an engineer sees of a channel at a look, without a robot: values that no sensor gives."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import torch

from torchid.log.checks import NO_TORQUE
from torchid.log.columns import PREFIXES
from torchid.log.model import Log
from torchid.log.movement import MOVING
from torchid.typing import Float, Tensor

COUNTS = 200.0
"""Size of whole numbers from which they are counts, or a drive's per mille [1]."""
EFFORTS = ("tau", "current")


@dataclass(frozen=True)
class OddChannel:
    """Columns of a signal that look wrong by themselves.

    Attributes:
        signal: of the log.
        joints: from 0.
        why: in a few words.
    """

    signal: str
    joints: tuple[int, ...]
    why: str

    def __str__(self) -> str:
        names = (f"{PREFIXES[self.signal]}{k + 1}" for k in self.joints)
        return f"{', '.join(names)}: {self.why}"


def odd_channels(log: Log, effort: Float[Tensor, " n"] | None = None) -> list[OddChannel]:
    """Torques and currents that look wrong by themselves.

    Args:
        log: as it was read.
        effort: largest torque of each joint [N m; N]; not finite, or zero, where unknown.
    """
    out = []
    for signal in EFFORTS:
        x = log.signals.get(signal)
        if x is None:
            continue
        x = x.nan_to_num()
        moves = (log.q.amax(0) - log.q.amin(0)).nan_to_num() > MOVING
        live = ((x.amax(0) - x.amin(0)) > NO_TORQUE) & moves
        most, doubts = x.abs().amax(0), list[tuple[Tensor, str]]()
        if bool(live.sum() > 1):
            doubts.append((_unsigned(log, x, live), "no value is negative: sizes without a sign?"))
        whole = live & (x == x.round()).all(0) & (most > COUNTS)
        doubts.append((whole, "whole numbers: counts, or per mille of a rating?"))
        if signal == "current":
            text = f"up to {float(most.max()):.4g} A: milliamperes?"
            # 100.0: largest current of an arm's motor [A]: beyond are milliamperes
            doubts.append((most > 100.0, text))
        elif effort is not None:
            known = effort.isfinite() & (effort > 0)
            ratio = torch.where(known, most / effort, 0.0)
            text = f"up to {float(ratio.max()):.3g} times the joint's limit"
            # 2.0: torque over the joint's limit from which it is not its own: peaks are above a
            # rating
            doubts.append((ratio > 2.0, text))
        out += [
            OddChannel(signal, tuple(odd.nonzero().flatten().tolist()), why)
            for odd, why in doubts
            if bool(odd.any())
        ]
        out += _copied_runs(log, signal, x, live)
    return out


def _unsigned(log: Log, x: Tensor, live: Tensor) -> Tensor:
    """Joints (n,) whose torque is never negative though they turn round again and again, where this
    is so of all that move: one alone may hold a weight."""
    turns = torch.zeros_like(live, dtype=torch.long)
    for rows in log.slices():
        # Steps at rest, or of a coarse encoder, are no direction.
        step = log.q[rows].nan_to_num().diff(dim=0)
        large = step.abs() > step.abs().amax(0) * 0.1
        for j in range(log.n):
            signs = step[large[:, j], j].sign()
            turns[j] += int((signs.diff() != 0).sum())
    never = (x.amin(0) >= 0) & live
    # 4: times that a joint turns round from which its friction has had both signs
    every = bool((never | ~live).all()) and bool((turns[live] >= 4).all())
    return never if every else torch.zeros_like(never)


def _copied_runs(log: Log, signal: str, x: Tensor, live: Tensor) -> Iterator[OddChannel]:
    """Runs of different motion that hold one and the same torque, value by value."""
    runs = list(zip(log.names, log.slices(), strict=True))
    for (one, a), (two, b) in itertools.combinations(runs, 2):
        count = min(a.stop - a.start, b.stop - b.start)
        same = (x[a][:count] == x[b][:count]).all(0) & live
        moved = (log.q[a][:count] - log.q[b][:count]).nan_to_num().abs().amax(0) > MOVING
        if bool((same & moved).any()):
            joints = tuple((same & moved).nonzero().flatten().tolist())
            yield OddChannel(signal, joints, f"the same values in '{one}' and '{two}'")
            return
