"""Recordings in other programs' formats, written by those programs' own libraries."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from torchid.log.model import Log

BAGS = ("ros1", "sqlite3", "mcap")
JOINT_STATE = "sensor_msgs/msg/JointState"
START_NS = 1_700_000_000_000_000_000
LATE_NS = 2_000_000  # a message is received this much after its stamp


def messages_of(log: Log, names: Sequence[str], order: Sequence[int]) -> list[dict[str, Any]]:
    """Joint states of a log of one trajectory, joints in another order."""
    listed = [names[k] for k in order]
    signals = {
        field: None if signal is None else signal.numpy()[:, list(order)]
        for field, signal in (("position", log.q), ("velocity", log.dq), ("effort", log.tau))
    }
    return [
        {"stamp": START_NS + round(float(t) * 1e9), "name": listed}
        | {field: [] if x is None else x[k] for field, x in signals.items()}
        for k, t in enumerate(log.t)
    ]


def write_bag(path: Path, kind: str, topics: dict[str, Iterable[dict[str, Any]]]) -> Path:
    """A bag of joint states, topic by topic; the path of the file or folder."""
    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    pack = store.serialize_ros1 if kind == "ros1" else store.serialize_cdr
    if kind == "ros1":
        writer: Any = Writer1(path.with_suffix(".bag"))
    else:
        storage = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(path, version=9, storage_plugin=storage)
    with writer:
        for topic, messages in topics.items():
            connection = writer.add_connection(topic, JOINT_STATE, typestore=store)
            for message in messages:
                received = message.get("received", message["stamp"] + LATE_NS)
                raw = pack(_joint_state(store, kind, message), JOINT_STATE)
                writer.write(connection, received, raw)
    return path.with_suffix(".bag") if kind == "ros1" else path


def _joint_state(store: Any, kind: str, message: dict[str, Any]) -> Any:
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](
        sec=message["stamp"] // 10**9, nanosec=message["stamp"] % 10**9
    )
    sequence = {"seq": 0} if kind == "ros1" else {}
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="", **sequence)
    values = {
        field: np.ascontiguousarray(message.get(field, []), dtype=np.float64)
        for field in ("position", "velocity", "effort")
    }
    return types[JOINT_STATE](header=header, name=list(message["name"]), **values)


def write_lerobot(
    path: Path, version: str, log: Log, features: dict[str, tuple[list[str] | None, np.ndarray]]
) -> Path:
    """A LeRobot dataset whose episodes are the trajectories of a log, at 50 frames per second."""
    fps = 50.0
    described = {
        name: {"dtype": "float32", "shape": [values.shape[1]], "names": names}
        for name, (names, values) in features.items()
    }
    described |= {"observation.images.top": {"dtype": "video", "shape": [3, 8, 8], "names": None}}
    counted = ("timestamp", "frame_index", "episode_index", "index", "task_index")
    described |= {name: {"dtype": "int64", "shape": [1], "names": None} for name in counted}
    info = {"codebase_version": version, "fps": fps, "features": described}
    (path / "meta").mkdir(parents=True)
    (path / "meta" / "info.json").write_text(json.dumps(info))
    tables = [_episode(log, k, rows, features, fps) for k, rows in enumerate(log.slices())]
    folder = path / "data" / "chunk-000"
    folder.mkdir(parents=True)
    if version == "v2.1":
        for k, table in enumerate(tables):
            pa.parquet.write_table(table, folder / f"episode_{k:06d}.parquet")
    else:
        pa.parquet.write_table(pa.concat_tables(tables), folder / "file-000.parquet")
    return path


def _episode(log: Log, k: int, rows: slice, features: Any, fps: float) -> pa.Table:
    count = rows.stop - rows.start
    frames = np.arange(count)
    columns: dict[str, Any] = {
        name: pa.array(list(values[rows].astype(np.float32)), pa.list_(pa.float32()))
        for name, (_, values) in features.items()
    }
    jitter = 1e-4 * np.sin(frames)
    columns |= {
        "timestamp": (frames / fps + jitter).astype(np.float32),
        "frame_index": frames,
        "episode_index": np.full(count, k),
        "index": rows.start + frames,
        "task_index": np.zeros(count, dtype=np.int64),
    }
    return pa.table(columns)
