"""Whole comparisons: level, power, and what is said of standard deviations that are too small."""

import json
from pathlib import Path

import pytest
import torch

import torchid
from tests.fleet.records import EFFECTS, identification, several
from torchid.errors import TorchidError
from torchid.fleet.compare import compare_results
from torchid.fleet.torque import common_motion
from torchid.identification.model import model_torque
from torchid.identification.result import Identification
from torchid.report.compare import verdict
from torchid.robot.library import load_robot


def test_honest_results_agree(tmp_path):
    found = compare_results(several(tmp_path, 3))
    assert not found.having("differ")
    assert "0 differ" in verdict(found)
    # The mean is known better than any result, and is where they are.
    for p in found.parameters:
        assert p.std < p.own_std.min()
        assert p.own.min() <= p.mean <= p.own.max()


def test_a_parameter_that_changed_is_named_and_no_other(tmp_path):
    paths = [
        several(tmp_path, 1, first=k, change={"Fv2": 12.0 * k})[0].rename(tmp_path / f"{k}.json")
        for k in range(3)
    ]
    found = compare_results(paths)
    (changed,) = found.having("differ")
    assert changed.name == "Fv2"
    assert changed.between == pytest.approx(float(changed.own.std()), rel=0.05)
    low, high = changed.between_ci95
    assert 0 < low < changed.between < high
    assert "1 differs" in verdict(found)
    assert "Fv2" in verdict(found)


def test_too_small_claims_widen_the_spread_and_are_said(tmp_path):
    found = compare_results(several(tmp_path, 4, claimed=1 / 5))
    assert "the standard deviations of single results are too small" in verdict(found)
    # Together with what is claimed the spread is the true standard deviation, five claims.
    total = [(p.between**2 + float(p.own_std.square().mean())) for p in found.parameters]
    claims = [float(p.own_std.square().mean()) for p in found.parameters]
    ratio = torch.tensor(total) / torch.tensor(claims)
    assert float(ratio.mean().sqrt()) == pytest.approx(5, rel=0.2)


def test_torque_differences_are_those_of_the_models(tmp_path):
    paths = several(tmp_path, 2)
    found = compare_results(paths)
    robot = load_robot("3r_friction")
    motion = common_motion(robot, None, 0, None, None)
    tau = []
    for record in map(torchid.load, paths):
        model = robot, record.base, record.placed, record.values
        tau.append(torch.cat([model_torque(*model, part) for part in motion.motions]))
    expected = ((tau[0] - tau[1]).square() / 2).mean(0).sqrt()
    torch.testing.assert_close(found.torque.spread, expected)
    torch.testing.assert_close(found.torque.size, torch.stack(tau).mean(0).square().mean(0).sqrt())
    assert 0.3 < float(found.torque.spread.norm() / found.torque.claimed.norm()) < 3


def test_what_results_do_not_have_in_common_is_said(tmp_path):
    one = identification(tmp_path / "a.json", 0, effects=(*EFFECTS, "rotor_inertia"))
    found = compare_results([one, identification(tmp_path / "b.json", 0)])
    assert any("without rotor_inertia" in note for note in found.notes)
    assert any("'run 0'" in note for note in found.notes)
    assert [p.name for p in found.having("not_compared")] == ["Ia3"]


def test_what_stands_at_a_bound_is_said(tmp_path):
    one, two = several(tmp_path, 2)
    data = json.loads(two.read_text())
    data["bounded"] = ["Fc2", "Fv1"]
    two.write_text(json.dumps(data))
    notes = compare_results([one, two]).notes
    assert [n for n in notes if "bound" in n] == [
        "b: fitted at the bound of physics, 0: Fc2 and Fv1"
    ]


def test_without_the_robot_there_is_no_torque(tmp_path):
    paths = several(tmp_path, 2, model=False)
    found = compare_results(paths)
    assert found.torque is None
    assert any("`robot=" in note for note in found.notes)
    assert compare_results(paths, robot="3r_friction").torque
    with pytest.raises(TorchidError, match="needs the robot"):
        compare_results(paths, on=torchid.Log([0.0, 0.1], [[0.1] * 3, [0.2] * 3]))


def test_a_base_parameter_of_no_parameter_is_refused(tmp_path):
    paths = several(tmp_path, 2)
    data = json.loads(paths[1].read_text())
    data["base_names"][0] = ""
    paths[1].write_text(json.dumps(data))
    with pytest.raises(TorchidError, match="not a complete identification"):
        compare_results(paths)


def test_the_record_is_json_and_is_read_back(tmp_path):
    found = compare_results(several(tmp_path, 3))
    found.save(tmp_path / "compare.json")
    data = json.loads((tmp_path / "compare.json").read_text())
    assert data["schema"] == "torchid.compare/2"
    assert data["results"] == ["a", "b", "c"]
    assert torchid.load(tmp_path / "compare.json").plain() == found.plain() == data


@pytest.fixture(scope="module")
def runs() -> list[Identification]:
    robot = torchid.load_robot("3r")
    motion = torchid.excite(robot, duration=10.0, restarts=1, iterations=0).log()
    settings = torchid.Settings(effects=(), cutoff=10.0)
    logs = [torchid.simulate(robot, motion, seed=k) for k in (1, 2)]
    return [torchid.identify(robot, log, settings=settings) for log in logs]


def test_files_and_objects_compare_alike(runs: list[Identification], tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("monday.json", "tuesday.json")]
    for file, run in zip(files, runs, strict=True):
        run.save(file)
    ours, read, mixed = (
        compare_results(given).plain() for given in (runs, files, [runs[0], files[1]])
    )
    assert ours.pop("results") == ["result 1", "result 2"]
    assert read.pop("results") == ["monday", "tuesday"]
    assert mixed.pop("results") == ["result 1", "tuesday"]
    for one in (ours, read, mixed):
        assert "both fitted on a trajectory called" in one.pop("notes")[0]  # by their labels
    assert ours == read == mixed


def test_a_log_is_what_torque_is_compared_on(runs: list[Identification]) -> None:
    robot = runs[0].robot
    motion = torchid.excite(robot, duration=6.0, restarts=1, iterations=0, seed=9).log()
    found = compare_results(runs, on=torchid.simulate(robot, motion, seed=3))
    assert found.torque is not None
    assert found.torque.errors is not None
    assert bool((found.torque.spread < 0.1 * found.torque.size).all())
    assert torch.isfinite(found.torque.size).all()
