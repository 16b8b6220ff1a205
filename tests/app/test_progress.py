"""Progress on standard error: a bar on a terminal, a line a stage elsewhere."""

import os
import re
import subprocess
import sys

import pytest

from tests.terminal import on_a_terminal
from torchid.app.output import Output
from torchid.parallel.workers import stage

PROGRAM = """
import sys, time
from torchid.app.output import Output
with Output(quiet="-q" in sys.argv) as output, output.progress("reading") as report:
    assert (report is None) == ("-q" in sys.argv)
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
    assert "left:" in shown


@pytest.mark.slow
def test_quiet_is_quiet_on_a_terminal_too() -> None:
    assert program("-q") == ("", "the answer\n")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "stages"),
    [
        (("identify", "3r_friction", "check.csv"), {"checking the log", "predicting"}),
        (
            ("gap", "3r_friction", "check.csv", "--effects", "torque_offset", "--no-rollout"),
            {"preparing", "searching for effects", "judging", "locating"},
        ),
    ],
)
def test_a_line_a_stage_without_a_terminal(
    command, folder, types_unchecked, arguments, stages
) -> None:
    name, robot, log, *options = arguments
    done = command(name, robot, folder / log, *options)
    assert done.code == 0
    shown = (line for line in done.err.splitlines() if not line.startswith("So far: "))
    lines = [re.fullmatch(r"(.+): \d+\.\d s", line) for line in shown]
    assert all(lines), done.err
    told = [line[1] for line in lines]
    assert stages <= set(told)
    assert len(told) == len(set(told))  # none twice
    assert not any(line in done.out for line in done.err.splitlines())
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


def test_of_what_fails_the_error_alone_is_said(capsys) -> None:
    with pytest.raises(ValueError), Output() as output, output.progress("reading"):  # noqa: PT011
        raise ValueError
    assert capsys.readouterr() == ("", "")
