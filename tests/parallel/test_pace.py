"""Stages of a piece of work: how far it is, how long the rest takes, and what there is time for."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from torchid.parallel.pace import MARGIN, Pace

SHARES = {"read": 10.0, "look": 20.0, "again": 40.0, "judge": 30.0}
SEARCH = ("look", "again", "judge")


class Work:
    """That takes the time that it is told, and hears what is expected of it."""

    def __init__(self, seconds: float | None = None, **more: object) -> None:
        self.now, self.heard, self.left = 0.0, list[tuple[str, int, int]](), list[float]()
        self.pace = Pace(self, SHARES, seconds=seconds, clock=lambda: self.now, **more)  # type: ignore[arg-type]

    def __call__(self, stage: str, done: int, total: int) -> None:
        self.heard.append((stage, done, total))

    def expect(self, seconds: float) -> None:
        self.left.append(seconds)

    def does(self, stage: str, seconds: float) -> None:
        self.pace(stage)
        self.now += seconds


def test_stages_by_their_shares_of_the_time() -> None:
    work = Work()
    for stage, seconds in (("read", 1.0), ("look", 2.0), ("again", 4.0), ("judge", 3.0)):
        work.does(stage, seconds)
    assert work.heard == [(s, p, 100) for s, p in zip(SHARES, (0, 10, 30, 70), strict=True)]
    assert work.left == [9.0, 7.0, 3.0]
    work.pace("look")  # has been, and nothing is said
    assert len(work.heard) == 4


def test_a_stage_that_does_not_come_takes_no_time() -> None:
    skipped, told = Work(), Work()
    for work in (skipped, told):
        work.does("read", 1.0)
        work.does("look", 2.0)
    for times, left in ((0.0, 3.0), (1.0, 7.0), (0.0, 3.0)):  # it may come after all
        told.pace.scale(["again"], times)
        told.pace.tell()
        assert told.left[-1] == pytest.approx(left)
    skipped.pace("judge")
    assert skipped.heard[-1] == ("judge", 50, 100)


def test_stages_that_go_together_are_expected_of_each_other() -> None:
    work = Work(search=SEARCH)
    work.does("read", 1.0)
    work.does("look", 20.0)  # ten times as long as reading says
    work.pace("again")
    assert work.left[-1] == pytest.approx(70.0)


def test_one_that_takes_longer_makes_the_others_longer() -> None:
    work = Work()
    work.does("read", 1.0)
    work.does("look", 6.0)
    work.pace.tell()  # of two seconds that it was expected to
    assert work.left[-1] == pytest.approx(12.0 + 9.0)


def test_a_progress_that_expects_nothing_is_told_percents() -> None:
    heard: list[tuple[str, int, int]] = []
    pace = Pace(lambda *said: heard.append(said), SHARES)
    pace("read")
    pace("look")
    assert [stage for stage, *_ in heard] == ["read", "look"]
    Pace(None, {})("anything")


@given(st.floats(6.0, 40.0), st.lists(st.floats(0.1, 3.0), max_size=20))
def test_no_step_is_begun_that_leaves_no_time_to_judge(seconds: float, steps: list[float]) -> None:
    work = Work(seconds, must=("judge",))
    work.does("read", 1.0)
    work.pace("look")
    for step in steps:
        judging, begun = work.pace.expected("judge"), work.now
        if not work.pace.has_time("looking"):
            assert begun + MARGIN * judging >= seconds
            assert (work.pace.left_out, work.pace.stopped_after) == (("looking",), begun)
            return
        assert begun + MARGIN * judging < seconds
        work.now += step
    assert (work.pace.left_out, work.pace.stopped_after) == ((), None)


def test_what_there_is_no_time_for_is_named_once() -> None:
    work = Work(4.0, must=("judge",))
    work.does("read", 1.0)
    work.pace("look")
    assert not any(work.pace.has_time(what) for what in ("causes", "shapes", "causes"))
    assert work.pace.left_out == ("causes", "shapes")
    assert work.pace.stopped_after == 1.0
    work.pace.scale(["judge"], 0.1)  # little is there to judge
    assert work.pace.has_time("causes")
    assert not work.pace.has_time("all again", "again")
    assert Work().pace.has_time("anything")


@pytest.mark.parametrize(
    ("seconds", "stages", "judged", "enough"),
    [
        (1 + MARGIN * 3 + 0.1, (), 1.0, True),
        (1 + MARGIN * 5 - 0.1, ("look",), 1.0, False),  # it takes two
        (1 + MARGIN * 5 + 0.1, ("look",), 1.0, True),
        (1 + MARGIN * 5 + 0.1, ("look",), 2.0, False),  # twice as much as usual
        (1 + MARGIN * 8 + 0.1, ("look",), 2.0, True),
    ],
)
def test_a_stage_that_has_begun_counts(
    seconds: float, stages: tuple[str, ...], judged: float, enough: bool
) -> None:
    work = Work(seconds, must=("judge",))
    work.does("read", 1.0)
    work.pace("look")
    work.pace.scale(["judge"], judged)
    assert work.pace.has_time("looking", *stages) == enough


def test_seconds_count_from_where_the_work_began() -> None:
    work = Work()
    work.now = 3.0
    pace = Pace(None, SHARES, seconds=5.0, clock=lambda: work.now, begun=0.0)
    work.now = 4.0
    assert pace.has_time("looking")
    work.now = 6.0
    assert not pace.has_time("looking")
    assert pace.stopped_after == 6.0
