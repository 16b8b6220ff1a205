"""How far a piece of work is, how long the rest takes, and whether there is time for more of it."""

import time
from collections.abc import Callable, Collection, Iterable, Mapping

from torchid.parallel.workers import Progress

MARGIN = 1.25
"""Times what a stage is expected to take that is kept for it, where the time is limited [1]."""


class Pace:
    """Stages of one piece of work, in their order, with about the share of the time that each
    takes; one that does not come takes none. How long the rest takes follows from those that are
    over.

    Args:
        progress: called with (stage, percent done, 100) as a stage begins; its method `expect`,
            where it has one, with the seconds that are left whenever more is known of them.
        shares: by stage [1].
        search: stages whose times go together: what they take follows from each other, as soon as
            one of them is over.
        must: stages without which there is no result.
        seconds: in which all is to be done; None: as long as it takes.
        clock: seconds.
        begun: of the clock, from when the seconds count; None: from now on.
    """

    def __init__(
        self,
        progress: Progress | None,
        shares: Mapping[str, float],
        search: Collection[str] = (),
        must: Collection[str] = (),
        seconds: float | None = None,
        clock: Callable[[], float] = time.monotonic,
        begun: float | None = None,
    ) -> None:
        self._progress, self._clock, self._seconds = progress, clock, seconds
        self._shares, self._search, self._must = dict(shares), search, must
        self._times, self._at = dict[str, float](), clock()
        self._begun = self._at if begun is None else begun
        self._running, self._took = "", dict[str, float]()
        self._left_out = dict[str, None]()
        self.stopped_after: float | None = None
        """Seconds after which there was no time for something, first [s]."""

    @property
    def left_out(self) -> tuple[str, ...]:
        """What there was no time for, in words."""
        return tuple(self._left_out)

    def __call__(self, stage: str) -> None:
        """A stage begins; of one that has been nothing is said."""
        if stage in self._took or stage == self._running:
            return
        now = self._clock()
        if self._running:
            self._took[self._running] = now - self._at
        self._running, self._at = stage, now
        if self._progress is not None:
            done, left = (sum(map(self.expected, x)) for x in (self._took, self._following()))
            self._progress(stage, round(100 * done / max(done + left, 1e-9)), 100)
        self.tell()

    def scale(self, stages: Iterable[str], times: float) -> None:
        """Stages take so many times their shares, as far as is known now: 0 of those that will not
        come."""
        self._times |= dict.fromkeys(stages, times)

    def tell(self) -> None:
        """Say how long the rest takes, if that is known."""
        expect = getattr(self._progress, "expect", None)
        if expect is not None and self._took:
            passed = self._clock() - self._at
            expect(sum(map(self.expected, self._following())) - passed)

    def expected(self, stage: str) -> float:
        """How long a stage takes [s]; its share while none is over. Where the one that runs takes
        longer than expected, so will those whose time goes with it."""
        if stage in self._took:
            return self._took[stage]
        same = [s for s in self._took if (s in self._search) == (stage in self._search)]
        over = same or list(self._took)
        share, seconds = self._share(over), sum(self._took[s] for s in over)
        unit = seconds / share if share else 1.0
        running, passed = self._share([self._running]), self._clock() - self._at
        if running and (self._running in self._search) == (stage in self._search):
            unit = max(unit, passed / running if self._took else unit)
        return unit * self._share([stage])

    def _share(self, stages: Iterable[str]) -> float:
        return sum(self._shares.get(one, 0.0) * self._times.get(one, 1.0) for one in stages)

    def _following(self) -> list[str]:
        """The stage that runs, and those behind it."""
        names = list(self._shares)
        return names[names.index(self._running) :] if self._running in names else []

    def has_time(self, what: str, *stages: str) -> bool:
        """Whether some stages can be done before those that are behind them and must be; where they
        cannot, `what` counts as left out.

        Args:
            what: in words.
            stages: the one that runs may be one of them; none: a step of it.
        """
        if self._seconds is None:
            return True
        following = self._following()
        needed = sum(self.expected(s) for s in following if s in stages)
        needed += sum(self.expected(s) for s in following[1:] if s in self._must)
        passed = self._clock() - self._begun
        if passed + MARGIN * needed < self._seconds:
            return True
        self._left_out[what] = None
        self.stopped_after = self.stopped_after or passed
        return False
