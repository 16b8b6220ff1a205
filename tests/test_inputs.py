"""Whatever is a robot or a log is taken wherever one is asked for."""

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import torch

import torchid
from torchid.log.model import Log
from torchid.robot.model import Robot

pd = pytest.importorskip("pandas")

ROBOTS = {"robot", "nominal", "original"}
LOGS = {
    "log",
    "logs",
    "held_out",
    "motion",
    "empty",
    "loaded",
    "simulated",
    "real",
    "untouched",
    "on",
}
SETTINGS = torchid.Settings(effects=(), cutoff=10.0)


@pytest.fixture(scope="module")
def log() -> Log:
    robot = torchid.load_robot("3r")
    motion = torchid.excite(robot, duration=4.0, restarts=1, iterations=0).log()
    return torchid.simulate(robot, motion, seed=1)


def _same(found: Log, log: Log) -> bool:
    both = zip(found.signals.items(), log.signals.items(), strict=True)
    return bool(torch.equal(found.t, log.t)) and all(
        a == b and bool(torch.equal(x, y)) for (a, x), (b, y) in both
    )


@pytest.mark.parametrize(
    "made",
    [
        lambda log, _: log,
        lambda log, _: log.to_frame(),
        lambda log, _: pa.Table.from_pandas(log.to_frame()),
        lambda log, _: {"t": log.t, "q": log.q, "tau": log.tau, "dq": None},
        lambda log, _: {"t": log.t.numpy(), "q": log.q.tolist(), "tau": log.tau.numpy()},
        lambda log, _: {name: log.to_frame()[name].to_list() for name in log.to_frame()},
        lambda log, file: file,
        lambda log, file: str(file),
        lambda log, file: [file],
        lambda log, file: iter([log.to_frame()]),
    ],
)  # fmt: skip
@pytest.mark.usefixtures("types_unchecked")
def test_every_form_of_a_log_is_the_same_log(
    made: Callable[[Log, Path], Any], log: Log, tmp_path: Path
) -> None:
    file = tmp_path / "run.parquet"
    torchid.write_log(log, file)
    assert _same(torchid.read_log(made(log, file)), log)


def test_several_forms_are_the_trajectories_of_one(log: Log, tmp_path: Path) -> None:
    torchid.write_log(log.to_frame(), tmp_path / "run.csv")
    both = torchid.read_log([log.to_frame(), tmp_path / "run.csv", log])
    assert both.names == ("table 1", "run", log.names[0])
    assert all(_same(one, log) for one in both.trajectories())


def test_other_names_of_columns_are_mapped(log: Log) -> None:
    frame = log.to_frame().rename(columns={f"q{j}": f"pos_{j}" for j in (1, 2, 3)})
    assert _same(torchid.read_log(frame, columns="q=pos_{j}"), log)
    read = torchid.read_log(frame)  # the names leave one way
    assert _same(read, log)
    assert read.warnings == ("'table' is read by the names of its columns: q=pos_{j}",)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (5, "this is no log"),
        (None, "this is no log"),
        ([torch.zeros(3)], "this is no log"),
        (b"run.csv", "this is no log"),
        (np.zeros((3, 2)), "this is no log"),
        (dict, "this is no log"),
        ([], "no log is given"),
        ({"t": [0.0, 1.0], "q": [[1.0], [1.0, 2.0]]}, "column q is no table of numbers"),
        ({"t": [0.0, 1.0], "q1": ["a", "b"]}, "not numeric"),
        ({"q1": [0.0, 1.0]}, "no column t"),
    ],
)
@pytest.mark.usefixtures("types_unchecked")
def test_all_else_is_refused(given: Any, text: str) -> None:
    with pytest.raises(torchid.TorchidError, match=text):
        torchid.read_log(given)


@pytest.mark.usefixtures("types_unchecked")
def test_a_robot_is_its_name_or_file_and_nothing_else(tmp_path: Path) -> None:
    torchid.write_robot("3r", tmp_path / "arm.yaml")
    q = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64)
    wanted = torchid.tool_pose(torchid.load_robot("3r"), q)
    for robot in ("3r", str(tmp_path / "arm.yaml"), tmp_path / "arm.yaml"):
        assert torch.allclose(torchid.tool_pose(robot, q), wanted)
    with pytest.raises(torchid.TorchidError, match="this is no robot"):
        torchid.mass_matrix(3, q)  # type: ignore[arg-type]


def test_identify_of_files_is_that_of_a_robot_and_a_log(log: Log, tmp_path: Path) -> None:
    torchid.write_log(log, tmp_path / "run1.parquet")
    plain = torchid.identify(torchid.load_robot("3r"), log, settings=SETTINGS)
    found = torchid.identify("3r", tmp_path / "run1.parquet", settings=SETTINGS)
    torch.testing.assert_close(found.values, plain.values, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", [n for n in torchid.__all__ if n != "__version__"])
def test_every_public_function_takes_them(name: str) -> None:
    """By its annotations, so that none is forgotten: what asks for a Robot or a Log alone does not
    go through the door."""
    thing = getattr(torchid, name)
    if inspect.isclass(thing):
        return
    for parameter in inspect.signature(thing).parameters.values():
        given = parameter.annotation
        if parameter.name in ROBOTS:
            assert given != Robot, parameter
            assert given != Robot | None, parameter
        if parameter.name in LOGS:
            assert given != Log, parameter
            assert given != Log | None, parameter
