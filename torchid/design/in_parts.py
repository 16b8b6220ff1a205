"""The filtered motion of a trajectory, made of its log a part at a time.

A long log is then in memory once: its filtered positions, velocities and accelerations would be
three times as much again. Parts are filtered with the filter's tail on both sides, so that they
agree with the whole to the 1e-8 that the tail leaves out.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import torch

from torchid.effects.motion import Motion
from torchid.log.filtering import ZeroPhaseFilter, central_difference, extended
from torchid.log.filtering import low_pass as filter_of
from torchid.log.model import Log
from torchid.typing import Float, Int, Tensor

PART = 1_000_000
"""Values of a signal, samples times joints, in a part."""

KEPT = 2
"""Parts that are kept: who goes through a trajectory in order needs one, and at a border two."""

WIDE = 5.0
"""The direction of motion is taken from velocity filtered at this multiple of the cut-off, so that
a reversal stays sharp until the common filter smooths it like the torque."""


_REACH = 4
"""Samples on both sides that two central differences see."""


@dataclass(frozen=True, eq=False)
class MotionInParts:
    """What `Motion` is, for those who ask for a part.

    Attributes:
        log: one trajectory on a uniform grid.
        rate: its sampling rate [Hz].
        cutoff: [Hz], or None for no filter.
        threshold: (n,) speed a joint must reach before its direction counts as reversed.
        own_velocity, own_acceleration: whether they are the log's, else differentiated.
        t, torque: as in `Motion`.
    """

    log: Log
    rate: float
    cutoff: float | None
    threshold: Float[Tensor, " n"]
    own_velocity: bool
    own_acceleration: bool
    t: Tensor | None = None
    torque: Tensor | None = None
    _made: dict[str, Any] = field(default_factory=dict)

    def part(self, rows: slice) -> Motion:
        """The motion at some of the instants."""
        whole = (self._direction(self._length), self.t, self.torque)
        sign, t, torque = (None if x is None else x[rows] for x in whole)
        return self.undirected(rows)._replace(direction=sign, t=t, torque=torque)

    def undirected(self, rows: slice) -> Motion:
        """The motion without direction, t and torque; a direction takes going through all of it."""
        wanted = range(self.log.samples)[rows]
        size = self._length
        found = []
        for k in range(wanted.start // size, -(-wanted.stop // size)) if len(wanted) else ():
            first = max(0, -(-(k * size - wanted.start) // wanted.step))
            here = wanted[first : max(first, -(-((k + 1) * size - wanted.start) // wanted.step))]
            if len(here):
                own = slice(here.start - k * size, here.stop - k * size, here.step)
                found.append(self._filtered(k).part(own))
        return found[0] if len(found) == 1 else _joined(found, self._filtered(0))

    def whole(self) -> Motion:
        """The whole motion, filtered at once."""
        samples = self.log.samples
        return self._made_of(0, samples)._replace(
            direction=self._direction(samples), t=self.t, torque=self.torque
        )

    def every(self, step: int) -> Motion:
        """The motion at every so many instants."""
        return self.part(slice(None, None, step))

    def require(self, what: str, effect: str) -> Tensor:
        """A signal that must be there, as of `Motion`."""
        value: Tensor | None = getattr(self, what)
        if value is None:
            raise ValueError(f"{effect} needs the motion's {what}.")
        return value

    def _replace(self, **known: Tensor | None) -> "MotionInParts":
        """The motion with other times or torques."""
        return replace(self, **known)  # type: ignore[arg-type]

    @property
    def _length(self) -> int:
        """Samples of a part: many more than what is filtered beside it."""
        tail = 0 if self.cutoff is None else ZeroPhaseFilter(self.rate, self.cutoff).tail
        return max(4 * tail, PART // self.log.n)

    def _filtered(self, k: int) -> Motion:
        """q, dq, ddq and lag of the k-th part."""
        kept: dict[int, Motion] = self._made.setdefault("parts", {})
        if k not in kept:
            while len(kept) >= KEPT:
                del kept[next(iter(kept))]
            size = self._length
            kept[k] = self._made_of(k * size, min((k + 1) * size, self.log.samples))
        return kept[k]

    def _made_of(self, start: int, stop: int) -> Motion:
        """q, dq, ddq and lag from one sample to another."""
        chosen = None if self.cutoff is None else filter_of(self.rate, self.cutoff)
        here = _Reach.of(start, stop, self.log.samples, chosen)
        signals = [*self._unfiltered(here.lo, here.hi)]
        if self.log.ql is not None:
            rows = slice(here.lo, here.hi)
            signals.append((self.log.q[rows] - self.log.ql[rows]).T)
        q, dq, ddq, *lag = (here.through(x, chosen).contiguous().T for x in signals)
        return Motion(q, dq, ddq, lag=lag[0] if lag else None)

    def _unfiltered(self, lo: int, hi: int) -> tuple[Tensor, Tensor, Tensor]:
        """q, dq and ddq (n, hi - lo)."""
        log, a, b = self.log, max(0, lo - _REACH), min(self.log.samples, hi + _REACH)
        q = log.q[a:b].T
        own = self.own_velocity and log.dq is not None
        dq = log.dq[a:b].T if own else central_difference(q, self.rate)  # type: ignore[index]
        if self.own_acceleration and log.ddq is not None:
            ddq = log.ddq[a:b].T
        else:
            ddq = central_difference(dq, self.rate)
        inside = slice(lo - a, hi - a)
        return q[:, inside], dq[:, inside], ddq[:, inside]

    def _direction(self, size: int) -> Int[Tensor, "T n"] | None:
        """Direction of motion (T, n) at all instants, -1, 0 or 1, made joint by joint: it depends
        on all that was before.

        Args:
            size: samples filtered at a time.
        """
        # Without a filter and a reversal speed the log is taken at its word, rest included.
        if self.cutoff is None and not bool(self.threshold.any()):
            return None
        if "direction" not in self._made:
            limits = self.threshold.to(self.log.q).unbind()
            columns = [held_sign(self._sharp(j, size), limit) for j, limit in enumerate(limits)]
            self._made["direction"] = torch.stack(columns).T
        found: Tensor = self._made["direction"]
        return found

    def _sharp(self, joint: int, size: int) -> Float[Tensor, " T"]:
        """The velocity of a joint that tells its direction."""
        log, samples = self.log, self.log.samples
        own = slice(joint, joint + 1)
        chosen = None if self.cutoff is None else filter_of(self.rate, WIDE * self.cutoff)
        out = []
        for start in range(0, samples, size):
            here = _Reach.of(start, min(start + size, samples), samples, chosen)
            if self.own_velocity and log.dq is not None:
                dq = log.dq[here.lo : here.hi, own].T
            else:
                a = max(0, here.lo - _REACH)
                dq = central_difference(log.q[a : here.hi + _REACH, own].T, self.rate)
                dq = dq[:, here.lo - a : here.hi - a]
            out.append(here.through(dq, chosen)[0])
        return torch.cat(out)


@dataclass(frozen=True)
class _Reach:
    """Which samples a filter needs for some of them.

    Attributes:
        start, stop: the samples that are wanted.
        lo, hi: those that the filter sees.
        before, after: samples by which these are extended, at the trajectory's ends as the whole of
            it is.
    """

    start: int
    stop: int
    lo: int
    hi: int
    before: int
    after: int

    @classmethod
    def of(cls, start: int, stop: int, samples: int, chosen: ZeroPhaseFilter | None) -> "_Reach":
        tail = 0 if chosen is None else chosen.tail
        lo, hi = max(0, start - tail), min(samples, stop + tail)
        return cls(start, stop, lo, hi, tail if lo == 0 else 0, tail if hi == samples else 0)

    def through(
        self, x: Float[Tensor, "C M"], chosen: ZeroPhaseFilter | None
    ) -> Float[Tensor, "C _"]:
        """Signals at lo..hi, filtered, at start..stop."""
        if chosen is None:
            return x[:, self.start - self.lo : self.stop - self.lo]
        first = self.before + self.start - self.lo
        last = first + self.stop - self.start
        return chosen.decimated(extended(x, self.before, self.after), 1, first, last)


def held_sign(dq: Float[Tensor, " T"], threshold: Tensor) -> Int[Tensor, " T"]:
    """The sign of the last velocity above the threshold; see `torchid.design.motion.direction`."""
    index = torch.arange(len(dq), device=dq.device)
    speed = dq.abs()
    # At exact rest rounding has a sign too, another one in another file of the same log.
    # 1e-9: share of a joint's largest speed below which it is rounding
    least = torch.maximum(threshold, 1e-9 * speed.max())
    last = torch.cummax(torch.where(speed > least, index, -1), 0).values
    sign = torch.sign(dq).to(torch.int8)[last.clamp(min=0)]
    return torch.where(last >= 0, sign, torch.zeros_like(sign))


def _joined(parts: list[Motion], like: Motion) -> Motion:
    """Motions one after another; none at all has the shape of `like`."""
    parts = parts or [like.part(slice(0, 0))]
    lags = [p.lag for p in parts if p.lag is not None]
    q, dq, ddq = (torch.cat(x) for x in zip(*(p.state for p in parts), strict=True))
    return Motion(q, dq, ddq, lag=torch.cat(lags) if lags else None)
