"""`torchid compare` and `torchid excite --for` from the outside."""

import json

import pytest

from tests.fleet.records import several
from tests.gap_files import hidden
from tests.gap_files import open_gap as diagnosis
from torchid.robot.library import load_robot


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    return several(tmp_path_factory.mktemp("results"), 3)


def test_compare_writes_and_says_the_verdict_first(command, results, tmp_path):
    asked = ("--out", tmp_path / "out", "--pictures", "--json", tmp_path / "c.json")
    done = command("compare", *results, *asked)
    assert done.code == 0, done.err
    assert done.out.startswith("3 identifications of 3r_friction")
    data = json.loads((tmp_path / "c.json").read_text())
    assert data == json.loads((tmp_path / "out" / "compare.json").read_text())
    assert data["schema"] == "torchid.compare/2"
    assert (tmp_path / "out" / "parameters.png").read_bytes().startswith(b"\x89PNG")


def test_compare_on_a_log(command, results, folder, tmp_path):
    done = command(
        "compare", *results[:2], "--on", folder / "check.csv", "--json", tmp_path / "c.json"
    )
    assert done.code == 0, done.err
    assert "the closest" in " ".join(done.out.split())
    errors = json.loads((tmp_path / "c.json").read_text())["torque"]["errors"]
    assert len(errors) == 2
    assert len(errors[0]) == 3


@pytest.mark.parametrize(
    ("files", "message"),
    [
        (["a"], "two results or more"),
        (["a", "a"], "given twice"),
        (["a", "gap"], "same kind"),
        (["a", "nothing"], "cannot be read"),
        (["a", "other"], "not a result that can be compared"),
        (["a", "broken"], "can be compared as torchid writes it"),
    ],
)
def test_bad_results(command, results, tmp_path, files, message):
    (tmp_path / "gap").write_text(json.dumps(diagnosis(load_robot("3r"))))
    (tmp_path / "other").write_text(json.dumps({"schema": "something/1"}))
    data = json.loads(results[1].read_text())
    data["base_values"] = data["base_values"][:-1]
    (tmp_path / "broken").write_text(json.dumps(data))
    paths = [results[0] if name == "a" else tmp_path / name for name in files]
    done = command("compare", *paths, "--json", tmp_path / "out.json")
    assert done.code == 1
    assert message in done.err
    assert not (tmp_path / "out.json").exists()


@pytest.mark.nightly
def test_excite_for_an_identification(command, folder, tmp_path):
    """Identify, design, and find the trajectory, its prediction and the same formats as ever."""
    found = tmp_path / "identification.json"
    log = folder / "fit.parquet"
    assert command("identify", "3r_friction", log, "--cutoff", 10, "--json", found, "-q").code == 0
    done = command(
        "excite", "--for", found, "--duration", 8, "--restarts", 1, "--out", tmp_path / "next"
    )
    assert done.code == 0, done.err
    assert done.out.startswith("Drive this motion")
    data = json.loads((tmp_path / "next" / "excitation.json").read_text())
    assert data["kind"] == "next"
    assert data["shrinks_to"]["designed"] <= data["shrinks_to"]["plain"] * 1.001
    header = (tmp_path / "next" / "trajectory.csv").read_text().splitlines()[0]
    assert header.startswith("t,q1,q2,q3,dq1")


@pytest.mark.nightly
def test_excite_for_a_diagnosis(command, tmp_path):
    path = tmp_path / "gap.json"
    path.write_text(json.dumps({**diagnosis(load_robot("3r")), "model": None}))
    done = command(
        "excite", "3r", "--for", path, "--duration", 6, "--restarts", 1, "--out", tmp_path / "next"
    )
    assert done.code == 0, done.err
    assert "For stribeck_friction and coulomb_friction" in done.out
    assert "contact: repeat the motion away from obstacles" in " ".join(done.out.split())
    data = json.loads((tmp_path / "next" / "excitation.json").read_text())
    decided = [[p["decides"][kind] for p in data["pairs"]] for kind in ("plain", "designed")]
    assert sum(decided[1]) >= sum(decided[0])
    assert (tmp_path / "next" / "trajectory.csv").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "which robot"),
        (["--for", "A", "--kind", "random"], "one optimised trajectory"),
        (["--for", "A", "--criterion", "condition"], "other criteria"),
        (["--for", "B"], "not a result that a motion can be designed for"),
        (["--for", "C"], "schema torchid.gap/0, of another version"),
        (["--for", "D"], "is not JSON"),
        (["--for", "missing.json"], "cannot be read"),
        (["--for", "E"], "is of another robot"),
        (["--for", "F"], "leaves nothing open"),
        pytest.param(["--for", "G"], "no motion settles", marks=pytest.mark.slow),
    ],
)
def test_excite_refuses(command, results, tmp_path, arguments, message):
    robot, three = load_robot("kuka_lwr4"), load_robot("3r_friction")
    vertical = [hidden("encoder_offset", 1)]
    contents = {
        "B": {"schema": "torchid.study/1"},
        "C": {"schema": "torchid.gap/0"},
        "E": diagnosis(robot),
        "F": diagnosis(three, which=[]),
        "G": diagnosis(three, which=[], not_testable=vertical),
    }
    for name, data in contents.items():
        (tmp_path / name).write_text(json.dumps(data))
    (tmp_path / "D").write_text("no json")
    given = {name: tmp_path / name for name in (*contents, "D")} | {"A": results[0]}
    robot_argument = ["3r_friction"] if set(arguments) & set("EFG") else []
    done = command(
        "excite", *robot_argument, *(given.get(a, a) for a in arguments), "--out", tmp_path / "n"
    )
    assert done.code == 1
    assert message in " ".join(done.err.split())
    assert not (tmp_path / "n" / "trajectory.csv").exists()
