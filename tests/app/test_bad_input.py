"""A user's mistake ends in one message, exit code 1, and nothing half-written."""

import re

import numpy as np
import pytest
import torch

URDF = """<robot name="bare"><link name="base"/><link name="arm"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>"""


def refused(outcome, *words):
    assert outcome.code == 1
    # Stages that were done are told before it.
    done = re.compile(r"\[|.*: [\d.]+ s$")
    said = [line for line in outcome.err.splitlines() if not done.match(line)]
    assert said[0].startswith("error: ")
    for word in words:
        assert word in outcome.err, outcome.err


def nan(table):
    table["q2"][17] = float("nan")


def duplicate_time(table):
    table["t"][40] = table["t"][39]


def decreasing_time(table):
    table["t"][40] = table["t"][10]


def degrees(table):
    for j in (1, 2, 3):
        table[f"q{j}"] *= 57.29578


def one_sample(table):
    return {k: v[:1] for k, v in table.items()}


def no_sample(table):
    return {k: v[:0] for k, v in table.items()}


def all_zero_torque(table):
    for j in (1, 2, 3):
        table[f"tau{j}"] *= 0


def one_joint_fewer(table):
    return {k: v for k, v in table.items() if not k.endswith("3")}


def no_torque(table):
    return {k: v for k, v in table.items() if not k.startswith("tau")}


def gap_in_numbers(table):
    return {k.replace("q3", "q4"): v for k, v in table.items()}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (nan, ("q2", "row 18")),
        (duplicate_time, ("time",)),
        (decreasing_time, ("time",)),
        (degrees, ("degrees",)),
        (one_sample, ("sample",)),
        (no_sample, ("broken.csv",)),
        (all_zero_torque, ("torque",)),
        (one_joint_fewer, ("got: 2", "expected: 3")),
        (no_torque, ("no torque",)),
        (gap_in_numbers, ("q",)),
    ],
)
def test_log(command, broken, tmp_path, change, words):
    target = tmp_path / "result.json"
    target.write_text("kept")
    refused(command("identify", "3r_friction", broken(change), "--json", target), *words)
    assert target.read_text() == "kept"


@pytest.mark.slow
def test_joint_that_never_moves(command, broken, tmp_path):
    """Identification goes on and names what the log does not determine."""

    def freeze(table):
        table["q3"] = torch.full_like(table["q3"], 0.3)

    shown = command("identify", "3r_friction", broken(freeze), "--cutoff", "8")
    assert shown.code == 0, shown.err
    text = " ".join(shown.out.split())
    assert "joint 3" in text
    assert "does not determine" in text
    assert "Fv3" in text.split("does not determine")[1]


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("log.parquet", b"t,q1,q2,q3\n0,0,0,0\n"),
        ("log.npz", b"\x00\x01\x02 not an archive"),
        ("log.csv", bytes(range(256)) * 20),
        ("log.xlsx", b"PK"),
    ],
)
def test_file_that_is_not_what_its_name_says(command, tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    refused(command("identify", "3r_friction", path), name)


def test_pickled_npz_is_refused(command, tmp_path):
    path = tmp_path / "log.npz"
    np.savez(path, t=np.array([object()], dtype=object), q=np.zeros((1, 3)))
    refused(command("identify", "3r_friction", path), "log.npz")


def test_missing_log_and_unknown_robot(command, folder, tmp_path):
    refused(command("identify", "3r_friction", tmp_path / "no.csv"), "no.csv")
    refused(command("identify", "4r", folder / "check.csv"), "4r", "kuka_lwr4")
    refused(command("robot", tmp_path / "no.urdf"), "does not exist")


def test_robot_files_that_are_not_robots(command, tmp_path):
    for name, text in (("a.urdf", "<mujoco/>"), ("a.yaml", "just words"), ("a.urdf", "not xml")):
        path = tmp_path / name
        path.write_text(text)
        refused(command("robot", path), name)


def test_urdf_without_inertials(command, tmp_path):
    """Readable, said to be without parameters; simulation needs them, identification does not."""
    path = tmp_path / "bare.urdf"
    path.write_text(URDF)
    shown = command("robot", path)
    assert shown.code == 0
    assert "inertia" in shown.out
    motion = tmp_path / "m.csv"
    made = command("excite", path, "--kind", "random", "--max-acceleration", 2, "--to", motion)
    assert made.code == 0, made.err
    refused(command("simulate", path, motion, "--to", tmp_path / "log.csv"), "inertial parameters")
    assert not (tmp_path / "log.csv").exists()


def test_robot_without_limits(command, tmp_path):
    path = tmp_path / "free.yaml"
    path.write_text("name: free\ndh: {convention: classical, joints: [{a: 1}, {a: 1}]}\n")
    refused(command("excite", path, "--to", tmp_path / "m.csv"), "velocity", "acceleration")
    assert not (tmp_path / "m.csv").exists()


def test_output_that_cannot_be_written(command, folder, tmp_path):
    """Found out before the work, not after."""
    occupied = tmp_path / "file"
    occupied.write_text("kept")
    arguments = ("identify", "3r_friction", folder / "check.csv")
    refused(command(*arguments, "--out", occupied / "below"), "cannot be made")
    refused(command(*arguments, "--out", occupied), str(occupied))
    refused(command(*arguments, "--json", tmp_path / "nowhere" / "x.json"), "does not exist")
    refused(command(*arguments, "--json", tmp_path), "is a folder")
    assert occupied.read_text() == "kept"


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--cutoff", "fast", ("--cutoff", "auto")),
        ("--cutoff", "-3", ("positive",)),
        ("--error-cutoff", "nan", ("--error-cutoff",)),
        ("--error-cutoff", "-2", ("cut-off",)),
        ("--effects", "viscous_friction,viscous_friction", ("twice",)),
        ("--cutoff", "500", ("band",)),
        ("--effects", "viscous_friction,glue", ("glue", "coulomb_friction")),
        ("--reversal", "2", ("fraction",)),
        ("--held-out-fraction", "1.5", ("fraction",)),
        ("--error-cutoff", "900", ("band",)),
        ("--device", "abacus", ("abacus", "cpu")),
        ("--tip", "tool0", ("--tip",)),
    ],
)
def test_options(command, folder, option, value, words):
    arguments = ("identify", "3r_friction", folder / "check.csv", option, value)
    refused(command(*arguments), *words)


@pytest.mark.parametrize(
    "arguments",
    [
        ("identify", "3r", "x.csv", "--rows", "some"),
        ("identify", "3r", "x.csv", "--method", "magic"),
        ("identify", "3r", "x.csv", "--signs", "any"),
        ("identify", "3r", "x.csv", "--covariance", "half"),
        ("excite", "3r", "--kind", "wild", "--to", "m.csv"),
        ("excite", "3r", "--criterion", "luck", "--to", "m.csv"),
        ("simulate", "3r", "m.csv", "--noise", "loud", "--to", "l.csv"),
    ],
)
def test_choices_that_do_not_exist_are_wrong_usage(command, arguments):
    shown = command(*arguments)
    assert shown.code == 2
    assert any(
        word in shown.err for word in ("some", "magic", "any", "half", "wild", "luck", "loud")
    )


def test_held_out_log_that_is_also_fitted(command, folder):
    path = folder / "check.csv"
    refused(command("identify", "3r_friction", path, "--held-out", path), "check", "held out")
    refused(command("identify", "3r_friction", path, path), "given twice")
    both = ("--held-out", folder / "fit.parquet", "--held-out-fraction", 0.2)
    refused(command("identify", "3r_friction", path, *both), "one of them")


def test_log_of_a_few_samples(command, broken):
    path = broken(lambda table: {k: v[:7] for k, v in table.items()})
    refused(command("identify", "3r_friction", path, "--cutoff", "none"), "too short")


def test_excite_options(command, tmp_path):
    target = tmp_path / "m.csv"
    refused(command("excite", "3r"), "nowhere to write")
    refused(command("excite", "kuka_lwr4", "--kind", "paper", "--to", target), "3R")
    refused(command("excite", "3r", "--duration", "-1", "--to", target), "positive")
    asked = ("--kind", "random", "--basis", "report")
    refused(command("excite", "3r", *asked, "--to", target), "--basis", "--kind random")
    refused(command("excite", "3r", "--max-velocity", "1,2", "--to", target), "expected: 3")
    refused(command("excite", "3r", "--kind", "random", "--to", tmp_path / "m.doc"), "m.doc")
    assert not list(tmp_path.iterdir())


def test_simulate_options(command, tmp_path):
    motion = tmp_path / "m.csv"
    command("excite", "3r", "--kind", "random", "--to", motion)
    refused(command("simulate", "3r", motion), "nowhere to write")
    refused(command("simulate", "kuka_lwr4", motion, "--to", tmp_path / "l.csv"), "3", "7")


@pytest.mark.parametrize("seed", [-1, 2**63])
@pytest.mark.parametrize("arguments", [("extract", "3r"), ("wrenches", "3r"), ("study", "3r")])
def test_seeds_that_no_generator_takes_are_wrong_usage(command, arguments, seed):
    assert command(*arguments, "--seed", seed).code == 2
