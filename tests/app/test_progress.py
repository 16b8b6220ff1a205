"""A line a stage on standard error where there is no terminal; nothing with --quiet."""

import re

import pytest

from torchid.app.output import Results, progress_bar

LINE = re.compile(r"\[ *\d+ s\] \S.*")


@pytest.mark.parametrize(
    "arguments",
    [
        ("identify", "3r_friction", "check.csv"),
        ("gap", "3r_friction", "check.csv", "--effects", "torque_offset", "--no-rollout"),
    ],
)
def test_a_line_a_stage(command, folder, types_unchecked, arguments) -> None:
    name, robot, log, *options = arguments
    done = command(name, robot, folder / log, *options)
    assert done.code == 0, done.err
    lines = done.err.splitlines()
    assert all(LINE.fullmatch(line) for line in lines), done.err
    stages = [line.partition("] ")[2] for line in lines]
    assert len(stages) >= 2
    assert len(set(stages)) == len(stages)
    assert not set(stages) & set(done.out.splitlines())
    quiet = command(name, robot, folder / log, *options, "--quiet")
    assert (quiet.code, quiet.out, quiet.err) == (0, "", "")


def test_other_commands_are_silent_without_a_terminal(capsys) -> None:
    with progress_bar(Results().open()) as report:
        assert report is None
    with progress_bar(Results().open(), lines=True) as report:
        assert report is not None
        # An error of the first stage is all that is said.
        for done in range(3):
            report("one", done, 3)
        assert capsys.readouterr() == ("", "")
        for stage in ("two", "one", "two", "three", "two", "four"):
            report(stage, 0, 1)
    said = capsys.readouterr()
    stages = [line.partition("] ")[2] for line in said.err.splitlines()]
    assert stages == ["one", "two", "three", "four"]
    assert said.out == ""
