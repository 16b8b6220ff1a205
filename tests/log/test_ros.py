"""Bags: what robots publish, in the order of the robot's joints."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from torchid.errors import LogError
from torchid.log.model import Log
from torchid.log.readers import read_log
from torchid.log.ros import topics_of

from .examples import uniform
from .recordings import BAGS, LATE_NS, START_NS, messages_of, write_bag

UR = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")
ALPHABETICAL = (2, 1, 0)
TOPIC = "/joint_states"
ALL = "position, velocity, effort"


@pytest.fixture
def log() -> Log:
    return uniform(3, samples=60)


def expect(read: Log, log: Log, signals: tuple[str, ...] = ("q", "dq", "tau")) -> None:
    assert tuple(read.signals) == signals
    assert torch.allclose(read.t, log.t - log.t[0], atol=2e-9)
    for name in signals:
        assert torch.equal(read.signals[name], log.signals[name]), name


@pytest.mark.parametrize("kind", BAGS)
def test_every_kind_of_bag(tmp_path: Path, log: Log, kind: str) -> None:
    path = write_bag(tmp_path / "bag", kind, {TOPIC: messages_of(log, UR, ALPHABETICAL)})
    read = read_log(path, joints=UR)
    expect(read, log)
    assert read.warnings == ()
    assert read.names == ("bag",)
    alphabetical = read_log(path)
    assert torch.equal(alphabetical.q, log.q[:, list(ALPHABETICAL)])
    (warning,) = alphabetical.warnings
    assert "order of their names: elbow_joint, shoulder_lift_joint, shoulder_pan" in warning


@pytest.mark.parametrize(("kind", "suffix"), [("sqlite3", ".db3"), ("mcap", ".mcap")])
def test_a_file_of_a_recording_alone(tmp_path: Path, log: Log, kind: str, suffix: str) -> None:
    folder = write_bag(tmp_path / "bag", kind, {TOPIC: messages_of(log, UR, ALPHABETICAL)})
    (file,) = folder.glob(f"*{suffix}")
    expect(read_log(shutil.move(file, tmp_path / f"alone{suffix}"), joints=UR), log)


def test_the_topic_is_chosen(tmp_path: Path, log: Log) -> None:
    fingers = uniform(2, samples=30)
    topics = {
        "/gripper/joint_states": messages_of(fingers, ("left", "right"), (0, 1)),
        "/arm/joint_states": messages_of(log, UR, (0, 1, 2)),
        "/arm/desired": messages_of(log.replace(q=log.q + 1), UR, (0, 1, 2)),
    }
    path = write_bag(tmp_path / "bag", "mcap", topics)
    with pytest.raises(LogError, match="several topics of joint states") as info:
        read_log(path)
    listed = [str(topic) for topic in info.value.available or ()]
    assert listed == [
        f"/arm/desired (sensor_msgs/msg/JointState, 60 messages with {ALL}: {', '.join(UR)})",
        f"/arm/joint_states (sensor_msgs/msg/JointState, 60 messages with {ALL}: {', '.join(UR)})",
        f"/gripper/joint_states (sensor_msgs/msg/JointState, 30 messages with {ALL}: left, right)",
    ]
    assert info.value.hint == 'choose one: `topic="/arm/joint_states"`'
    expect(read_log(path, topic="/arm/joint_states", joints=UR), log)
    with pytest.raises(LogError, match="several topics") as info:
        read_log(path, joints=UR)
    assert len(info.value.available or ()) == 2  # the gripper is not the robot
    assert torch.equal(read_log(path, joints=("right", "left")).q[:, 0], fingers.q[:, 1])
    with pytest.raises(LogError, match="no joint states in topic /arm") as info:
        read_log(path, topic="/arm")
    assert [topic.name for topic in topics_of(path)] == sorted(topics)


@pytest.mark.parametrize("joints", [(), UR, ("a", "b", "c")])
def test_the_topic_with_effort_is_recommended(
    tmp_path: Path, log: Log, joints: tuple[str, ...]
) -> None:
    """A command has no effort; the first measured message has none either."""
    measured = without(messages_of(log, (*UR, "hand")[:3], (2, 0, 1)), "effort", slice(0, 1))
    commands = without(messages_of(log, UR, (0, 1, 2)), "effort", slice(None))
    without(commands, "velocity", slice(None), [np.nan] * 3)
    path = write_bag(
        tmp_path / "bag", "mcap", {"/joint_commands": commands, "/joint_states": measured}
    )
    with pytest.raises(LogError, match="several topics") as info:
        read_log(path, joints=joints)
    assert info.value.hint == 'choose one: `topic="/joint_states"`, the only one with effort'
    first, second = (str(topic) for topic in info.value.available or ())
    assert "messages with position: shoulder" in first
    assert f"messages with {ALL}: elbow" in second
    count = "3 of the robot's 3 joints" if joints == UR else "0 of the robot's 3 joints"
    assert (count in first) == (count in second) == bool(joints)


def test_the_topic_of_more_joints_is_recommended(tmp_path: Path, log: Log) -> None:
    """Neither fits the robot; names tell which of two is measured."""
    topics = {
        "/a/gripper": messages_of(uniform(1, samples=30), ("finger",), (0,)),
        "/a/target": messages_of(log, UR, (0, 1, 2)),
        "/b/measured": messages_of(log, UR, (0, 1, 2)),
    }
    path = write_bag(tmp_path / "bag", "mcap", topics)
    with pytest.raises(LogError, match="several topics") as info:
        read_log(path, joints=(*UR, "wrist_1_joint"))
    assert info.value.hint == 'choose one: `topic="/b/measured"`'
    said = [str(topic).rsplit("; ", 1)[1] for topic in info.value.available or ()]
    assert said == [f"{k} of the robot's 4 joints)" for k in (0, 3, 3)]


def test_a_gripper_in_the_same_topic(tmp_path: Path, log: Log) -> None:
    """In the same message, and in messages of its own that come as often."""
    names = ("finger_joint2", *UR, "finger_joint1")
    wide = Log(t=log.t, **{
        k: torch.cat([9 + v[:, :1], v, 9 + v[:, :1]], 1) for k, v in log.signals.items()
    })  # fmt: skip
    together = messages_of(wide, names, (4, 2, 0, 1, 3))
    fingers = uniform(2, samples=90)
    apart = [*messages_of(log, UR, (2, 1, 0)), *messages_of(fingers, ("jaw1", "jaw2"), (0, 1))]
    for k, messages in enumerate((together, apart)):
        path = write_bag(tmp_path / f"bag{k}", "mcap", {TOPIC: messages})
        read = read_log(path, joints=UR)
        expect(read, log)
        assert any("left out: " in w for w in read.warnings)
        assert read_log(path).n == (5 if k == 0 else 3)


def test_another_joint_in_the_same_topic(tmp_path: Path, log: Log) -> None:
    """A wheel is no joint of the arm; one that is held in the robot's file may be there."""
    wide = Log(t=log.t, **{k: torch.cat([v, v[:, :1]], 1) for k, v in log.signals.items()})
    path = write_bag(tmp_path / "bag", "mcap", {TOPIC: messages_of(wide, (*UR, "wheel"), range(4))})
    with pytest.raises(LogError, match="joints that the robot lacks"):
        read_log(path, joints=UR)
    read = read_log(path, joints=UR, spare=("wheel",))
    expect(read, log)
    assert any("left out: wheel" in w for w in read.warnings)


@pytest.mark.parametrize("late_ns", [0, 3_000_000])
def test_an_arm_in_parts(tmp_path: Path, late_ns: int) -> None:
    """Joints 1 and 3 in one message, joint 2 in another, at the same time or a little later."""
    log = uniform(3, samples=400)
    parts = []
    for joints in ((2, 0), (1,)):
        part = Log(t=log.t, q=log.q[:, list(joints)], tau=log.signals["tau"][:, list(joints)])
        parts.append(messages_of(part, [UR[j] for j in joints], range(len(joints))))
    for k, message in enumerate(parts[1]):
        message["stamp"] += late_ns
        then = log.t[k] + late_ns * 1e-9
        message["position"] = np.array([np.sin(float(then))])
    log = log.replace(q=torch.stack([log.q[:, 0], log.t.sin(), log.q[:, 2]], 1))
    path = write_bag(
        tmp_path / "bag", "sqlite3", {TOPIC: [m for pair in zip(*parts, strict=True) for m in pair]}
    )
    read = read_log(path, joints=UR)
    inside = slice(1, None) if late_ns else slice(None)
    assert torch.allclose(read.q, log.q[inside], atol=1e-4 if late_ns else 0.0)
    assert torch.equal(read.q[:, [0, 2]], log.q[inside][:, [0, 2]])
    assert any("separate messages" in w for w in read.warnings) == (late_ns > 0)
    assert read.samples == 400 - (late_ns > 0)


def without(messages: list, field: str, which: slice, value: object = ()) -> list:
    for message in messages[which]:
        message[field] = np.array(value, dtype=float)
    return messages


@pytest.mark.parametrize(
    ("field", "which", "value", "signals", "samples", "warning"),
    [
        ("effort", slice(None), (), ("q", "dq"), 60, None),
        ("velocity", slice(0, 50), (), ("q", "tau"), 60, "velocity is in 10 of 60"),
        ("effort", slice(0, 7), (), ("q", "dq", "tau"), 53, "7 of 60 messages have no"),
        ("effort", slice(0, 7), (1.0,), ("q", "dq", "tau"), 53, "some of their joints only"),
        ("effort", slice(None), [np.nan] * 3, ("q", "dq"), 60, "NaN throughout"),
        ("position", slice(0, 5), (), ("q", "dq", "tau"), 55, "5 messages without positions"),
    ],
)
def test_arrays_that_are_empty_or_partial(
    tmp_path: Path, log: Log, field, which, value, signals, samples, warning
) -> None:
    messages = without(messages_of(log, UR, (0, 1, 2)), field, which, value)
    read = read_log(write_bag(tmp_path / "bag", "ros1", {TOPIC: messages}), joints=UR)
    assert tuple(read.signals) == signals
    assert read.samples == samples
    assert torch.equal(read.q, log.q[60 - samples :])
    if warning is None:
        assert read.warnings == ()
    else:
        assert any(warning in w for w in read.warnings), read.warnings


def test_every_message_in_another_order(tmp_path: Path, log: Log) -> None:
    orders = [(0, 1, 2), (2, 0, 1), (1, 0, 2)]
    lists = [messages_of(log, UR, order) for order in orders]
    messages = [lists[k % 3][k] for k in range(60)]
    messages.append(dict(messages[-1], stamp=messages[-1]["stamp"] + 10**7))
    for field in ("position", "velocity", "effort"):
        messages[-1][field] = messages[-1][field][:2]
    messages[-1]["name"] = messages[-1]["name"][:2]
    read = read_log(write_bag(tmp_path / "bag", "mcap", {TOPIC: messages}), joints=UR)
    expect(read, log)
    (warning,) = read.warnings
    assert "1 messages with some of the joints are left out" in warning


def test_velocity_in_some_messages_and_effort_in_the_others(tmp_path: Path, log: Log) -> None:
    messages = messages_of(log, UR, (0, 1, 2))
    without(messages, "effort", slice(0, None, 2))
    without(messages, "velocity", slice(1, None, 2))
    read = read_log(write_bag(tmp_path / "bag", "mcap", {TOPIC: messages}), joints=UR)
    assert list(read.signals) == ["q", "tau"]
    assert torch.equal(read.signals["tau"], log.signals["tau"][1::2])
    assert any("no message has velocity and effort" in w for w in read.warnings)


def test_no_positions_at_all(tmp_path: Path, log: Log) -> None:
    messages = without(messages_of(log, UR, (0, 1, 2)), "position", slice(None))
    path = write_bag(tmp_path / "bag", "mcap", {TOPIC: messages})
    with pytest.raises(LogError, match="no message with positions"):
        read_log(path, joints=UR)


def test_time_of_receipt_where_there_is_no_stamp(tmp_path: Path, log: Log) -> None:
    messages = messages_of(log, UR, (0, 1, 2))
    for message in messages:
        message["received"] = message["stamp"] + LATE_NS
        message["stamp"] = 0
    read = read_log(write_bag(tmp_path / "bag", "mcap", {TOPIC: messages}), joints=UR)
    expect(read, log)
    assert any("time of receipt" in w for w in read.warnings)


def test_stamps_out_of_order_and_repeated(tmp_path: Path, log: Log) -> None:
    messages = messages_of(log, UR, (0, 1, 2))
    messages[10], messages[11] = messages[11], messages[10]
    messages.insert(20, dict(messages[19]))
    for k, message in enumerate(messages):
        message["received"] = START_NS + k
    read = read_log(write_bag(tmp_path / "bag", "mcap", {TOPIC: messages}), joints=UR)
    expect(read, log)
    said = " ".join(read.warnings)
    assert "not in the order of their stamps" in said
    assert "1 messages repeat a time stamp" in said


def test_time_that_begins_again_begins_a_trajectory(tmp_path: Path) -> None:
    log = uniform(3, samples=300)
    messages = [*messages_of(log, UR, (0, 1, 2)), *messages_of(log, UR, (0, 1, 2))]
    for k, message in enumerate(messages):
        message["received"] = START_NS + k
    read = read_log(write_bag(tmp_path / "bag", "mcap", {TOPIC: messages}), joints=UR)
    assert read.trajectory_count == 2
    for part in read.trajectories():
        assert torch.equal(part.q, log.q)


def test_names_that_are_not_the_robots(tmp_path: Path, log: Log) -> None:
    path = write_bag(tmp_path / "bag", "mcap", {TOPIC: messages_of(log, UR, (2, 1, 0))})
    with pytest.raises(LogError, match="the names do not identify its joints") as info:
        read_log(path, joints=("joint_1", "joint_2", "joint_3"))
    assert "elbow_joint" in str(info.value.got)
    order = [f"{name}.{{}}" for name in UR]
    lists = {k: f"[{', '.join(o.format(f) for o in order)}]" for k, f in
             (("q", "position"), ("dq", "velocity"), ("tau", "effort"))}  # fmt: skip
    text = ",".join(f"{key}={value}" for key, value in lists.items())
    expect(read_log(path, joints=("joint_1", "joint_2", "joint_3"), columns=text), log)
    scaled = read_log(path, joints=UR, columns="tau=tau mNm")
    assert torch.allclose(scaled.signals["tau"], 1e-3 * log.signals["tau"])


def test_bags_without_joint_states(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", "mcap", {TOPIC: []})
    with pytest.raises(LogError, match="has no joint states"):
        read_log(path)
