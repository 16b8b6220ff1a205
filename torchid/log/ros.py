"""Bags of ROS 1 and ROS 2 (sqlite and MCAP), through `rosbags`: no ROS is needed.

sensor_msgs/JointState is read: its header's stamp is the time, its effort the torque. Commands
beside them are trajectory_msgs/JointTrajectory, or joint states in a topic whose name says that
they are commanded (`/leader/joint_states`).
"""

import struct
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from torchid.errors import LogError, MissingExtraError
from torchid.log.commands import Held, commands_along, held_commands
from torchid.log.joint_names import known_joints
from torchid.log.joint_states import JointColumns, JointState, joint_columns_of
from torchid.log.table import Request, Table
from torchid.log.words import is_commanded, looks_measured, words_of

_TYPE = "sensor_msgs/msg/JointState"
_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
_SIGNALS = ("position", "velocity", "effort")
_MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _DATA_END = struct.Struct("<BQQQI"), struct.Struct("<BQI")
"""Records at the end of an MCAP: opcode, length, places of the summary, and checksums."""
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
        motion = joint_columns_of(
            messages, joints, f"'{path}', topic {topic.name}", request.spare_joints
        )
        arrays, source, notes = _with_commands(bag, path, request, topic.name, motion)
    return Table.in_memory(
        path,
        "ROS 1 bag" if path.suffix == ".bag" else "ROS 2 bag",
        arrays,
        joints=motion.joints,
        topic=topic.name,
        origins={
            "t": "stamp of the header" if motion.stamped else "time of receipt",
            "q": "position",
            "dq": "velocity",
            "tau": "effort",
            **({"u": source} if source else {}),
        },
        warnings=(*motion.warnings, *notes),
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
        for file in [path] if path.is_file() else sorted(path.iterdir()):
            if file.suffix.lower() == ".mcap":
                _require_checksums(file)
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


def _require_checksums(file: Path) -> None:
    """Refuse an MCAP whose sections have other checksums than it says, where it says some; those of
    its chunks rosbags looks at.

    Raises:
        ValueError: they have not.
    """
    size = file.stat().st_size
    with open(file, "rb") as stream:
        stream.seek(max(0, size - _FOOTER.size - len(_MAGIC)))
        footer = stream.read(_FOOTER.size)
        if len(footer) < _FOOTER.size or footer[0] != 0x02 or stream.read() != _MAGIC:
            return  # cut off: what can be read is
        summary, summary_crc = _FOOTER.unpack(footer)[2::2]
        last = size - _FOOTER.size - len(_MAGIC)
        ends = (summary or last) - _DATA_END.size
        if not 0 <= ends < last:
            raise ValueError("its footer says where no section is")
        stream.seek(ends)
        kind, _, data_crc = _DATA_END.unpack(stream.read(_DATA_END.size))
        sections = [("data", 0, ends, data_crc if kind == 0x0F else 0)]
        sections.append(("summary", summary or last, size - len(_MAGIC) - 4, summary_crc))
        for name, begin, end, expected in sections:
            stream.seek(begin)
            checksum, left = 0, end - begin if expected else 0
            while piece := stream.read(min(left, 1 << 20)):
                checksum, left = zlib.crc32(piece, checksum), left - len(piece)
            if expected and checksum != expected:
                raise ValueError(f"the checksum of its {name} is wrong: bits have changed")


def _topics(bag: Any) -> tuple[Topic, ...]:
    topics = []
    for name, info in bag.topics.items():
        messages = _messages(bag, name) if (info.msgtype == _TYPE) else iter(())
        first = list(islice(messages, _LOOKED_AT))
        # Those of which a message has numbers, one a joint.
        signals = tuple(
            s
            for s in _SIGNALS
            if any(
                len(m.signals[s]) == len(m.names) > 0 and not np.isnan(m.signals[s]).all()
                for m in first
            )
        )
        joints = first[0].names if first else ()
        topics.append(Topic(name, info.msgtype or "several types", info.msgcount, joints, signals))
    return tuple(sorted(topics, key=lambda topic: (topic.type != _TYPE, topic.name)))


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
    for received, stamp, names, message in _sent(bag, topic):
        numbers = {s: np.asarray(getattr(message, s), dtype=np.float64) for s in _SIGNALS}
        yield JointState(received, stamp, names, numbers)


def _with_commands(
    bag: Any, path: Path, request: Request, states: str, motion: JointColumns
) -> tuple[dict[str, np.ndarray], str | None, tuple[str, ...]]:
    """Arrays with the commands beside joint states: the topic that a mapping names, under its
    name; else, where there is no effort, the only one that is commanded, as u. With that topic and
    what to say."""
    types = {name: info.msgtype for name, info in bag.topics.items() if info.msgcount}
    known = [
        name for name, kind in types.items() if kind in (_TYPE, _TRAJECTORY) and name != states
    ]
    source = request.columns.sources.get("u") if request.columns is not None else None
    named = [name for name in known if source is not None and name in source.columns]
    if not named:
        # Drivers without torque may send zeros.
        torque = bool(np.nan_to_num(motion.arrays.get("tau", np.zeros(0))).any())
        if torque or request.maps("u") or request.maps("q"):
            return motion.arrays, None, ()
        commanded = [
            name
            for name in known
            if (types[name] == _TRAJECTORY or is_commanded(words_of(name)))
            and any(set(motion.joints) <= set(m[2]) for m in islice(_sent(bag, name), _LOOKED_AT))
        ]
        if len(commanded) != 1:
            which = f'; say which: `columns="u={commanded[0]}"`' if commanded else ""
            topics = ", ".join(commanded)
            return motion.arrays, None, (
                (f"'{path}': several topics of commands: {topics}{which}",) if commanded else ()
            )  # fmt: skip
        named = commanded
    label = f"'{path}', topic {named[0]}"
    if "traj" in motion.arrays:
        return motion.arrays, None, (f"{label}: left out, as time begins again in {states}.",)
    commands, notes = _commands(list(_sent(bag, named[0])), types[named[0]], motion, label)
    arrays = {name: values[commands.rows] for name, values in motion.arrays.items()}
    arrays["t"] = arrays["t"] - arrays["t"][:1]
    arrays["u" if source is None else named[0]] = commands.u[commands.rows]
    return arrays, named[0], (*notes, *commands.warnings)


def _sent(bag: Any, topic: str) -> Iterator[tuple[int, int, tuple[str, ...], Any]]:
    """When messages of a topic were received and stamped [ns], their joints, and themselves."""
    connections = [c for c in bag.connections if c.topic == topic]
    for connection, received, raw in bag.messages(connections=connections):
        message = bag.deserialize(raw, connection.msgtype)
        stamp = message.header.stamp
        names = message.joint_names if hasattr(message, "joint_names") else message.name
        yield received, stamp.sec * 1_000_000_000 + stamp.nanosec, tuple(names), message


def _commands(
    messages: list[tuple[int, int, tuple[str, ...], Any]],
    kind: str,
    motion: JointColumns,
    label: str,
) -> tuple[Held, tuple[str, ...]]:
    """Commands of the joints of columns, at their times.

    Raises:
        LogError: no message has these joints, or commands were not recorded with the positions.
    """
    joints, t = motion.joints, motion.arrays["t"]
    whole = [m for m in messages if set(joints) <= set(m[2])]
    if not whole:
        seen = dict.fromkeys(name for m in messages for name in m[2])
        raise LogError(
            f"{label} commands other joints.", got=", ".join(seen), expected=", ".join(joints)
        )
    notes = []
    if len(whole) < len(messages):
        notes.append(f"{label}: {len(messages) - len(whole)} messages lack joints: left out.")
    # When commands were sent, on the clock of the positions: their stamps where these are of that
    # clock; else the time of receipt, less what the positions take until they are received.
    received, stamps = (np.array([m[k] for m in whole], dtype=np.int64) for k in (0, 1))
    stamped = motion.stamped and stamps.min() > 0 and (len(stamps) < 2 or np.ptp(stamps) > 0)
    if stamped:
        apart = 1e-9 * (float(np.median(received - stamps)) - motion.late)
        # 1.0: stamps that lag by so much more than others are of another clock
        if abs(apart) > 1.0:
            notes.append(
                f"{label}: stamps are of another clock than the positions', {abs(apart):.3g} s "
                "apart: the time of receipt is taken."
            )
            stamped = False
    sent = 1e-9 * ((stamps if stamped else received - motion.late) - motion.start)
    if kind == _TYPE:
        u = np.array([[_value(m[3], m[2], joint) for joint in joints] for m in whole])
        return held_commands(t, sent, u, label), tuple(notes)
    trajectories = []
    for begin, (_, _, names, message) in zip(sent.tolist(), whole, strict=True):
        columns = [names.index(joint) for joint in joints]
        after = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in message.points]
        goals = [np.asarray(p.positions, dtype=np.float64) for p in message.points]
        if goals and all(len(goal) == len(names) for goal in goals):
            trajectories.append((begin, np.array(after), np.stack(goals)[:, columns]))
    if len(trajectories) < len(whole):
        notes.append(
            f"{label}: {len(whole) - len(trajectories)} messages without positions: left out."
        )
    return commands_along(t, motion.arrays["q"], trajectories, label), tuple(notes)


def _value(message: Any, names: tuple[str, ...], joint: str) -> float:
    """The position of a joint; NaN in a message without positions."""
    values = message.position
    return float(values[names.index(joint)]) if len(values) == len(names) else float("nan")
