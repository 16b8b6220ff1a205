"""What people do wrong in their first hour: the remedy that the error names works."""

import re

import pytest

from tests.app.test_bad_input import BARE, LOGS

XACRO = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="a"><xacro:if value="1"/></robot>'


def test_xacro_of_any_name_is_refused_and_never_run(command, tmp_path, monkeypatch) -> None:
    """A xacro is a program: what would run it, or stand for what runs it, is not touched."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "xacro.py").write_text("open('run', 'w')\n")
    program = tmp_path / "xacro"
    program.write_text("#!/bin/sh\ntouch run\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    for name in ("b.urdf", "b.xacro", "b.urdf.xacro", "b.urdf.xml"):
        (tmp_path / name).write_text(XACRO)
        done = command("robot", name)
        assert done.code == 1
        assert f"'{name}' is a xacro file: a program, which torchid does not run" in done.err
        assert "<xacro:if> on line 1" in done.err
        plain = "b_expanded.urdf" if name == "b.urdf" else "b.urdf"
        assert f"xacro {name} > {plain}" in done.err.replace("\n", " ")
    assert not (tmp_path / "run").exists()
    # What needs no expanding is read.
    (tmp_path / "c.xacro").write_text(BARE)
    assert command("robot", "c.xacro").code == 0


def test_limits_of_zero_name_what_replaces_them(command, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = re.sub(r'(velocity|effort)="[^"]*"', r'\1="0"', BARE)
    (tmp_path / "zero.urdf").write_text(text)
    assert command("robot", "zero.urdf").code == 0
    line = ("excite", "zero.urdf", "--restarts", 1, "--duration", 5, "--kind", "random")
    done = command(*line, "--to", "a.csv")
    for word in ("any joint", "--max-velocity 2.0", "--max-acceleration 5.0", 'velocity="2.0"'):
        assert word in done.err
    done = command(*line, "--max-velocity", 2, "--max-acceleration", 5, "--to", "a.csv")
    assert done.code == 0, done.err


@pytest.mark.parametrize("mistake", ["degrees", "ms", "gripper", "named"])
def test_the_line_works_when_it_is_pasted(command, broken, monkeypatch, tmp_path, mistake) -> None:
    monkeypatch.chdir(tmp_path)
    broken(LOGS[mistake]).rename("log.csv")
    asked = ("identify", "3r", "log.csv", "--cutoff", "8", "--effects", "none", "--quiet")
    said = command(*asked).err
    found = re.search(r'--columns "([^"]*)"', said)
    assert found is not None, said
    done = command(*asked, "--columns", found[1])
    assert done.code == 0, done.err
