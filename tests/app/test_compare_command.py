"""`torchid compare` and `torchid excite --for` from the outside."""

import json

import pytest

from tests.fleet.records import several
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
