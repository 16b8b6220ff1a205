"""Names from files are shown as they are: no markup, no commands to the terminal."""

import pytest
import yaml

from tests.robustness.bad_robots import GOOD


@pytest.mark.parametrize("name", ["pan[left]", "[/left]", "[bold]x", ":smile:", "a\\[b"])
def test_names_are_not_markup(command, tmp_path, name) -> None:
    joints = [{**row, "name": f"{name}{k}"} for k, row in enumerate(GOOD["dh"]["joints"])]
    file = tmp_path / "arm.yaml"
    robot = {**GOOD, "name": f"arm {name}", "dh": {**GOOD["dh"], "joints": joints}}
    file.write_text(yaml.safe_dump(robot))
    for arguments in (("robot", file), ("check", file)):
        done = command(*arguments)
        assert done.code == 0, done.err
        assert f"{name}0" in done.out or arguments[0] == "check"
        assert f"arm {name}" in done.out


def test_names_do_not_command_the_terminal(command, tmp_path) -> None:
    file = tmp_path / "arm.yaml"
    file.write_text(yaml.safe_dump({**GOOD, "name": "arm \x1b]0;title\x07" + "n" * 5000}))
    done = command("robot", file)
    assert done.code == 0
    assert "\x1b" not in done.out
    assert len(done.out) < 10_000


@pytest.mark.parametrize(
    "arguments",
    [
        ("extract", "3r", "--runs", 10**8),
        ("extract", "3r", "--population", 10**9),
        ("excite", "3r", "--harmonics", 10**5),
        ("excite", "3r", "--rate", 1e12, "--to", "m.csv"),
        ("wrenches", "3r", "--margin", -1),
        ("atlas", "3r", "--level", "nan"),
    ],
)
def test_numbers_out_of_range(command, arguments, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert command(*arguments).code in (1, 2)
    assert not list(tmp_path.iterdir())
