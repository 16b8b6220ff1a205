"""--help of every command ends with an example that is a command; shells can complete."""

import re
import shlex
from collections.abc import Iterator
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from tests.test_docs import test_command_parses as parses
from torchid.app.commands import app
from torchid.app.help import GROUPS
from torchid.app.signature import OPTIONS, Option


def _commands(group: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from _commands(command, (*path, name))
        else:
            yield " ".join((*path, name)), command


COMMANDS = dict(_commands(typer.main.get_command(app)))


def _old_names(option: Option) -> list[str]:
    """Names that it had once, and that still work."""
    declared = option.info.param_decls or () if option.has_name else ()
    return [name for name in declared if name.startswith("--") and name != option.shown]


def test_all_commands_are_seen() -> None:
    assert {"identify", "log doctor", "withheld make", "effects"} <= set(COMMANDS)
    assert len(COMMANDS) >= 20


@pytest.mark.parametrize("name", COMMANDS)
def test_help_ends_with_an_example(name: str) -> None:
    text = " ".join((COMMANDS[name].help or "").split())
    paragraph = text.rpartition("Example")[2]
    assert paragraph, "no example"
    examples = [part for part in paragraph.split("`")[1::2] if part.startswith("torchid ")]
    assert examples
    assert paragraph.rstrip(" .").endswith("`"), "something stands behind the example"
    for example in examples:
        arguments = shlex.split(example)[1:]
        assert " ".join(arguments).startswith(name), example
        parses(arguments)


@pytest.mark.parametrize("name", COMMANDS)
def test_names_and_values_are_whole_at_80_columns(name: str, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    text = CliRunner().invoke(app, [*name.split(), "--help"]).output
    assert "\u2026" not in text
    assert not re.search(r"<(bool|str|int|float|list|Path|FILE)| range>", text)
    lines = [line.strip("\u2502 ") for line in text.splitlines()]
    assert max(map(len, text.splitlines())) <= 80
    for option in OPTIONS[name]:
        assert any(line.startswith(f"{option.written} ") for line in lines), option.written
        assert not any(line.startswith(f"{old} ") for old in _old_names(option) for line in lines)


def test_the_first_options_of_a_diagnosis_are_few() -> None:
    panels = [option.place[1] for option in OPTIONS["gap"] if option.has_name]
    assert 5 <= panels.count("Options") <= 8
    assert panels[0] == "Options"
    assert len(set(panels)) >= 6


def test_alone_it_names_the_commands_to_begin_with() -> None:
    shown = CliRunner().invoke(app, [])
    assert shown.exit_code == 0
    for name in ("log doctor", "identify", "gap", "correct"):
        assert f"torchid {name} " in shown.output
    assert "torchid --help" in shown.output


def test_all_commands_stand_in_panels() -> None:
    names = [name for group in GROUPS.values() for name in group]
    assert sorted(names) == sorted(typer.main.get_command(app).commands)
    text = CliRunner().invoke(app, ["--help"]).output
    assert all(title in text for title in GROUPS)


@pytest.mark.parametrize(
    ("name", "given", "now"),
    [
        ("simulate", "3r run.csv --to log.csv", "save"),
        ("log show", "run.csv --out run.parquet", "save"),
        ("excite", "3r --to run.csv", "save"),
    ],
)
def test_old_names_still_work(name: str, given: str, now: str) -> None:
    """`--to` says for which format or simulator a file is, `--for` what a motion is for."""
    option = next(option for option in OPTIONS[name] if option.name == now)
    assert _old_names(option) == [given.split()[-2]]
    assert option.shown == f"--{now}"
    parses([*name.split(), *given.split()])


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shell_completion(shell: str) -> None:
    environment = {
        "_TORCHID_COMPLETE": f"source_{shell}",
        "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1",
    }
    shown = CliRunner().invoke(app, [], prog_name="torchid", env=environment)
    assert shown.exit_code == 0, shown.output
    assert "_TORCHID_COMPLETE" in shown.output


def test_completion_names_the_commands() -> None:
    environment = {
        "_TORCHID_COMPLETE": "complete_bash",
        "COMP_WORDS": "torchid ide",
        "COMP_CWORD": "1",
    }
    shown = CliRunner().invoke(app, [], prog_name="torchid", env=environment)
    assert "identify" in shown.output.split()


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_says_what_it_is(name: str) -> None:
    params = [p for p in COMMANDS[name].params if "--help" not in p.opts]
    assert params
    assert not [p.opts for p in params if not p.help]
