"""Results in memory and in files: the comparison is the same."""

from pathlib import Path

import pytest
import torch

import torchid
from torchid.compare.results import compare_results
from torchid.errors import TorchidError
from torchid.identification.result import Identification
from torchid.json_data import write_json


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
        write_json(run.plain(), file)
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


def test_one_result_is_no_comparison(runs: list[Identification]) -> None:
    with pytest.raises(TorchidError, match="two results or more"):
        compare_results(runs[:1])
