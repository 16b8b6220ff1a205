"""--help of every command ends with an example that is a command; shells can complete."""

import shlex
from collections.abc import Iterator
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from tests.test_docs import test_command_parses as parses
from torchid.app.commands import app


def _commands(group: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from _commands(command, (*path, name))
        else:
            yield " ".join((*path, name)), command


COMMANDS = dict(_commands(typer.main.get_command(app)))


def test_all_commands_are_seen() -> None:
    assert {"identify", "log doctor", "withheld own", "effects"} <= set(COMMANDS)
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
