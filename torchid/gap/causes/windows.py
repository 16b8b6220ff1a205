"""Windows of time in which pushes are looked for, and which push is which."""

from functools import cached_property

import numpy as np

from torchid.design.segments import Samples
from torchid.effects.base import Effect
from torchid.effects.transient import RAMP, Contact

WINDOWS_S = (0.4, 0.8, 1.5, 3.0)
"""Lengths of windows in which a push is looked for [s]."""

Span = tuple[int, int]
"""Window: first sample, and the one after the last."""


class Windows:
    """Windows in which pushes are looked for, and the pushes that were found.

    Args:
        samples: of the log.
        asked: (N,) samples in which pushes are looked for.
    """

    def __init__(self, samples: Samples, asked: np.ndarray):
        self.samples, self.asked = samples, asked
        self._found: list[tuple[object, float, float]] = []

    @cached_property
    def shortest(self) -> float:
        """Length of the shortest push [s]: of the filter's answer, within which every blip looks
        the same, and as long as a force takes to come and go."""
        return max(1 / self.samples.cutoff, 2 * RAMP)

    @cached_property
    def spans(self) -> np.ndarray:
        """(W, 2): first sample, and the one behind the last."""
        out: list[Span] = []
        for own in (b for b in self.samples.bounds if self.asked[b].any()):
            for seconds in WINDOWS_S:
                size = max(3, round(seconds / self.samples.interval))
                first = range(own.start, own.stop - size, max(1, size // 4))
                out += [(i, i + size) for i in first]
        return np.array(out).reshape(-1, 2)

    @property
    def count(self) -> int:
        """W, one at least."""
        return max(1, len(self.spans))

    def key(self, effect: Effect) -> tuple[object, ...]:
        """What an event is, whatever its shape: of two pushes at one place whose windows overlap
        the one is the other."""
        if not isinstance(effect, Contact):
            return (*effect.identity, getattr(effect, "side", ""))
        place = effect.tip, effect.along
        start, stop = (float(t) for t in (effect.start or 0.0, effect.stop or 0.0))
        # Windows that overlap are of one push, whichever length fits it best.
        for k, (where, a, b) in enumerate(self._found):
            if where == place and start < b and a < stop:
                return (effect.name, k)
        self._found.append((place, start, stop))
        return (effect.name, len(self._found) - 1)
