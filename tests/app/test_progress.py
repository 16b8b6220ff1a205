"""Progress on standard error: a bar on a terminal, a line a stage elsewhere."""

import os
import re
import subprocess
import sys

import pytest
from msgspec import structs

from tests.results.test_answer import answer
from tests.terminal import on_a_terminal
from torchid.app.output import Output
from torchid.app.progress import ProgressLines, TimeLeft
from torchid.parallel.workers import stage
from torchid.results.answer import JointError

PROGRAM = """
import sys, time
from torchid.app.output import Output
with Output(quiet="-q" in sys.argv) as output, output.progress("reading") as report:
    assert (report is None) == ("-q" in sys.argv)
    if report:
        passed = iter(10.0 * k for k in range(1000))
        report.left._clock = lambda: next(passed)
    for k in range(4 if report else 0):
        report("searching [a]", k, 4)
        time.sleep(0.15)
print("the answer")
"""


def program(*arguments: str) -> tuple[str, str]:
    """What the program writes to standard error, a terminal, and to standard output, a pipe."""

    def start(terminal: int) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-c", PROGRAM, *arguments],
            stdout=subprocess.PIPE, stderr=terminal, env=os.environ | {"TERM": "xterm"},
        )  # fmt: skip

    return on_a_terminal(start)


@pytest.mark.slow
def test_a_terminal_is_told_what_runs_and_how_much_is_left() -> None:
    shown, out = program()
    assert out == "the answer\n"
    assert "searching [a]" in shown  # brackets are no markup
    assert "3/4" in shown
    assert re.search(r"about \d+ s left", shown)


@pytest.mark.slow
def test_quiet_is_quiet_on_a_terminal_too() -> None:
    assert program("-q") == ("", "the answer\n")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "stages"),
    [
        (("identify", "3r_friction", "check.csv"), {"checking the log", "predicting"}),
        (
            ("gap", "3r_friction", "check.csv", "--effects", "torque_offset"),
            {"checking the log", "adding causes", "exchanging causes", "judging", "locating"},
        ),
    ],
)
def test_a_line_a_stage_without_a_terminal(
    command, folder, types_unchecked, arguments, stages
) -> None:
    name, robot, log, *options = arguments
    done = command(name, robot, folder / log, *options)
    assert done.code == 0
    every = [line for line in done.err.splitlines() if line.strip()]
    shown = list(every)
    if "So far: the gap is" in done.err:  # a table of all joints, as the answer's
        first = next(k for k, line in enumerate(every) if line.startswith("So far: "))
        rows = [k for k, line in enumerate(every) if re.match(r"\d .*->", line)]
        assert sorted(every[k][0] for k in rows) == ["1", "2", "3"]
        shown = [*every[:first], *every[rows[-1] + 1 :]]
    lines = [re.fullmatch(r"(.+): \d+\.\d s(, about \d+ \w+ left)?", line) for line in shown]
    assert all(lines), done.err
    told = [line[1] for line in lines]
    assert stages <= set(told)
    assert len(told) == len(set(told))  # none twice
    assert not any(f"{name}: " in done.out for name in told)
    quiet = command(name, robot, folder / log, *options, "--quiet")
    assert (quiet.code, quiet.out, quiet.err) == (0, "", "")


def test_without_a_terminal_a_stage_is_told_when_it_is_over(capsys) -> None:
    with Output() as output, output.progress("reading") as report:
        searching = stage(report, "searching [a]")
        assert capsys.readouterr() == ("", "")
        for k in range(3):
            searching(k, 3)
        out, err = capsys.readouterr()
        assert (out, err.split(":")[0], err.count("\n")) == ("", "reading", 1)
        report("reading", 0, 1)
        report("done", 1, 1)
    out, err = capsys.readouterr()
    assert (out, err.split(":")[0], err.count("\n")) == ("", "searching [a]", 1)
    with Output(quiet=True) as output, output.progress("reading") as report:
        assert report is None
        assert stage(report, "searching") is None
    assert capsys.readouterr() == ("", "")


def test_a_table_is_told_again_where_its_rows_are_others(capsys, monkeypatch) -> None:
    """Once in ten seconds at most, whatever the headline."""
    monkeypatch.setattr("torchid.app.progress.SAID_EVERY_S", -1.0)
    joint = JointError(joint=0, name="j", before=10.0, after=8.0, noise=(0.1, 0.2))
    first = answer(joints=(joint,))
    other = answer(joints=(structs.replace(joint, after=6.0),))
    assert first.headline == other.headline
    lines = ProgressLines("searching")
    said = []
    for one in (first, first, other):
        lines.so_far(one)
        said.append("10 -> " in capsys.readouterr().err)
    assert said == [True, False, True]


def test_of_what_fails_the_error_alone_is_said(capsys) -> None:
    with pytest.raises(ValueError), Output() as output, output.progress("reading"):  # noqa: PT011
        raise ValueError
    assert capsys.readouterr() == ("", "")


class Clock:
    """That is set by hand."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_the_rest_takes_as_long_as_what_is_done_and_nothing_is_said_before() -> None:
    clock = Clock()
    left = TimeLeft(clock)
    assert left.seconds is None
    left.hear(0, 10)
    clock.now += 50.0
    assert (left.seconds, str(left)) == (None, "")  # nothing is done yet
    left.hear(2, 10)
    assert left.seconds == pytest.approx(200.0)
    assert str(left) == "about 3 min left"
    clock.now += 150.0  # it goes down while nothing is heard
    assert left.seconds == pytest.approx(50.0)
    assert str(left) == "about 50 s left"
    clock.now += 60.0  # it has run out: nobody knows
    assert (left.seconds, str(left)) == (None, "")
    left.hear(5, 10)
    # In the second half of 260 s, of three steps that took 210 s.
    assert left.seconds == pytest.approx(5 * 130 / (130 / 70))
    left.hear(10, 10)
    assert left.seconds is None


def test_what_was_done_before_tells_no_speed() -> None:
    clock = Clock()
    left = TimeLeft(clock)
    left.hear(90, 100)
    assert left.seconds is None
    clock.now += 30.0
    left.hear(93, 100)
    assert left.seconds == pytest.approx(70.0)
    left.hear(0, 100)
    clock.now += 0.1
    left.hear(50, 100)  # a store had these
    clock.now += 10.0
    left.hear(51, 100)
    assert left.seconds == pytest.approx(49 * 10, rel=0.02)


@pytest.mark.parametrize(("done", "total"), [(0, 1), (1, 1), (3, 0), (1, 50), (1, 21)])
def test_no_estimate_of_one_step_of_an_unknown_number_or_of_a_small_share(done, total) -> None:
    clock = Clock()
    left = TimeLeft(clock)
    left.hear(0, total)
    clock.now += 30.0
    left.hear(done, total)
    assert left.seconds is None


def test_a_count_goes_on_through_stages_and_another_one_begins_anew() -> None:
    clock = Clock()
    left = TimeLeft(clock)
    lines = ProgressLines("reading")
    lines.left = left
    lines("searching", 0, 100)
    clock.now += 30.0
    lines("judging", 60, 100)
    assert left.seconds == pytest.approx(20.0)
    lines("other searching", 0, 100)
    assert left.seconds is None
    clock.now += 30.0
    lines("other searching", 3, 8)
    assert left.seconds is None


def test_parts_that_are_counted_together() -> None:
    heard = []
    told = stage(lambda *all_of_it: heard.append(all_of_it), "second of three", 1, 3)
    assert told is not None
    told(0, 40)
    told(40, 40)
    assert heard == [("second of three", 40, 120), ("second of three", 80, 120)]
