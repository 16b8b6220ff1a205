"""LeRobot datasets: episodes, time, and which part of the state is which."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
import torch

from torchid.errors import LogError
from torchid.log.model import Log
from torchid.log.readers import read_log

from .examples import uniform
from .recordings import write_lerobot

ARM = ["shoulder", "elbow", "wrist"]
DEG = np.pi / 180


@pytest.fixture
def log() -> Log:
    parts = [uniform(3, samples=60 + 10 * k, step=0.02) for k in range(3)]
    return Log.concatenate(parts)


def with_gripper(signal: torch.Tensor) -> np.ndarray:
    return torch.cat([signal, 50 + signal[:, :1]], 1).numpy()


def close(a: torch.Tensor, b: torch.Tensor) -> bool:
    """As close as the float32 of a dataset allows."""
    return torch.allclose(a, b, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
@pytest.mark.parametrize("nested", [False, True])
def test_episodes_are_trajectories(tmp_path: Path, log: Log, version: str, nested: bool) -> None:
    names = [f"{name}.pos" for name in (*ARM, "gripper")]
    features = {
        "observation.state": (names, with_gripper(log.q)),
        "observation.effort": ([*ARM, "gripper"], with_gripper(log.signals["tau"])),
        "action": (names, with_gripper(log.q + 1)),
    }
    path = write_lerobot(tmp_path / "set", version, log, features)
    if nested:
        info = json.loads((path / "meta" / "info.json").read_text())
        for name in features:
            info["features"][name]["names"] = {"motors": info["features"][name]["names"]}
        (path / "meta" / "info.json").write_text(json.dumps(info))
    read = read_log(path, joints=("elbow", "shoulder", "wrist"))
    order = [1, 0, 2]
    assert read.names == ("set[traj=0]", "set[traj=1]", "set[traj=2]")
    assert torch.equal(read.trajectory, log.trajectory)
    for part in read.trajectories():
        assert torch.allclose(
            part.t, 0.02 * torch.arange(part.samples, dtype=torch.float64), rtol=1e-15
        )
    assert close(read.q, log.q[:, order])
    assert read.u is not None
    assert close(read.u, log.q[:, order] + 1)
    assert close(read.signals["tau"], log.signals["tau"][:, order])
    assert read.dq is None
    (left_out, warning) = read.warnings
    assert left_out.endswith("left out: gripper")
    assert "taken for radians" in warning
    whole = read_log(path)
    assert whole.n == 4


def test_everything_in_the_state(tmp_path: Path, log: Log) -> None:
    """Positions, velocities and torques of one vector, told by the ends of their names."""
    kinds = {".pos": log.q, ".vel": log.signals["dq"], ".effort": log.signals["tau"]}
    names = [f"{name}{ending}" for name in ARM for ending in kinds]
    values = torch.stack(list(kinds.values()), -1).flatten(1).numpy()
    path = write_lerobot(tmp_path / "set", "v3.0", log, {"observation.state": (names, values)})
    read = read_log(path, joints=ARM)
    assert close(read.q, log.q)
    assert close(read.signals["dq"], log.signals["dq"])
    assert close(read.signals["tau"], log.signals["tau"])


@pytest.mark.parametrize(
    "text",
    [
        "q=observation.state[:,0:3] deg",
        "q=[observation.state.shoulder, observation.state.elbow, observation.state.wrist] deg",
    ],
)
def test_mapping(tmp_path: Path, log: Log, text: str) -> None:
    features = {"observation.state": ([*ARM, "gripper"], with_gripper(log.q / DEG))}
    path = write_lerobot(tmp_path / "set", "v3.0", log, features)
    read = read_log(path, columns=text, joints=("a", "b"))
    assert close(read.q, log.q)
    assert read.trajectory_count == 3
    assert read.warnings == ()


def test_a_state_without_names(tmp_path: Path, log: Log) -> None:
    features = {"observation.state": (None, log.q.numpy())}
    path = write_lerobot(tmp_path / "set", "v3.0", log, features)
    assert close(read_log(path, joints=("a", "b", "c")).q, log.q)
    assert close(read_log(path).q, log.q)


def test_what_is_wrong_with_it(tmp_path: Path, log: Log) -> None:
    features = {"observation.state": (ARM, log.q.numpy())}
    path = write_lerobot(tmp_path / "set", "v3.0", log, features)
    with pytest.raises(LogError, match="no column 'nothing'") as info:
        read_log(path, columns="q=nothing")
    assert "observation.state (? x 3)" in (info.value.available or ())
    file = path / "data" / "chunk-000" / "file-000.parquet"
    table = pyarrow.parquet.read_table(file)
    pyarrow.parquet.write_table(table.drop_columns("frame_index"), file)
    with pytest.raises(LogError, match="no column frame_index"):
        read_log(path)
    file.write_bytes(file.read_bytes()[:1000])
    with pytest.raises(LogError, match="is damaged"):
        read_log(path)
    file.unlink()
    with pytest.raises(LogError, match="no parquet files"):
        read_log(path)
    for content in ("{", "{}", '{"fps": 0, "features": {}}', '{"fps": 30, "features": 3}'):
        (path / "meta" / "info.json").write_text(content)
        with pytest.raises(LogError, match="cannot be used"):
            read_log(path)


def test_no_state(tmp_path: Path, log: Log) -> None:
    path = write_lerobot(tmp_path / "set", "v3.0", log, {"action": (ARM, log.q.numpy())})
    with pytest.raises(LogError, match="no column q1") as info:
        read_log(path)
    assert "action (? x 3)" in (info.value.available or ())


@pytest.mark.parametrize("ending", ["", ".pos"], ids=["aloha", "bimanual"])
def test_two_arms_are_found_by_their_names(tmp_path: Path, ending: str) -> None:
    arm = ["waist", "elbow", "wrist", "gripper"]
    names = [f"{side}_{joint}{ending}" for side in ("left", "right") for joint in arm]
    both = uniform(8, samples=60, step=0.02)
    path = write_lerobot(
        tmp_path / "two", "v3.0", both,
        {"observation.state": (names, both.q.numpy()), "action": (names, both.q.numpy() + 1)},
    )  # fmt: skip
    robot = tuple(f"{side}/{joint}" for side in ("right", "left") for joint in arm[:3])
    read = read_log(path, joints=robot)
    order = [4, 5, 6, 0, 1, 2]
    assert close(read.q, both.q[:, order])
    assert close(read.signals["u"], both.q[:, order] + 1)
    assert any("left out: left_gripper, right_gripper" in w for w in read.warnings)
    # One arm is not to be guessed; an order of elements chooses it, a gripper in its own unit.
    with pytest.raises(LogError, match="which elements of") as raised:
        read_log(path, joints=("waist", "elbow", "wrist"))
    assert "observation.state[:,0:3]" in str(raised.value)
    text = "q=observation.state[:,4:8] *[1,1,1,0.044],u=action[:,4:8] *[1,1,1,0.044]"
    right = read_log(path, columns=text)
    assert close(right.q[:, 3], 0.044 * both.q[:, 7])


SO101 = ["shoulder_pan", "shoulder_lift", "elbow_flex", "gripper"]
ASKED = 'columns="q=observation.state[:,0:4] deg,u=action[:,0:4] deg"'


def bus_servos(
    path: Path, log: Log, scale: float, kind: str, ending: str, unit: object = None
) -> Path:
    """A dataset of an arm of bus servos, whose largest position is `scale` of the arm's joints."""
    q = scale * log.q / log.q.abs().max()
    values = np.concatenate([q.numpy(), 0 * q.numpy()[:, :1] + 30.0], 1)
    names = [f"{name}{ending}" for name in SO101]
    features = {"observation.state": (names, values), "action": (names, values + 1.0)}
    write_lerobot(path, "v3.0", log, features)
    info = json.loads((path / "meta" / "info.json").read_text()) | {"robot_type": kind}
    if unit is not None:
        info["features"]["observation.state"]["unit"] = unit
    (path / "meta" / "info.json").write_text(json.dumps(info))
    return path


@pytest.mark.parametrize(
    ("scale", "kind", "ending", "unit", "factor", "said"),
    [
        (90.0, "so100", "", None, DEG, "taken for degrees"),  # as drivers recorded at first
        (130.0, "so101_follower", ".pos", None, DEG, "taken for degrees"),
        (1.5, "so101_follower", ".pos", None, 1.0, "taken for radians"),
        (90.0, "so101_follower", ".pos", "degrees", DEG, "as meta/info.json says"),
        (90.0, "so101_follower", ".pos", "rad", 1.0, "as meta/info.json says"),
        (90.0, "another_arm", ".pos", None, 1.0, "taken for radians"),
    ],
)  # fmt: skip
def test_units_are_what_the_dataset_says(
    tmp_path: Path, log: Log, scale: float, kind: str, ending: str, unit: object, factor: float,
    said: str,
) -> None:  # fmt: skip
    read = read_log(bus_servos(tmp_path / "set", log, scale, kind, ending, unit))
    assert float(read.q[:, :3].abs().max()) == pytest.approx(factor * scale)
    assert read.u is not None
    assert close(read.u, read.q + factor)
    assert any(said in warning for warning in read.warnings)


def test_a_unit_that_nothing_tells_is_asked_for(tmp_path: Path, log: Log) -> None:
    """Degrees and -100 .. 100 of the calibrated range look alike: the line to paste settles it."""
    path = bus_servos(tmp_path / "set", log, 90.0, "so101_follower", ".pos")
    with pytest.raises(LogError, match="does not say") as refused:
        read_log(path)
    assert ASKED in str(refused.value)
    read = read_log(path, columns=ASKED.split('"')[1])
    assert float(read.q[:, :3].abs().max()) == pytest.approx(90.0 * DEG)


@pytest.mark.parametrize(
    ("kind", "servos"),
    [
        ("so101_follower", "STS3215"),
        ("bi_so100_follower", "STS3215"),
        ("koch_follower", "XL430-W250,XL430-W250,XL330-M288,XL330-M288"),
        ("another_arm", ""),
    ],
)
def test_servos_are_those_of_the_driver(tmp_path: Path, log: Log, kind: str, servos: str) -> None:
    path = bus_servos(tmp_path / "set", log, 1.5, kind, ".pos")
    read = read_log(path)
    assert read.servos == servos
    assert read.trajectories()[0].servos == servos
    assert Log.concatenate([read, read]).servos == servos
    assert Log.concatenate([read, read.replace(servos="XM430")]).servos == ""
    # Columns that are said have no names: one type is known all the same.
    said = read_log(path, columns="q=observation.state[:,0:4],u=action[:,0:4]")
    assert said.servos == ("" if "," in servos else servos)
