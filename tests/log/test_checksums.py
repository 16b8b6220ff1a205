"""A changed bit in a file with checksums is seen; a span of time that its rows deny is said."""

import random
from pathlib import Path

import pytest
import torch
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from tests.log.recordings import START_NS, write_bag
from tests.robustness.bad_logs import motion
from torchid.errors import LogError
from torchid.log.checks import check_log
from torchid.log.model import Log
from torchid.log.readers import log_from_columns, read_log, write_log

FLIPS = 20


def parquet(folder: Path) -> Path:
    write_log(log_from_columns(motion(200), folder), folder / "log.parquet")
    return folder / "log.parquet"


def mcap(folder: Path, chunks: bool) -> Path:
    """A recording as ROS 2 writes it with checksums: of its chunks, or of all data."""
    states = [
        {"stamp": START_NS + 10_000_000 * k, "name": ["a", "b"], "position": [0.1 * k, -0.2 * k]}
        for k in range(40)
    ]
    bag = write_bag(folder / "bag", "mcap", {"/joint_states": states})
    target = folder / "log.mcap"
    with open(next(bag.glob("*.mcap")), "rb") as source, open(target, "wb") as stream:
        writer = Writer(
            stream, compression=CompressionType.NONE, use_chunking=chunks,
            enable_data_crcs=not chunks,
        )  # fmt: skip
        writer.start(profile="ros2", library="a recorder")
        known: dict[int, int] = {}
        for schema, channel, message in make_reader(source).iter_messages():
            if channel.id not in known:
                own = writer.register_schema(schema.name, schema.encoding, schema.data)
                known[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, own, channel.metadata
                )
            writer.add_message(
                known[channel.id], message.log_time, message.data, message.publish_time
            )
        writer.finish()
    return target


@pytest.mark.parametrize("kind", ["parquet", "mcap of chunks", "mcap as a whole"])
def test_a_flipped_bit_is_seen(tmp_path: Path, kind: str) -> None:
    file = parquet(tmp_path) if kind == "parquet" else mcap(tmp_path, kind == "mcap of chunks")
    whole, good, choose = file.read_bytes(), read_log(file), random.Random(kind)
    refused = 0
    for _ in range(FLIPS):
        place, changed = choose.randrange(len(whole)), bytearray(whole)
        changed[place] ^= 1 << choose.randrange(8)
        file.write_bytes(changed)
        try:
            found = read_log(file)
        except LogError:
            refused += 1
            continue
        assert torch.equal(found.t, good.t), place
        assert torch.equal(found.q, good.q), place
    assert refused > FLIPS // 2


@pytest.mark.parametrize(("row", "said"), [(None, False), (30, True)])
def test_a_span_that_its_rows_deny_is_said(row: int | None, said: bool) -> None:
    t = 0.01 * torch.arange(60, dtype=torch.float64)
    if row is not None:
        t[row:] += 4e6
    log = Log(t, torch.sin(t)[:, None], tau=torch.cos(t)[:, None])
    warnings = check_log(log, n=1, robot_name="arm")
    found = [w for w in warnings if "a stamp may be damaged after row 30" in w]
    assert bool(found) is said
