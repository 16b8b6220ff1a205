"""What people do wrong in their first hour: one error that says what to type instead."""

import math
import re

import pytest

ARM = '<robot name="arm"><link name="base"/>{}</robot>'
LINK = (
    '<link name="l{k}"/><joint name="j{k}" type="revolute"><parent link="{p}"/><child link="l{k}"/>'
    '<origin xyz="0.2 0 0"/><axis xyz="0 1 0"/>'
    '<limit lower="-3" upper="3" velocity="3" effort="9"/>'
    "</joint>"
)
XACRO = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="a"><xacro:if value="1"/></robot>'


def degrees(table):
    for name in table:
        if name.startswith(("q", "dq")):
            table[name] *= 180 / math.pi


def milliseconds(table):
    table["t"] *= 1e3


def gripper(table):
    table |= {"q4": table["q1"] * 0.1, "tau4": table["tau1"] * 0.1}
    return table


def named(table):
    """In milliseconds, which is guessed and therefore asked."""
    milliseconds(table)
    new = {"t": "time", "q": "pos_j", "tau": "eff_j"}
    return {
        new[name.rstrip("123")] + name.lstrip("tqau"): v
        for name, v in table.items()
        if name.rstrip("123") in new
    }


def currents(table):
    return {name.replace("tau", "i"): values for name, values in table.items()}


def positions(table):
    return {name: values for name, values in table.items() if not name.startswith("tau")}


def two_joints(table):
    return {name: values for name, values in table.items() if not name.endswith("3")}


def hole(table):
    table["q2"][40] = float("nan")


def short(table):
    return {name: values[:12] for name, values in table.items()}


def still(table):
    for name in table:
        if name.startswith(("q", "dq")):
            table[name] = table[name][:1].expand(len(table["t"])).clone() * (name[0] == "q")


def no_torque(table):
    for name in table:
        if name.startswith("tau"):
            table[name] *= 0


def files(place) -> None:
    """Files that are not what they should be, and a robot."""
    links = "".join(LINK.format(k=k, p=f"l{k - 1}" if k > 1 else "base") for k in (1, 2, 3))
    (place / "my_arm.urdf").write_text(ARM.format(links))
    (place / "a.urdf.xacro").write_text(XACRO)
    (place / "odd.urdf").write_text('<sdf version="1.6"/>')
    (place / "odd.xml").write_text("<html/>")
    (place / "logs").mkdir()
    (place / "empty.csv").touch()
    (place / "notes.ipynb").write_text('{"cells": []}')
    (place / "log.pkl").write_bytes(b"\x80\x04.")
    (place / "no.parquet").write_text("t,q1\n0,0\n")
    (place / "other.json").write_text('{"a": 1}')
    (place / "corrected.yaml").write_text("name: arm\n")


MISTAKES = [
    ("gap my_amr.urdf good.csv", None, ["'my_amr.urdf' does not exist", "./my_arm.urdf"]),
    ("gap my_arm good.csv", None, ["unknown robot 'my_arm'", "./my_arm.urdf"]),
    ("gap 3r goood.csv", None, ["'goood.csv' does not exist", "./good.csv"]),
    ("gap good.csv 3r", None, ["comes first", "torchid gap 3r good.csv"]),
    ("identify 3r log.csv", degrees, ["degrees", '--columns "q=q{j} deg']),
    ("gap 3r log.csv", degrees, ["degrees", '--columns "q=q{j} deg', "--force"]),
    ("correct 3r log.csv --to mjcf", degrees, ['--columns "q=q{j} deg', "--force"]),
    ("identify 3r log.csv", milliseconds, ["seconds", '--columns "t=t ms"']),
    ("gap 3r log.csv", milliseconds, ["milliseconds", '--columns "t=t ms"']),
    ("identify 3r log.csv", gripper, ["got: 4", '--columns "q=q{1..3},tau=tau{1..3}"']),
    ("identify kuka_lwr4 good.csv", None, ["got: 3", "expected: 7", "--lock", "--tip"]),
    ("identify 3r log.csv", named, ["no column t", '"t=time ms,q=pos_j{j},tau=eff_j{j}"']),
    ("robot odd.urdf", None, ["<sdf>", "convert it to URDF"]),
    ("robot odd.xml", None, ["<html>", "<mujoco>"]),
    ("identify 3r log.csv", currents, ["no torque", "--gain K1,K2,K3"]),
    ("identify 3r log.csv", positions, ["no torque", "tau1.."]),
    ("identify 3r log.csv", hole, ["q2", "row 41"]),
    ("identify 3r good.csv log.csv", two_joints, ["different numbers", "'log.csv'", "'good.csv'"]),
    ("identify 3r good.csv --held-out good.csv", None, ["--held-out-fraction"]),
    ("identify 3r logs", None, ["is a folder", "a log"]),
    ("identify 3r empty.csv", None, ["is empty", "t, q1.."]),
    ("identify 3r notes.ipynb", None, ["to_csv"]),
    ("identify 3r log.pkl", None, ["to_csv"]),
    ("identify 3r no.parquet", None, ["not a parquet file"]),
    ("gap 3r good.csv --effects coulom_friction", None, ["nearest: coulomb_friction"]),
    ("identify 3r good.csv --out good.csv", None, ["'good.csv' is a file"]),
    ("explain other.json", None, ["not a result", "schema"]),
    ("export other.json --to urdf", None, ["no dynamics", "torchid identify"]),
    ("explain corrected.yaml", None, ["is not JSON", "torchid robot corrected.yaml"]),
    ("excite --for corrected.yaml --out o", None, ["is not", "JSON"]),
    ("identify 3r log.csv", short, ["too short", "12 samples"]),
    ("identify 3r log.csv", still, ["no joint moves"]),
    ("identify 3r log.csv", no_torque, ["all torques are zero"]),
    ("simulate my_arm.urdf good.csv --save a.csv", None, ["inertial parameters"]),
]


@pytest.mark.parametrize(
    ("line", "change", "words"),
    MISTAKES,
    ids=[f"{line} {change.__name__ if change else ''}".strip() for line, change, _ in MISTAKES],
)
def test_a_mistake_is_one_error_with_its_remedy(
    command, broken, folder, tmp_path, monkeypatch, line, change, words
) -> None:
    monkeypatch.chdir(tmp_path)
    files(tmp_path)
    (tmp_path / "good.csv").write_bytes((folder / "check.csv").read_bytes())
    if change is not None:
        broken(change).rename(tmp_path / "log.csv")
    before = sorted(tmp_path.rglob("*"))
    done = command(*line.split())
    assert (done.code, done.out) == (1, "")
    error = done.err[done.err.index("error: ") :]
    assert len(error.splitlines()) <= 5
    for word in words:
        assert word in error, error
    assert sorted(tmp_path.rglob("*")) == before


def test_xacro_of_any_name_is_refused_and_never_run(command, tmp_path, monkeypatch) -> None:
    """A xacro is a program: what would run it, or stand for what runs it, is not touched."""
    monkeypatch.chdir(tmp_path)
    files(tmp_path)
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
    (tmp_path / "c.xacro").write_text((tmp_path / "my_arm.urdf").read_text())
    assert command("robot", "c.xacro").code == 0


def test_limits_of_zero_name_what_replaces_them(command, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    files(tmp_path)
    text = (tmp_path / "my_arm.urdf").read_text()
    text = re.sub(r'(velocity|effort)="[^"]*"', r'\1="0"', text)
    (tmp_path / "zero.urdf").write_text(text)
    assert command("robot", "zero.urdf").code == 0
    line = ("excite", "zero.urdf", "--restarts", 1, "--duration", 5, "--kind", "random")
    done = command(*line, "--to", "a.csv")
    for word in ("any joint", "--max-velocity 2.0", "--max-acceleration 5.0", 'velocity="2.0"'):
        assert word in done.err
    done = command(*line, "--max-velocity", 2, "--max-acceleration", 5, "--to", "a.csv")
    assert done.code == 0, done.err


@pytest.mark.parametrize("change", [degrees, milliseconds, gripper, named])
def test_the_line_works_when_it_is_pasted(command, broken, monkeypatch, tmp_path, change) -> None:
    monkeypatch.chdir(tmp_path)
    broken(change).rename("log.csv")
    asked = ("identify", "3r", "log.csv", "--cutoff", "8", "--effects", "none", "--quiet")
    said = command(*asked).err
    found = re.search(r'--columns "([^"]*)"', said)
    assert found is not None, said
    done = command(*asked, "--columns", found[1])
    assert done.code == 0, done.err
