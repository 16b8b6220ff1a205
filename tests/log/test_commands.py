"""Commands beside positions, as other programs log them: under other names, on another clock."""

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from torchid.errors import LogError
from torchid.log.commands import commands_along, held_commands
from torchid.log.model import Log
from torchid.log.readers import read_log

from .recordings import JOINT_STATE, START_NS, write_lerobot

JOINTS = ("shoulder", "elbow")
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
T = 0.02 * np.arange(100)
Q = np.stack([np.sin(T), 0.5 * np.cos(3 * T)], 1)
U = np.stack([np.sin(T + 0.1), 0.5 * np.cos(3 * T + 0.1)], 1)


def log_of(read: Log) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    assert read.u is not None
    return read.t.numpy(), read.q.numpy(), read.u.numpy()


# One clock: names of columns.


@pytest.mark.parametrize("name", ["u{}", "q_cmd{}", "goal_{}", "action{}", "joint_{}_target"])
def test_columns_of_commands(tmp_path: Path, name: str) -> None:
    header = ["t", "q1", "q2", name.format(1), name.format(2)]
    rows = "\n".join(",".join(map(repr, map(float, r))) for r in np.column_stack([T, Q, U]))
    (tmp_path / "run.csv").write_text(",".join(header) + "\n" + rows)
    read = read_log(tmp_path / "run.csv")
    for found, true in zip(log_of(read), (T, Q, U), strict=True):
        assert np.array_equal(found, true)
    said = [w for w in read.warnings if "by the name" in w]
    assert len(said) == (name != "u{}")


@pytest.mark.parametrize("name", ["u", "q_cmd", "goal", "action"])
def test_arrays_of_commands(tmp_path: Path, name: str) -> None:
    np.savez(tmp_path / "run.npz", **{"t": T, "q": Q, name: U})
    assert np.array_equal(log_of(read_log(tmp_path / "run.npz"))[2], U)


def test_what_is_not_taken_for_commands(tmp_path: Path) -> None:
    # Of other joints; beside torques; two that may be meant; and what the mapping leaves out.
    np.savez(tmp_path / "a.npz", t=T, q=Q, action=np.zeros((len(T), 7)))
    np.savez(tmp_path / "b.npz", t=T, q=Q, tau=Q, q_des=U)
    np.savez(tmp_path / "c.npz", t=T, q=Q, q_des=U, goal=U)
    np.savez(tmp_path / "d.npz", t=T, q=Q, q_des=U)
    for name in "abc":
        assert read_log(tmp_path / f"{name}.npz").u is None, name
    assert read_log(tmp_path / "d.npz", columns="u=none").u is None
    read = read_log(tmp_path / "c.npz", columns="u=goal deg")
    assert np.allclose(log_of(read)[2], np.radians(U))


def test_commands_in_degrees_are_proposed_as_such(tmp_path: Path) -> None:
    rows = np.column_stack([T, 40 * Q, 40 * U])
    text = "time,pos_1,pos_2,cmd_1,cmd_2\n" + "\n".join(",".join(map(str, r)) for r in rows)
    (tmp_path / "run.csv").write_text(text)
    with pytest.raises(LogError) as info:
        read_log(tmp_path / "run.csv")
    assert "t=time,q=pos_{j} deg,u=cmd_{j} deg" in (info.value.hint or "")


def test_lerobot(tmp_path: Path) -> None:
    log = Log(t=torch.from_numpy(T), q=torch.from_numpy(Q))
    names = [f"{j}.pos" for j in JOINTS]
    features = {"observation.state": (names, Q), "action": (names, U)}
    path = write_lerobot(tmp_path / "set", "v3.0", log, features)
    assert np.allclose(log_of(read_log(path))[2], U, atol=1e-6)


# Two clocks.


def test_the_nearest_earlier_command_is_held() -> None:
    sent = np.array([0.5, 0.105, 0.0])
    found = held_commands(
        np.array([0.0, 0.1, 0.2, 0.5, 0.6]), sent, np.array([[3.0], [2.0], [1.0]]), "log"
    )
    assert found.u[:, 0].tolist() == [1.0, 1.0, 2.0, 3.0, 3.0]
    assert found.rows.all()
    assert found.warnings == ()


def test_late_and_missing_commands_are_told() -> None:
    sent = np.concatenate([T[10:40], T[70:]])
    u = np.interp(sent, T, Q[:, 0])[:, None]
    u[5] = np.nan
    found = held_commands(T, sent, u, "'run'")
    assert found.rows.tolist() == [False] * 10 + [True] * 90
    assert found.u[15, 0] == Q[14, 0]  # the one without a value is no command
    assert np.array_equal(found.u[40:70, 0], np.full(30, Q[39, 0]))
    assert found.warnings == (
        "'run': the first command comes 0.2 s after the first position: the 10 positions before it "
        "are left out.",
        "'run': 1 of 60 commands have no value: the one before is held.",
        "'run': commands pause 1 times, at most for 0.62 s (at 0.78 s; they come every 0.02 s): "
        "the one before is held.",
    )
    ended = held_commands(T, T[:20], Q[:20], "'run'")
    assert "commands pause 1 times, at most for 1.6 s (at 0.38 s" in ended.warnings[0]


@pytest.mark.parametrize("apart", [-5.0, 5.0])
def test_two_clocks_that_do_not_meet(apart: float) -> None:
    with pytest.raises(LogError, match="not recorded at the same time") as info:
        held_commands(T, T + apart, U, "'run'")
    assert "positions from 0 to 1.98 s" in (info.value.got or "")
    with pytest.raises(LogError, match="has no commands"):
        held_commands(T, T, np.full_like(U, np.nan), "'run'")


def test_set_points_along_trajectories() -> None:
    """A first one of two points, another begun before its end, and one that jumps."""
    t = np.arange(0.0, 2.0, 0.1)
    trajectories = [
        (1.0, np.array([0.5]), np.array([[0.0]])),
        (0.25, np.array([0.5, 1.0]), np.array([[1.0], [3.0]])),
        (1.65, np.array([0.0]), np.array([[7.0]])),
    ]
    found = commands_along(t, np.full((len(t), 1), 0.4), trajectories, "log")
    assert found.rows.tolist() == (t >= 0.25).tolist()
    # From the position 0.4 to 1 at 0.75 s, on towards 3, turned at 1 s where it is 2.
    expected = np.interp(
        t, [0.25, 0.75, 1.0, 1.5, 1.65, 1.65 + 1e-9], [0.4, 1.0, 2.0, 0.0, 0.0, 7.0]
    )
    assert np.allclose(found.u[3:, 0], expected[3:])


# Folders of SAGE.


def write_sage(path: Path, joints: tuple[str, ...] = JOINTS, control: Any = U) -> Path:
    path.mkdir()
    (path / "joint_list.txt").write_text("\n".join(joints) + "\n")
    with open(path / "state_motor.csv", "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["type", "timestamp", "positions", "velocities", "torques"])
        for t, q in zip(T, Q, strict=True):
            writer.writerow(["STATE_MOTOR", 1e6 * t, q.tolist(), [0, 50], [3, 1]])
    if control is not None:
        with open(path / "control.csv", "w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["type", "timestamp", "positions"])
            for t, u in zip(T, control, strict=True):
                writer.writerow(["CONTROL", 1e6 * t + 4000, u.tolist()])
    events = "type,timestamp,event\nEVENT,0,MOTION_START\nEVENT,1850000.0,DISABLE\n"
    (path / "event.csv").write_text(events)
    return path


def test_sage(tmp_path: Path) -> None:
    read = read_log(write_sage(tmp_path / "wave"), joints=("elbow", "shoulder"))
    t, q, u = log_of(read)
    # A command comes 4 ms after its position, so the first position has none; motors off at 1.85 s.
    assert read.names == ("wave",)
    assert np.allclose(t, T[:92])
    assert np.array_equal(q, Q[1:93, ::-1])
    assert np.array_equal(u, U[:92, ::-1])
    assert read.dq is None
    assert read.tau is None
    said = " ".join(read.warnings)
    assert "the 1 positions before it are left out" in said
    assert "7 positions after the motors were switched off" in said
    assert "velocities and torques are left aside" in said
    whole = read_log(tmp_path / "wave", columns="tau=torques mNm")
    assert whole.tau is not None
    assert torch.allclose(whole.tau[0], torch.tensor([3e-3, 1e-3], dtype=torch.float64))


def test_sage_without_names_or_commands(tmp_path: Path) -> None:
    other = read_log(write_sage(tmp_path / "a", ("Pan", "Lift")), joints=JOINTS)
    assert "do not have the robot's names; taken in the order of the file: Pan, Lift" in " ".join(
        other.warnings
    )
    alone = read_log(write_sage(tmp_path / "b", control=None))
    assert alone.u is None
    assert "no control.csv: positions without commands" in " ".join(alone.warnings)
    with pytest.raises(LogError, match="different joints"):
        read_log(write_sage(tmp_path / "c", control=U[:, :1]))
    (tmp_path / "a" / "state_motor.csv").write_text("timestamp,positions\n1,2\n2,3\n")
    with pytest.raises(LogError, match="column positions does not hold lists"):
        read_log(tmp_path / "a")


# ROS 2.


def write_bag(path: Path, kind: str, topics: dict[str, tuple[str, list[tuple[int, Any]]]]) -> Path:
    """Messages (when received [ns], fields) of each topic with its type."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        for topic, (name, messages) in topics.items():
            connection = writer.add_connection(topic, name, typestore=store)
            for received, fields in messages:
                raw = store.serialize_cdr(_message(store.types, name, **fields), name)
                writer.write(connection, received, raw)
    return path


def _message(types: Any, name: str, stamp: int, joints: Any, position: Any, after: Any = ()) -> Any:
    time = types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
    header = types["std_msgs/msg/Header"](stamp=time, frame_id="")
    empty = np.zeros(0)
    if name == JOINT_STATE:
        values = np.array(position, dtype=np.float64, order="C")
        return types[name](
            header=header, name=list(joints), position=values, velocity=empty, effort=empty
        )
    points = [
        types["trajectory_msgs/msg/JointTrajectoryPoint"](
            positions=np.array(x, dtype=np.float64, order="C"),
            velocities=empty,
            accelerations=empty,
            effort=empty,
            time_from_start=types["builtin_interfaces/msg/Duration"](
                sec=int(s), nanosec=round(1e9 * (s % 1))
            ),
        )
        for s, x in zip(after, position, strict=True)
    ]
    return types[name](header=header, joint_names=list(joints), points=points)


def stamped(t: np.ndarray, values: np.ndarray, joints: Any, late: float = 0.001) -> list[Any]:
    """Joint states received a little after their stamps."""
    return [
        (ns + round(1e9 * late), {"stamp": ns, "joints": joints, "position": x})
        for s, x in zip(t, values, strict=True)
        for ns in [START_NS + round(1e9 * s)]
    ]


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
@pytest.mark.parametrize("zero", [False, True])
def test_joint_trajectories(tmp_path: Path, kind: str, zero: bool) -> None:
    """Points sent every 40 ms, to be reached at once, by a node that stamps them or does not."""
    sent = [
        (
            START_NS + round(1e9 * (t + 0.011)),
            {
                "stamp": 0 if zero else START_NS + round(1e9 * (t + 0.01)),
                "joints": JOINTS[::-1],
                "position": [x[::-1]],
                "after": [0.0],
            },
        )
        for t, x in zip(T[::2], U[::2], strict=True)
    ]
    topics = {
        "/joint_states": (JOINT_STATE, stamped(T, Q, JOINTS)),
        "/arm_controller/joint_trajectory": (TRAJECTORY, sent),
    }
    path = write_bag(tmp_path / "bag", kind, topics)
    read = read_log(path, joints=JOINTS)
    t, q, u = log_of(read)
    assert np.allclose(t, T[:-1], atol=1e-6)
    assert np.array_equal(q, Q[1:])
    assert np.allclose(u, np.repeat(U[::2], 2, axis=0)[:-1])
    (said,) = read.warnings
    assert "the first command comes 0.02 s after the first position" in said
    assert read_log(path, joints=JOINTS, columns="u=none").samples == len(T)


def test_a_leader_arm(tmp_path: Path) -> None:
    """Teleoperation of a small arm: the leader's positions are the follower's commands."""
    topics = {
        "/follower/joint_states": (JOINT_STATE, stamped(T, Q, JOINTS)),
        "/leader/joint_states": (JOINT_STATE, stamped(T - 0.01, U, JOINTS)),
    }
    path = write_bag(tmp_path / "bag", "mcap", topics)
    with pytest.raises(LogError, match="several topics") as info:
        read_log(path, joints=JOINTS)
    assert info.value.hint == 'choose one: `topic="/follower/joint_states"`'
    t, q, u = log_of(read_log(path, topic="/follower/joint_states", joints=JOINTS))
    assert np.allclose(t, T, atol=1e-6)
    assert np.array_equal(q, Q)
    assert np.array_equal(u, U)


def test_a_topic_named_for_commands(tmp_path: Path) -> None:
    """Two that may be meant; one with a clock of its own; one of another arm."""
    other = stamped(T, U, JOINTS)
    for _, fields in other:
        fields["stamp"] -= 80 * 10**9
    topics = {
        "/arm": (JOINT_STATE, stamped(T, Q, JOINTS)),
        "/cmd/a": (JOINT_STATE, other),
        "/cmd/b": (JOINT_STATE, stamped(T, 2 * U, JOINTS)),
        "/hand/cmd": (JOINT_STATE, stamped(T, U, ("left", "right"))),
    }
    path = write_bag(tmp_path / "bag", "mcap", topics)
    none = read_log(path, topic="/arm", joints=JOINTS)
    assert none.u is None
    assert (
        'several topics of commands: /cmd/a, /cmd/b; say which: `columns="u=/cmd/a"`'
        in " ".join(none.warnings)
    )
    b = read_log(path, topic="/arm", joints=JOINTS, columns="u=/cmd/b")
    assert np.array_equal(log_of(b)[2], 2 * U)
    a = read_log(path, topic="/arm", joints=JOINTS, columns="u=/cmd/a deg")
    assert np.allclose(log_of(a)[2], np.radians(U))
    assert "stamps are of another clock than the positions', 80 s apart" in " ".join(a.warnings)
    with pytest.raises(LogError, match="commands other joints"):
        read_log(path, topic="/arm", joints=JOINTS, columns="u=/hand/cmd")
