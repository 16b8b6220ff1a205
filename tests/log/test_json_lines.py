"""Logs of JSON lines: lists, flat keys, nested objects, joint states; what is missing or broken."""

import json
import math

import pytest

from tests.log.examples import proposed
from torchid.errors import LogError
from torchid.log.readers import read_log


def written(folder, rows, name="log.jsonl"):
    path = folder / name
    path.write_text(
        "".join(f"{row if isinstance(row, str) else json.dumps(row)}\n" for row in rows)
    )
    return path


def row(k, **more):
    return {"t": 0.01 * k, "q": [0.1 * k, -0.2 * k], "dq": [10.0, -20.0], "tau": [1.0, k]} | more


@pytest.mark.parametrize("name", ["log.jsonl", "log.ndjson"])
def test_lists_are_arrays(tmp_path, name):
    log = read_log(written(tmp_path, [row(k) for k in range(5)], name))
    assert log.q.tolist() == [[0.1 * k, -0.2 * k] for k in range(5)]
    assert log.tau[:, 1].tolist() == [0, 1, 2, 3, 4]


def test_flat_keys_are_columns(tmp_path):
    log = read_log(written(tmp_path, [{"t": 0.01 * k, "q1": k, "q2": -k} for k in range(5)]))
    assert log.q[3].tolist() == [3, -3]


def test_nested_objects_have_dots(tmp_path):
    rows = [{"time": 0.01 * k, "state": {"pos": [k, 2 * k], "trq": [1, 2]}} for k in range(5)]
    log = read_log(written(tmp_path, rows), columns="t=time,q=state.pos deg,tau=state.trq")
    assert log.q[4].tolist() == pytest.approx([math.radians(4), math.radians(8)])


def test_joint_states_go_by_their_names(tmp_path):
    rows = [
        {
            "header": {"stamp": {"sec": 1_700_000_000 + k, "nanosec": 500_000_000}},
            "name": ["elbow", "wrist"] if k % 2 else ["wrist", "elbow"],
            "position": [k, -k] if k % 2 else [-k, k],
            "velocity": [],
        }
        for k in range(5)
    ]
    log = read_log(
        written(tmp_path, rows), columns="t=header.stamp,q=[elbow.position, wrist.position]"
    )
    assert log.t.diff().tolist() == pytest.approx([1, 1, 1, 1])
    assert float(log.t[0]) == 1_700_000_000.5
    assert log.q.tolist() == [[k, -k] for k in range(5)]


def test_a_header_line_is_left_out_with_a_warning(tmp_path):
    log = read_log(written(tmp_path, [{"robot": "arm"}, *[row(k) for k in range(5)]]))
    assert log.samples == 5
    assert any("line 1 has other keys" in warning for warning in log.warnings)


@pytest.mark.parametrize("gap", [{"dq": None}, {"dq": [float("nan"), 1.0]}, "absent"])
def test_what_a_line_lacks_is_not_a_number(tmp_path, gap):
    rows = [row(k) for k in range(5)]
    rows[2] = {k: v for k, v in rows[2].items() if k != "dq"} if gap == "absent" else row(2) | gap
    dq = read_log(written(tmp_path, rows)).dq[:, 0]
    assert dq.isnan().tolist() == [False, False, True, False, False]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('{"t": 0.02, "q": [1, 2', "line 3: not JSON"),
        ("[0.02, 1, 2]", "line 3: no JSON object"),
        ('{"t": 0.02, "q": [1]}', "line 3: q is not as long"),
        ('{"t": 0.02, "q": 1}', "line 3: q is not as long"),
    ],
)
def test_broken_lines_are_named(tmp_path, line, words):
    with pytest.raises(LogError, match=words):
        read_log(written(tmp_path, [row(0), row(1), line, row(3)]))


def test_no_numbers_are_no_log(tmp_path):
    with pytest.raises(LogError, match="no numbers"):
        read_log(written(tmp_path, [{"name": "a"}, {"name": "b"}]))


def test_other_names_are_proposed(tmp_path):
    rows = [{"t": 0.01 * k, "pos": [k, k], "vel": [1, 1]} for k in range(5)]
    assert proposed(written(tmp_path, rows)) == 'perhaps `columns="q=pos,dq=vel"`'
