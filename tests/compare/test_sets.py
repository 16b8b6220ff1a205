"""Files of physical sets compared."""

import json

import pytest
import torch

from tests.export.arms import write_urdf
from torchid.compare.reading import read_results
from torchid.compare.sets import compare_sets, robot_of
from torchid.errors import TorchidError
from torchid.feasibility.sets import ParameterSets, nominal_set, sets_record
from torchid.report.compare import set_verdict
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot


def sets(path, *, mass=0.0, spread=0.01, count=5, seed=0):
    """The 3R's parameters with noise of a share of each; link 2 heavier by `mass` [kg]."""
    robot = load_robot("3r")
    generator = torch.Generator().manual_seed(seed)
    pi = robot.parameters.pi.double()
    noise = torch.randn(count, *pi.shape, generator=generator, dtype=torch.float64)
    pi = pi * (1 + spread * noise)
    pi[:, 1, 0] += mass
    ids = tuple(f"p_{k}" for k in range(count))
    made = ParameterSets(ids, InertialParameters(pi), (), pi.new_zeros(count, 0))
    path.write_text(json.dumps(sets_record(made, robot).plain()))
    return path


def test_ranges_torque_and_record(tmp_path):
    paths = [sets(tmp_path / f"{k}.json", mass=k, seed=k) for k in range(3)]
    results = read_results(paths)
    found = compare_sets(results, robot_of(results))
    by_name = {r.name: r for r in found.physical}
    assert by_name["m2"].verdict == "drift"
    assert by_name["m3"].verdict == "agree"
    assert found.counts == (5, 5, 5)
    robot = load_robot("3r")
    pi = robot.parameters.pi.double().clone()
    gravity = robot.gravity.norm()
    assert float(found.torque.pairs[0, 2].max()) < 2 * float(gravity) * 3
    assert pi[1, 0] < float(by_name["m2"].low[2])
    data = json.loads(json.dumps(found.plain(), allow_nan=False))
    assert data["compared"] == "parameter sets"
    assert "in the order given" in set_verdict(found)


def test_the_robot_of_a_file_is_found_again(tmp_path):
    folder = tmp_path / "robot"
    folder.mkdir()
    urdf = write_urdf(folder)
    robot = load_robot(urdf)
    for name in "ab":
        (tmp_path / f"{name}.json").write_text(
            json.dumps(sets_record(nominal_set(robot), robot).plain())
        )
    results = read_results([tmp_path / "a.json", tmp_path / "b.json"])
    assert robot_of(results).source == str(urdf)
    urdf.rename(folder / "other.urdf")
    with pytest.raises(TorchidError, match="`robot="):
        robot_of(results)


def test_open_parameters_and_equal_files(tmp_path):
    a, b = (
        sets(tmp_path / "a.json", spread=2.0, count=40),
        sets(tmp_path / "b.json", spread=2.0, count=40),
    )
    found = compare_sets(read_results([a, b]), load_robot("3r"))
    assert all(r.verdict in ("never_determined", "agree") for r in found.physical)
    assert sum(r.verdict == "never_determined" for r in found.physical) > 10
    assert float(found.torque.spread.max()) == pytest.approx(0, abs=1e-9)
