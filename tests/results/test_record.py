"""Records as JSON and back: nothing is lost, joints count from 1 there, a fault is told with its
place."""

import json
import math
from typing import Annotated

import msgspec
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.arms import arm
from torchid.results.record import (
    FINITE,
    Joint,
    Model,
    Part,
    Real,
    Record,
    Rows,
    as_plain,
    decode,
    robot_record,
)
from torchid.typing import Bool, Float, Tensor


class Entry(Part, frozen=True):
    joint: Joint
    size: Real
    also: tuple[Joint, ...] = ()
    where: Joint | None = None


class Sample(Record, frozen=True, kw_only=True, tag="torchid.test/1"):
    robot: str
    values: Annotated[Float[Tensor, " B"], FINITE] = msgspec.field(name="base_values")
    covariance: Float[Tensor, "B B"] | None
    flags: Bool[Tensor, " B"]
    entries: tuple[Entry, ...]
    model: Model | None = None
    seed: int | msgspec.UnsetType = msgspec.UNSET

    @property
    def table(self) -> Rows[Entry]:
        return Rows(self.entries)


def sample(**changes) -> Sample:
    given = {
        "robot": "3r",
        "values": torch.tensor([1.5, -0.0], dtype=torch.float64),
        "covariance": torch.tensor([[1.0, math.nan], [0.0, 2.0]], dtype=torch.float64),
        "flags": torch.tensor([True, False]),
        "entries": (Entry(2, 0.5, (0, 1)), Entry(0, math.inf)),
    }
    return Sample(**(given | changes))


def again(record: Sample) -> Sample:
    return decode(json.dumps(record.plain(), allow_nan=False).encode(), Sample, "a file")


def test_joints_count_from_one_in_json_and_what_is_no_number_is_null():
    data = sample().plain()
    assert data == {
        "schema": "torchid.test/1",
        "robot": "3r",
        "base_values": [1.5, -0.0],
        "covariance": [[1.0, None], [0.0, 2.0]],
        "flags": [True, False],
        "entries": [
            {"joint": 3, "size": 0.5, "also": [1, 2], "where": None},
            {"joint": 1, "size": None, "also": [], "where": None},
        ],
        "model": None,
    }


def test_what_is_written_is_read_back():
    first = sample(seed=7)
    read = again(first)
    assert torch.equal(read.values.view(torch.int64), first.values.view(torch.int64))
    assert torch.equal(read.covariance.isnan(), first.covariance.isnan())
    assert read.flags.tolist() == [True, False]
    assert read.entries[0] == first.entries[0]
    assert math.isnan(read.entries[1].size)
    assert again(read).plain() == first.plain()


@pytest.mark.parametrize("name", ["3r_friction", "kuka_lwr4", "mixed", "panda"])
def test_robots_are_their_yaml(name):
    robot = arm(name)
    read = again(sample(model=robot)).model
    assert robot_record(read) == robot_record(robot)
    assert torch.equal(read.before, robot.before)
    assert read.joint_types == robot.joint_types
    assert again(sample()).model is None


FAULTS = [
    (lambda d: d.update(robot=3), r"`\$\.robot`"),
    (lambda d: d.pop("flags"), "`flags`"),
    (lambda d: d["entries"][1].update(size="x"), r"`\$\.entries\[1\]\.size`"),
    (lambda d: d["entries"][1].update(size=10**400), r"out of range|`\$\.entries\[1\]\.size`"),
    (lambda d: d["entries"][0].update(joint=0), r"from 1.*`\$\.entries\[0\]\.joint`"),
    (lambda d: d["entries"][0].update(joint=True), r"`\$\.entries\[0\]\.joint`"),
    (lambda d: d["entries"][0]["also"].append(1.5), r"`\$\.entries\[0\]\.also\[2\]`"),
    (lambda d: d["covariance"][1].__setitem__(0, "x"), r"entry \[1\]\[0\].*`\$\.covariance`"),
    (lambda d: d["covariance"].pop(), r"covariance`"),
    (lambda d: d["covariance"][0].pop(), r"`\$\.covariance`"),
    (lambda d: d["base_values"].append(1.0), "covariance`"),
    (lambda d: d["base_values"].__setitem__(0, None), "`base_values` is not all finite"),
    (lambda d: d["flags"].__setitem__(0, 1), r"entry \[0\].*`\$\.flags`"),
    (lambda d: d.update(seed=1.5), r"`\$\.seed`"),
    (lambda d: d.update(model={"name": "x"}), r"`\$\.model`"),
    (lambda d: d.update(model={"name": "x", "dh": {"joints": 3}}), r"`\$\.model`"),
    (lambda d: d.update(schema="torchid.other/1"), r"`\$\.schema`"),
]


@pytest.mark.parametrize(("change", "said"), FAULTS)
def test_a_fault_is_told_with_its_place(change, said):
    data = sample().plain()
    change(data)
    with pytest.raises(msgspec.MsgspecError, match=said):
        decode(json.dumps(data).encode(), Sample, "a file")


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)
KEYS = ["robot", "base_values", "covariance", "flags", "entries", "model", "seed"]


@pytest.mark.slow
@settings(max_examples=150)
@given(st.sampled_from(KEYS), JSON)
def test_any_other_json_is_read_or_refused(key, value):
    """Whatever stands under a key, there is a record or an error of the layer, nothing else."""
    content = json.dumps(sample().plain() | {key: value}).encode()
    try:
        read = decode(content, Sample, "a file")
    except (ValueError, RecursionError):
        return
    assert isinstance(read, Sample)


@pytest.mark.parametrize("depth", [10**3, 10**5])
@pytest.mark.parametrize("key", ["model", "covariance", "entries"])
def test_deep_nesting_and_huge_numbers_are_refused(depth, key):
    start = json.dumps(sample().plain() | {key: "HERE"})
    for text in ("[" * depth + "]" * depth, "9" * depth):
        with pytest.raises((ValueError, RecursionError)):
            decode(start.replace('"HERE"', text).encode(), Sample, "a file")


def test_of_takes_attributes_and_refuses_what_is_missing():
    class Live:
        joint, size, also, where = 1, torch.tensor(2.0), (0,), None

    assert Entry.of(Live) == Entry(1, 2.0, (0,))
    assert Entry.of(Live, size=3.0).size == 3.0
    with pytest.raises(msgspec.ValidationError, match="size"):
        Entry.of(joint=1)


def test_rows_are_tables():
    pandas = pytest.importorskip("pandas")
    frame = sample().to_frame()
    assert isinstance(frame, pandas.DataFrame)
    assert list(frame.columns) == ["joint", "size", "also", "where"]
    assert frame["joint"].tolist() == [3, 1]
    html = sample(entries=(Entry(0, 1.0),), robot="<b>")._repr_html_()
    assert "<td>1</td>" in html
    assert "<b>" not in html
    assert as_plain(Rows((Entry(0, 1.0),)))[0]["joint"] == 1
