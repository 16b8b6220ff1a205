"""Column mappings: what is written is what is read, whatever the columns are called."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from torchid.errors import LogError
from torchid.log.assemble import unused_columns
from torchid.log.checks import check_log
from torchid.log.columns import columns_of
from torchid.log.csv_file import csv_table
from torchid.log.mapping import KEYS, read_mapping
from torchid.log.readers import read_log
from torchid.log.table import Request
from torchid.log.units import UNITS, unit_factor

from .examples import same, snapshot, uniform
from .test_readers import save

T = 0.1 * np.arange(5)
DEG = math.pi / 180


@pytest.mark.parametrize(
    ("text", "columns", "factors"),
    [
        ("q=pos_{j}", ("pos_{j}",), (1.0,)),
        ("q = pos_{j} deg", ("pos_{j}",), (DEG,)),
        ("q=-pos_{j} deg", ("pos_{j}",), (-DEG,)),
        ("q=pos_{j} rev /4096", ("pos_{j}",), (2 * math.pi / 4096,)),
        ("q=pos_{j}*2e-3", ("pos_{j}",), (2e-3,)),
        ("q=pos_{j} mrad *[1,-1]", ("pos_{j}",), (1e-3, -1e-3)),
        ("q=state[:,0:7] deg", ("state[:,0:7]",), (DEG,)),
        ("q=state[:,[2,0,1]]", ("state[:,[2,0,1]]",), (1.0,)),
        ("q=[a, b.c, 'd e']", ("a", "b.c", "d e"), (1.0,)),
        ("q='Joint {j} (deg), a' deg", ("Joint {j} (deg), a",), (DEG,)),
        ("q=data/demo_*/q", ("data/demo_*/q",), (1.0,)),
    ],
)
def test_what_a_source_may_be(text: str, columns: tuple, factors: tuple) -> None:
    source = read_mapping(text).sources["q"]
    assert source is not None
    assert source.columns == columns
    assert source.factors == pytest.approx(factors, rel=1e-15)


@pytest.mark.parametrize(
    ("text", "raw", "values"),
    [
        ("q=p{j} rev/4096 -2048", [2048, 3072], [0, math.pi / 2]),
        ("q=p{j} rev /4096 - 2048", [2048, 3072], [0, math.pi / 2]),
        ("q=-p{j} deg +90", [0, -180], [-math.pi / 2, math.pi / 2]),
        ("q=p{j} *2 +[1,-1]", [3, 3], [8, 4]),
        ("q=p{j} -0.5", [3, 3], [2.5, 2.5]),
    ],
)
def test_offsets_are_added_to_the_numbers_of_the_column(
    tmp_path: Path, text: str, raw: list, values: list
) -> None:
    own = {f"p{k + 1}": np.full(5, float(x)) for k, x in enumerate(raw)}
    log = read_log(save(tmp_path / "a.csv", {"t": T, **own}), columns=text)
    assert log.q[0].tolist() == pytest.approx(values, abs=1e-12)


def test_offsets_in_yaml_and_as_many_as_joints(tmp_path: Path) -> None:
    path = save(tmp_path / "a.csv", {"t": T, "p1": T, "p2": T})
    given_ = {"q": {"columns": "p{j}", "unit": "deg", "offset": [90, -90]}}
    assert read_log(path, columns=given_).q[0].tolist() == pytest.approx([90 * DEG, -90 * DEG])
    with pytest.raises(LogError, match="another number of offsets"):
        read_log(path, columns="q=p{j} +[1,2,3]")


def test_several_entries_aliases_and_none() -> None:
    mapping = read_mapping("time=stamp ns, current=cur_{j} mA ,dq=none,t" + "raj=run")
    assert set(mapping.sources) == {"t", "i", "dq", "traj"}
    assert mapping.sources["dq"] is None
    assert mapping.sources["t"].factors == (1e-9,)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("pos_{j}", "without `=`"),
        ("", "without `=`"),
        ("p=pos_{j}", "unknown column"),
        ("q=a,q=b", "gives q twice"),
        ("q=", "names no column"),
        ("q=pos_{j} furlong", "cannot be in this unit"),
        ("dq=pos_{j} deg", "cannot be in this unit"),
        ("t=0 Hz", "not a positive number"),
        ("q=pos_{j} *0", "not a number"),
        ("q=pos_{j} *[1,x]", "not a number"),
        ("nowhere.yaml", "cannot be read"),
    ],
)
def test_what_cannot_be_understood(text: str, message: str) -> None:
    with pytest.raises(LogError, match=message):
        read_mapping(text)


@pytest.mark.parametrize(
    ("kind", "unit", "factor"),
    [
        ("tau", "N m", 1.0), ("tau", "mN.m", 1e-3), ("ddq", "rad/s2", 1.0), ("ddq", "deg/s²", DEG),
        ("dq", "°/s", DEG), ("dq", "rpm", math.pi / 30), ("t", "µs", 1e-6), ("t", "sec", 1.0),
        ("dq", "rad/sec", 1.0), ("q", "(deg)", DEG), ("q", "mm", 1e-3), ("i", "mA", 1e-3),
        ("tau", "MNm", None), ("q", "s", None),
    ],
)  # fmt: skip
def test_units_as_people_write_them(kind: str, unit: str, factor: float | None) -> None:
    assert unit_factor(kind, unit) == pytest.approx(factor)


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_mapping_reads_back_the_same_log(tmp_path: Path, data: st.DataObject) -> None:
    """Other names, in another order of columns, in other units, in any format."""
    n = data.draw(st.integers(1, 12))
    log = uniform(n, samples=data.draw(st.integers(2, 6)))
    suffix = data.draw(st.sampled_from([".csv", ".parquet", ".npz"]))
    table: dict[str, np.ndarray] = {"q_ref1": log.t.numpy(), "note": log.t.numpy()}
    entries = []
    own = columns_of(log)
    for key in ("t", "q", "dq", "ddq", "tau", "i"):
        unit = data.draw(st.sampled_from(["", *UNITS[key]]))
        sign = data.draw(st.sampled_from([1.0, -1.0]))
        pattern, start = data.draw(st.sampled_from([("{j}", 1), ("{j0}", 0)]))
        name = data.draw(st.sampled_from(["{}_x{}", "A {} [y]{}", "1.{}-{}", "{}({}),z", "ü{}/{}"]))
        factor = sign * (UNITS[key][unit] if unit else 1.0)
        columns = [key] if key == "t" else [f"{key}{k + 1}" for k in range(n)]
        for k, column in enumerate(columns):
            label = name.format(key, "" if key == "t" else k + start)
            table[label] = own[column] / factor
        source = name.format(key, "" if key == "t" else pattern)
        entries.append(f"{key}={'-' if sign < 0 else ''}'{source}' {unit}".rstrip())
    names = data.draw(st.permutations(list(table)))
    if suffix == ".csv":
        path = tmp_path / "a.csv"
        rows = np.stack([table[name] for name in names], 1)
        lines = [";".join(names), *(";".join(repr(float(x)) for x in row) for row in rows)]
        path.write_text("\n".join(lines) + "\n")
    elif suffix == ".npz":
        # A zip has no files of such names: numbers stand for them.
        path = tmp_path / "a.npz"
        short = {
            name: "c" + "abcdefghij"[k // 10] + "abcdefghij"[k % 10] for k, name in enumerate(names)
        }
        np.savez(path, **{short[name]: table[name] for name in names})
        entries = _listed(entries, short, own, n)
    else:
        path = save(tmp_path / "a.parquet", {name: table[name] for name in names})
    read = read_log(path, columns=",".join(entries))
    for name, signal in (log.signals | {"t": log.t}).items():
        torch.testing.assert_close(getattr(read, name), signal, rtol=1e-14, atol=0.0)


def _listed(entries: list[str], short: dict[str, str], own: dict, n: int) -> list[str]:
    """The same mapping as lists of columns."""
    out = []
    for entry in entries:
        key, _, value = entry.partition("=")
        sign = "-" if value.startswith("-") else ""
        _, pattern, unit = value.split("'")
        numbers = [""] if key == "t" else range(1, n + 1) if "{j}" in pattern else range(n)
        names = [short[pattern.replace("{j}", str(k)).replace("{j0}", str(k))] for k in numbers]
        out.append(f"{key}={sign}[{', '.join(names)}]{unit}")
    return out


def test_yaml_says_the_same(tmp_path: Path) -> None:
    save(tmp_path / "a.csv", {"ms": 1e3 * T, "p0": T, "p1": 2 * T, "left": T, "right": 3 * T})
    (tmp_path / "map.yaml").write_text(
        "t: ms ms\nq: {columns: 'p{j0}', unit: deg, factor: [2, -1]}\ntau: [right, left]\n"
    )
    for columns in (tmp_path / "map.yaml", str(tmp_path / "map.yaml")):
        log = read_log(tmp_path / "a.csv", columns=columns)
        assert torch.allclose(
            log.q, torch.tensor(DEG * np.stack([2 * T, -2 * T], 1), dtype=torch.float64)
        )
        assert log.tau is not None
        assert torch.equal(log.tau, torch.tensor(np.stack([3 * T, T], 1), dtype=torch.float64))
    text = read_log(tmp_path / "a.csv", columns="t=ms ms,q=p{j0} deg *[2,-1],tau=[right,left]")
    assert same(text, snapshot(log))
    given_ = {"t": "ms ms", "q": {"columns": "p{j0}", "unit": "deg", "factor": [2, -1]},
              "tau": ["right", "left"]}  # fmt: skip
    assert same(read_log(tmp_path / "a.csv", columns=given_), snapshot(log))


@pytest.mark.parametrize(
    ("content", "message"),
    [("- q", "is not a mapping"), ("q: {from: a}", "cannot be understood"), ("q: [", "cannot be")],
)
def test_yaml_that_is_no_mapping(tmp_path: Path, content: str, message: str) -> None:
    (tmp_path / "map.yaml").write_text(content)
    with pytest.raises(LogError, match=message):
        read_mapping(tmp_path / "map.yaml")


def test_yaml_that_is_wrong_is_told_with_the_line(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text("t: stamp\nq: [a, b\ntau: c\n")
    with pytest.raises(LogError) as info:
        read_mapping(tmp_path / "map.yaml")
    # libyaml and Python's own reader word the middle each in their way.
    assert re.fullmatch(
        r"line 3: .*expected ',' or ']'.*, while parsing a flow sequence that begins in line 2",
        info.value.got,
    )
    (tmp_path / "map.yaml").write_text("t: stamp\nq: 'pos_{j}\n")
    with pytest.raises(LogError) as info:
        read_mapping(tmp_path / "map.yaml")
    assert str(info.value.got).startswith("line 3: found unexpected end of stream")


def test_our_names_need_no_mapping_and_give_way_to_it(tmp_path: Path) -> None:
    path = save(tmp_path / "a.csv", {"t": T, "q1": T, "dq1": T, "tau1": T, "better": 2 * T})
    log = read_log(path, columns="tau=better,dq=none")
    assert list(log.signals) == ["q", "tau"]
    assert log.tau is not None
    assert torch.equal(log.tau[:, 0], torch.tensor(2 * T, dtype=torch.float64))


def test_numbering(tmp_path: Path) -> None:
    columns = {"t": T} | {f"p{k:02d}": k * T for k in (3, 1, 2, 10, 11, 12)}
    path = save(tmp_path / "a.csv", columns)
    log = read_log(path, columns="q=p{1..3}")
    assert log.q[1].tolist() == pytest.approx([0.1, 0.2, 0.3])
    log = read_log(path, columns="q=p{10..12}")
    assert log.q[1].tolist() == pytest.approx([1.0, 1.1, 1.2])
    with pytest.raises(LogError, match=r"no columns p\{j\} in order") as info:
        read_log(path, columns="q=p{j}")
    assert "p01, p02, p03, p10" in str(info.value)
    assert "{1,2,3,10,11,12}" in str(info.value.hint)
    save(path, {"t": T, "p0": T, "p1": T})
    with pytest.raises(LogError, match=r"\{j0\} counts from 0: q=p\{j0\}"):
        read_log(path, columns="q=p{j}")


def test_numbers_in_an_order_of_their_own(tmp_path: Path) -> None:
    path = save(tmp_path / "a.csv", {"t": T} | {f"m{k}_angle": k * T for k in range(1, 5)})
    log = read_log(path, columns="q=m{3,1, 2}_angle deg")
    assert log.q[1].tolist() == pytest.approx([0.3 * DEG, 0.1 * DEG, 0.2 * DEG])
    with pytest.raises(LogError, match="names a column twice"):
        read_log(path, columns="q=m{3,1,3}_angle")
    with pytest.raises(LogError, match="m5_angle, m6_angle missing"):
        read_log(path, columns="q=m{3,5,6}_angle")


def test_what_is_missing_in_the_middle_is_named(tmp_path: Path) -> None:
    path = save(tmp_path / "a.csv", {"t": T} | {f"p{k}": T for k in (1, 2, 4, 5)})
    with pytest.raises(LogError, match=r"in order, which the mapping of q names: p3 missing\."):
        read_log(path, columns="q=p{j}")


def test_absent_columns_are_told_with_the_nearest(tmp_path: Path) -> None:
    path = save(tmp_path / "a.csv", {"t": T, "position_1": T, "effort_1": T})
    with pytest.raises(LogError, match="no column 'position1'") as info:
        read_log(path, columns="q=[position1]")
    assert info.value.available == ["t", "position_1", "effort_1"]
    assert "nearest: position_1" in str(info.value)


def test_factors_must_be_as_many_as_joints(tmp_path: Path) -> None:
    path = save(tmp_path / "a.csv", {"t": T, "p1": T, "p2": T})
    with pytest.raises(LogError, match="another number of factors"):
        read_log(path, columns="q=p{j} *[1,2,3]")


NANOSECONDS = 1_700_000_000_250_000_001 + np.arange(5) * 10**9
STAMPS = {
    "text": np.array([f"2024-05-01T12:00:0{k}.250" for k in range(5)], dtype=object),
    "timestamps": np.datetime64("2024-05-01T12:00:00.25", "ns")
    + np.arange(5) * np.timedelta64(1, "s"),
    "nanoseconds": NANOSECONDS,
    "nanoseconds, by name": NANOSECONDS,
    "microseconds": NANOSECONDS // 1000,
    "milliseconds": NANOSECONDS / 1e6,
}


@pytest.mark.parametrize("kind", STAMPS)
def test_stamps_since_1970_lose_nothing(tmp_path: Path, kind: str) -> None:
    """The size of a number says its unit."""
    path = save(tmp_path / "a.parquet", {"when": STAMPS[kind], "q1": T})
    log = read_log(path, columns=f"t=when{' ns' if 'by name' in kind else ''}")
    exact = 1e-6 if kind in ("microseconds", "milliseconds") else 1e-12
    assert (log.t - log.t[0]).tolist() == pytest.approx([0, 1, 2, 3, 4], abs=exact)
    if STAMPS[kind].dtype.kind in "if":
        own = read_log(save(tmp_path / "b.parquet", {"t": STAMPS[kind], "q1": T}))
        assert torch.equal(own.t, log.t)


def test_time_that_was_not_recorded(tmp_path: Path) -> None:
    path = save(tmp_path / "a.csv", {"q1": T, "q2": T})
    assert read_log(path, columns="t=250 Hz").t.tolist() == pytest.approx(
        [0, 4e-3, 8e-3, 12e-3, 16e-3]
    )


def test_labels_of_trajectories(tmp_path: Path) -> None:
    path = save(tmp_path / "a.parquet", {"t": T, "q1": T, "run": ["b", "b", "a", "a", "a"]})
    log = read_log(path, columns="traj=run")
    assert log.trajectory.tolist() == [0, 0, 1, 1, 1]


def test_every_key_has_units_and_its_own_unit_is_one() -> None:
    for key in KEYS:
        assert next(iter(UNITS[key].values()), 1.0) == 1.0


def test_motors_of_a_quadruped_in_the_robots_order(tmp_path: Path) -> None:
    """Columns as low-state messages have them, legs FR FL RR RL, for a robot of FL FR RL RR."""
    order = (3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8)
    path, t = tmp_path / "go2.csv", np.arange(20) * 2
    names = [f"motor_state[{k}].q" for k in range(12)]
    rows = [",".join(str(x) for x in (k, *(k * (m + 1) * 1e-3 for m in range(12)))) for k in t]
    path.write_text("\n".join([",".join(["time_ms", *names]), *rows]) + "\n")
    motors = ",".join(map(str, order))
    log = read_log(path, columns=f"t=time_ms ms,q='motor_state[{{{motors}}}].q'")
    assert log.n == 12
    np.testing.assert_allclose(log.q[-1], [38e-3 * (m + 1) for m in order])


@pytest.mark.parametrize(
    ("columns", "torque"),
    [
        ("tau1=none", [0.0, 2.0, 3.0]),
        ("tau=e{j},tau2=none", [5.0, 0.0, 7.0]),
        ("tau=[e1,e3],tau2=none", [5.0, 0.0, 7.0]),
        ("tau=e{j},tau1=none,tau3=none", [0.0, 6.0, 0.0]),
    ],
)
def test_joints_without_a_torque_sensor(tmp_path: Path, columns: str, torque: list) -> None:
    """Their torque is in no column, or in one that holds something else."""
    path = tmp_path / "a.csv"
    rows = [f"{0.01 * k},{k},{k},{k},2,3,5,6,7" for k in range(5)]
    path.write_text("\n".join(["t,q1,q2,q3,tau2,tau3,e1,e2,e3", *rows]))
    assert read_log(path, columns=columns).tau[0].tolist() == torque
    with pytest.raises(LogError, match="only that there is none"):
        read_log(path, columns="tau1=e1")


@pytest.mark.parametrize(("there", "absent"), [((2, 3), (1,)), ((1, 3), (2,)), ((1, 2), (3,))])
def test_a_missing_torque_is_told_with_what_reads_the_log(
    tmp_path: Path, there: tuple[int, ...], absent: tuple[int, ...]
) -> None:
    """A gripper's finger, whose torque nobody measures, has no column, or one without a number."""
    own = {"t": T, "q1": T, "q2": T, "q3": T, **{f"tau{k}": k + T for k in there}}
    path = save(tmp_path / "a.csv", own)
    with pytest.raises(LogError) as info:
        read_log(path)
    columns = str(info.value.hint).split('"')[1]
    assert columns == ",".join(f"tau{k}=none" for k in absent)
    read = read_log(path, columns=columns)
    assert read.tau is not None
    assert [float(read.tau[0, k - 1]) for k in (*there, *absent)] == [*there, 0.0]
    empty = save(tmp_path / "b.csv", own | {f"tau{k}": np.nan * T for k in absent})
    with pytest.raises(LogError) as info:
        check_log(read_log(empty), n=3, robot_name="arm")
    assert f'columns="{columns}"' in str(info.value.hint)


def test_a_known_external_torque_is_subtracted_and_this_is_said(tmp_path: Path) -> None:
    """A load cell behind the drive of joint 2: the motor gives friction and what the cell tells."""
    friction = np.stack([0.2 * np.cos(T), 0.3 * np.sin(T)], 1)
    cell = np.array([4.0, 5.0, 6.0, 5.0, 4.0])
    tau = friction + np.stack([np.zeros(5), cell], 1)
    own = {"t": T, "q1": T, "q2": T, "tau1": tau[:, 0], "tau2": tau[:, 1]}
    named = save(tmp_path / "named.csv", own | {"ext2": cell})
    mapped = save(tmp_path / "mapped.csv", own | {"load_cell": -1e3 * cell})
    for path, columns in ((named, None), (mapped, "ext2=-load_cell mNm")):
        log = read_log(path, columns=columns)
        assert log.tau is not None
        assert np.abs(log.tau.numpy() - friction).max() < 1e-12
        (said,) = log.warnings
        assert "External torque is subtracted" in said
        assert "tau2 - ext2" in said
    both = save(tmp_path / "both.csv", own | {"cell1": 0 * cell, "cell2": cell})
    log = read_log(both, columns="ext=cell{j}")
    assert log.tau is not None
    assert np.abs(log.tau.numpy() - friction).max() < 1e-12


def test_an_external_torque_needs_a_torque_and_a_joint(tmp_path: Path) -> None:
    own = {"t": T, "q1": T}
    with pytest.raises(LogError, match="no tau to take them from"):
        read_log(save(tmp_path / "none.csv", own | {"ext1": T}))
    with pytest.raises(LogError, match="no joint of column ext2"):
        read_log(save(tmp_path / "two.csv", own | {"tau1": T, "ext2": T}))


def test_columns_that_were_read_by_their_names_are_not_called_unused(tmp_path: Path) -> None:
    path = save(tmp_path / "named.csv", {"time": T, "pos_1": T, "pos_2": 2 * T, "room": T})
    assert unused_columns(csv_table(path, Request())) == ["room"]
