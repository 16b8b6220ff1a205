"""No command writes over one of its inputs, whatever name the input is given by."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
import typer

from torchid.app.commands import app
from torchid.app.inputs import PLACE, WRITTEN
from torchid.app.signature import Option
from torchid.files import add_input, atomic_write, inputs_kept, require_no_input


def _commands(group: typer.Typer, above: tuple[str, ...] = ()) -> Iterator[tuple[Any, ...]]:
    for one in group.registered_commands:
        name = one.name or one.callback.__name__.removesuffix("_command")
        yield (*above, name), one.callback.options
    for below in group.registered_groups:
        yield from _commands(below.typer_instance, (*above, below.name))


COMMANDS = dict(_commands(app))
FILES = ("robot", "params", "result")
"""Options that are text, because they may be names as well as files."""


def _is_input(option: Option) -> bool:
    files = option.takes_paths or (option.name in FILES and option.name != "robot_name")
    return files and WRITTEN not in option.said and PLACE not in option.said


def _is_argument(option: Option) -> bool:
    return isinstance(get_args(option.parameter.annotation)[1], typer.models.ArgumentInfo)


def _shown(option: Option, value: object) -> list[str]:
    return [str(value)] if _is_argument(option) else [option.shown, str(value)]


PAIRS = [
    pytest.param(name, read, written, id=f"{'-'.join(name)}-{read.name}-{written.name}")
    for name, options in COMMANDS.items()
    for read in options
    for written in options
    if _is_input(read) and WRITTEN in written.said
]


def test_all_commands_with_inputs_are_seen() -> None:
    seen = {pair.values[0] for pair in PAIRS}
    assert {("identify",), ("log", "show"), ("withheld", "score"), ("compare",)} <= seen
    assert len(seen) >= 16
    names = {pair.values[2].name for pair in PAIRS}
    assert {"json_file", "report", "save", "apply", "save_model", "nearest", "ros2"} <= names


def _arguments(
    name: tuple[str, ...], folder: Path, read: Option, given: Path, written: Option, target: Path
) -> list[str]:
    """A command line with all that must be given, the file that is read and where to write."""
    words = list(name)
    required = [o for o in COMMANDS[name] if o.parameter.default is o.parameter.empty]
    arguments = [o for o in COMMANDS[name] if _is_argument(o)]
    for option in dict.fromkeys([*arguments, *required, read, written]):
        if option is read:
            words += _shown(option, given)
        elif option is written:
            words += _shown(option, target)
        elif option in required or _is_argument(option):
            value = {"seed": "1", "cases": "1", "to": "urdf"}.get(option.name)
            words += _shown(option, value or folder / f"other_{option.name}.yaml")
    return words


@pytest.mark.parametrize(("name", "read", "written"), PAIRS)
def test_an_input_is_never_written_over(command, tmp_path, name, read, written) -> None:
    given = tmp_path / "given.yaml"
    given.write_text("as it was")
    link, hard = tmp_path / "link", tmp_path / "hard"
    link.symlink_to(given)
    os.link(given, hard)
    before = sorted(p.name for p in tmp_path.iterdir())
    ways = (given, tmp_path / "." / ".." / tmp_path.name / "given.yaml", link, hard)
    for k, target in enumerate(ways):
        way = given if k else link
        done = command(*_arguments(name, tmp_path, read, way, written, target))
        assert done.code == 1, done.err
        assert "would overwrite the input" in done.err
        assert written.shown in done.err
    assert given.read_text() == "as it was"
    assert sorted(p.name for p in tmp_path.iterdir()) == before


def test_a_fixed_name_in_the_folder_of_results_is_guarded_too(command, tmp_path) -> None:
    motion = tmp_path / "log.parquet"
    assert command("excite", "3r", "--kind", "random", "--to", motion).code == 0
    before = motion.read_bytes()
    done = command("simulate", "3r", motion, "--out", tmp_path)
    assert done.code == 1
    assert "would overwrite the input" in done.err
    assert motion.read_bytes() == before


@pytest.mark.slow
def test_the_robot_of_a_result_is_an_input(command, tmp_path, monkeypatch) -> None:
    """It is named in the file only."""
    monkeypatch.chdir(tmp_path)
    assert command("export", "3r", "--to", "yaml", "--name", "arm", "--out", ".").code == 0
    motion = tmp_path / "motion.csv"
    assert command("excite", "arm.yaml", "--kind", "random", "--to", motion).code == 0
    assert command("simulate", "arm.yaml", motion, "--to", "log.csv").code == 0
    done = command("identify", "arm.yaml", "log.csv", "--cutoff", 8, "--json", "result.json")
    assert done.code == 0, done.err
    before = Path("arm.yaml").read_bytes()
    done = command("export", "result.json", "--to", "c", "--json", "arm.yaml")
    assert (done.code, Path("arm.yaml").read_bytes()) == (1, before)
    assert "would overwrite the input 'arm.yaml'" in done.err


def test_two_results_need_two_files(command, folder, tmp_path) -> None:
    both = ("--json", tmp_path / "a", "--save-model", tmp_path / "x" / ".." / "a")
    done = command("gap", "3r", folder / "check.csv", *both)
    assert done.code == 1
    assert "name the same file" in done.err


def test_files_in_a_folder_that_is_read(tmp_path: Path) -> None:
    inside = tmp_path / "bag" / "data" / "part.parquet"
    inside.parent.mkdir(parents=True)
    inside.write_text("kept")
    with inputs_kept([tmp_path / "bag"]):
        with pytest.raises(Exception, match="overwrite"), atomic_write(inside):
            pytest.fail("must not get here")
        with atomic_write(tmp_path / "bag" / "new.json") as file:
            file.write("new files have room")
    assert inside.read_text() == "kept"
    with atomic_write(inside) as file:  # in Python there are no such inputs
        file.write("other")


def test_inputs_that_are_met_later(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text("kept")
    add_input(path)  # nothing lasts
    require_no_input(path)
    with inputs_kept([]):
        require_no_input(path)
        add_input(path)
        with pytest.raises(Exception, match="--json would overwrite"):
            require_no_input(path, "--json")
    require_no_input(path)
