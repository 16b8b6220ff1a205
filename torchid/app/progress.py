"""What runs, how far it is, and for how much longer: on a terminal a bar, elsewhere lines."""

import math
import time
from bisect import bisect_right
from collections.abc import Callable
from typing import TYPE_CHECKING

import typer
from rich.console import Console
from rich.markup import escape
from rich.text import Text

from torchid.errors import visible

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.progress import Task

    from torchid.results.answer import Answer

SAID_EVERY_S = 10.0
"""Least time between two lines of what is known so far [s]."""
LINE_EVERY_S = 60.0
"""Time after which a stage that is not over has another line [s]."""
LEAST_SHARE = 0.05
"""Of what is counted, after which the rest is taken to be as fast."""
SOON_S = 2.0
"""Time within which no estimate is made, and none is worth one [s]."""


class TimeLeft:
    """How long the work still takes: what is expected of it; of what is counted, if the rest is as
    fast as what was done in the second half of the time until now: what a store had at once tells
    no speed.

    There is no estimate before a twentieth is done, of a single step, and where it has run out.

    Args:
        clock: seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._total = clock, 0
        self._times, self._done = [clock()], [0]
        self._end: float | None = None

    def expect(self, seconds: float) -> None:
        """It ends in so many seconds."""
        self._end = self._clock() + seconds

    def hear(self, done: int, total: int) -> None:
        """So much is done; another total, or less than before, begins another count."""
        if total != self._total or done < self._done[-1]:
            self._total, self._times, self._done = total, [self._clock()], [done]
        elif done > self._done[-1]:
            self._times.append(self._clock())
            self._done.append(done)

    @property
    def seconds(self) -> float | None:
        """Until the end [s]; None where nothing tells it."""
        if self._end is not None:
            left = self._end - self._clock()
            return left if left > SOON_S else None
        times, done = self._times, self._done
        made, half = done[-1] - done[0], (times[0] + times[-1]) / 2
        if made < max(1, LEAST_SHARE * (self._total - done[0])) or times[-1] - times[0] < SOON_S:
            return None
        k = bisect_right(times, half)
        share = (half - times[k - 1]) / (times[k] - times[k - 1])
        since = done[-1] - (1 - share) * done[k - 1] - share * done[k]
        end = times[-1] + (times[-1] - half) / since * (self._total - done[-1])
        left = end - self._clock()
        return left if left > SOON_S else None

    def __str__(self) -> str:
        """In words, as roughly as it is known; nothing where it is not."""
        seconds = self.seconds
        if seconds is None:
            return ""
        if seconds < 90:
            return f"about {5 * math.ceil(seconds / 5)} s left"
        hours = seconds / 3600
        return f"about {60 * hours:.0f} min left" if hours < 1.5 else f"about {hours:.1f} h left"


class ProgressLines:
    """One line a stage, for files and other programs."""

    def __init__(self, first: str) -> None:
        self.running, self.began, self.written = first, time.monotonic(), {""}
        self.said, self.at, self.left = "", -math.inf, TimeLeft()
        self.line = self.began

    def __enter__(self) -> "ProgressLines":
        return self

    def __call__(self, stage: str, done: int, total: int) -> None:
        """How far a stage is; a total of 0 where it is not known."""
        self.left.hear(done, total)
        following, now = "" if done == total > 0 else stage, time.monotonic()
        if following == self.running:
            if now > self.line + LINE_EVERY_S and str(self.left):
                self.line = now
                typer.echo(f"{visible(stage)}: {done} of {total}, {self.left}", err=True)
            return
        if self.running not in self.written:  # what runs in turns has one line
            left = f", {self.left}" if str(self.left) else ""
            typer.echo(f"{visible(self.running)}: {now - self.began:.1f} s{left}", err=True)
            self.written.add(self.running)
        self.running, self.began, self.line = following, now, now

    def expect(self, seconds: float) -> None:
        """The work ends in so many seconds."""
        self.left.expect(seconds)

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is None:
            self("", 0, 0)

    def so_far(self, answer: "Answer") -> None:
        """What is known before the end: headline and table, where either is another one."""
        if time.monotonic() > self.at + SAID_EVERY_S and str(answer) != self.said:
            self.said, self.at = str(answer), time.monotonic()
            Console(stderr=True, highlight=False, width=80).print(_screen(answer))


class ProgressBars:
    """A bar for what is running, below what is known so far; both go at the end."""

    def __init__(self, first: str, console: Console) -> None:
        from rich import progress as bar
        from rich.live import Live

        self.left = left = TimeLeft()

        class Left(bar.ProgressColumn):
            max_refresh = 0.5

            def render(self, task: "Task") -> Text:
                return Text(str(left))

        words = bar.TextColumn("{task.description}"), bar.BarColumn(), bar.MofNCompleteColumn()
        self.bars = bar.Progress(*words, bar.TimeElapsedColumn(), Left(), console=console)
        self.known: RenderableType | None = None
        self.task, self.running = self.bars.add_task(escape(visible(first)), total=None), first
        self.live = Live(console=console, transient=True, get_renderable=self._shown)

    def _shown(self) -> "RenderableType":
        from rich.console import Group

        return Group(self.known, self.bars) if self.known else self.bars

    def __enter__(self) -> "ProgressBars":
        self.live.start(refresh=True)
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self.live.stop()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """How far a stage is; a total of 0 where it is not known."""
        self.left.hear(done, total)
        if stage != self.running:  # a new bar, which begins at no time
            self.bars.remove_task(self.task)
            self.task = self.bars.add_task(escape(visible(stage)), total=None)
            self.running = stage
        self.bars.update(self.task, completed=done, total=total or None)

    def expect(self, seconds: float) -> None:
        """The work ends in so many seconds."""
        self.left.expect(seconds)

    def so_far(self, answer: "Answer") -> None:
        """What is known before the end."""
        self.known = _screen(answer)


def _screen(answer: "Answer") -> "RenderableType":
    """The answer so far, as the last one is shown."""
    from torchid.report.brief import Screen

    return Screen(answer=answer)
