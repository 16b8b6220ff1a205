"""Bags of ROS 1 and ROS 2 (sqlite and MCAP), through `rosbags`: no ROS is needed.

sensor_msgs/JointState is read: its header's stamp is the time, its effort the torque.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from torchid.errors import LogError, MissingExtraError
from torchid.log.joint_names import known_joints
from torchid.log.joint_states import JointState, joint_columns_of
from torchid.log.table import Request, Table
from torchid.log.words import looks_measured, words_of

_TYPE = "sensor_msgs/msg/JointState"
_SIGNALS = ("position", "velocity", "effort")
_LOOKED_AT = 10  # messages of a topic, to see what it has: the first may be incomplete


@dataclass(frozen=True)
class Topic:
    """A topic of a bag.

    Attributes:
        name, type: as the bag has them.
        messages: number of them.
        joints: of its first message, where they are joint states.
        signals: position, velocity, effort, as far as its first messages have them.
    """

    name: str
    type: str
    messages: int
    joints: tuple[str, ...] = ()
    signals: tuple[str, ...] = ()

    def __str__(self) -> str:
        return self.described()

    def described(self, robot_joints: Sequence[str] = ()) -> str:
        """For an error message; with a robot, how many of its joints are there."""
        text = f"{self.name} ({self.type}, {self.messages} messages"
        if self.joints:
            text += f" with {', '.join(self.signals) or 'names'}: {', '.join(self.joints)}"
        if self.joints and robot_joints:
            known = known_joints(self.joints, robot_joints)
            text += f"; {known} of the robot's {len(robot_joints)} joints"
        return text + ")"


def is_bag_folder(path: Path) -> bool:
    """Whether a folder is a rosbag2 recording."""
    return (path / "metadata.yaml").is_file()


def bag_table(path: Path, request: Request) -> Table:
    """The joint states of a bag: t, q, dq, tau in the robot's order, and joint by joint.

    Raises:
        MissingExtraError: rosbags is not installed.
        LogError: the bag cannot be read, has no joint states, or several topics of them; or the
            robot's joints are not among theirs.
    """
    with _opened(path) as bag:
        topic = _chosen(bag, path, request)
        messages = list(_messages(bag, topic.name))
    # Where the mapping says which joint is which, their names need not be the robot's.
    joints = () if request.maps("q") else request.joints
    found = joint_columns_of(messages, joints, f"'{path}', topic {topic.name}")
    return Table.in_memory(
        path,
        "ROS 1 bag" if path.suffix == ".bag" else "ROS 2 bag",
        found.arrays,
        joints=found.joints,
        topic=topic.name,
        origins={
            "t": "stamp of the header" if found.stamped else "time of receipt",
            "q": "position",
            "dq": "velocity",
            "tau": "effort",
        },
        warnings=found.warnings,
    )


def topics_of(path: Path) -> tuple[Topic, ...]:
    """All topics of a bag, those of joint states first.

    Raises:
        As `bag_table`.
    """
    with _opened(path) as bag:
        return _topics(bag)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """A reader of the bag, and one clear error for whatever is wrong with it."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise MissingExtraError("rosbags", "ros", f"reading '{path}'") from error
    try:
        # Recordings before ROS 2 Iron do not say what a message looks like.
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as bag:
            yield bag
    except (LogError, MissingExtraError):
        raise
    except Exception as error:  # whatever the parsers stumble over in a damaged file
        hints = {".bag": "`rosbag reindex`", ".mcap": "`mcap recover`"}
        mend = hints.get(path.suffix.lower(), "`ros2 bag reindex`")
        raise LogError(
            f"'{path}' is not a bag that can be read, or is damaged.",
            got=(str(error).splitlines() or [type(error).__name__])[0][:200],
            hint=f"a recording that was cut off may be mended by {mend}",
        ) from error


def _topics(bag: Any) -> tuple[Topic, ...]:
    found = []
    for name, info in bag.topics.items():
        messages = _messages(bag, name) if (info.msgtype == _TYPE) else iter(())
        first = list(islice(messages, _LOOKED_AT))
        signals = tuple(s for s in _SIGNALS if any(_has_signal(m, s) for m in first))
        joints = first[0].names if first else ()
        found.append(Topic(name, info.msgtype or "several types", info.msgcount, joints, signals))
    return tuple(sorted(found, key=lambda topic: (topic.type != _TYPE, topic.name)))


def _has_signal(message: JointState, signal: str) -> bool:
    """Whether a message has numbers, one a joint."""
    values = message.signals[signal]
    return len(values) == len(message.names) > 0 and not bool(np.isnan(values).all())


def _chosen(bag: Any, path: Path, request: Request) -> Topic:
    """The topic that is asked for; else the only one of joint states, or of the robot's joints."""
    topics = _topics(bag)
    states = [topic for topic in topics if topic.type == _TYPE and topic.messages]
    if request.topic is not None:
        asked = [topic for topic in states if topic.name == request.topic]
        if not asked:
            raise LogError(
                f"'{path}' has no joint states in topic {request.topic}.",
                expected=_TYPE,
                available=states or topics,
            )
        return asked[0]
    if not states:
        raise LogError(f"'{path}' has no joint states.", expected=_TYPE, available=topics or None)
    if len(states) > 1 and request.joints:
        n = len(request.joints)
        states = [t for t in states if known_joints(t.joints, request.joints) == n] or states
    if len(states) > 1:
        # What each topic has, and which one is probably meant.
        def merit(topic: Topic) -> tuple[float, ...]:
            known = known_joints(topic.joints, request.joints) if request.joints else 0
            measured = looks_measured(words_of(topic.name))
            return known, "effort" in topic.signals, measured, len(topic.joints), topic.messages

        best = max(states, key=merit)
        only = sum("effort" in topic.signals for topic in states) == 1 and "effort" in best.signals
        raise LogError(
            f"'{path}' has several topics of joint states.",
            available=[topic.described(request.joints) for topic in states],
            hint=f'choose one: `topic="{best.name}"`'
            + (", the only one with effort" if only else ""),
        )
    return states[0]


def _messages(bag: Any, topic: str) -> Iterator[JointState]:
    connections = [c for c in bag.connections if c.topic == topic]
    for connection, received, raw in bag.messages(connections=connections):
        message = bag.deserialize(raw, connection.msgtype)
        stamp = message.header.stamp
        yield JointState(
            received,
            stamp.sec * 1_000_000_000 + stamp.nanosec,
            tuple(message.name),
            {s: np.asarray(getattr(message, s), dtype=np.float64) for s in _SIGNALS},
        )
