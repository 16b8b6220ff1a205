"""Files as recorders and scripts leave them: preambles, pairs, units, several files, motors off."""

import json

import numpy as np
import pytest

from torchid.errors import LogError
from torchid.log.readers import read_log, require_log

N = 60
T = 0.01 * np.arange(N)
Q = np.stack([np.sin(w * T) for w in (1, 2, 3)], 1)
TAU = 5 * Q + 1


def table(names, columns, comma=",", decimal="."):
    rows = (comma.join(str(x).replace(".", decimal) for x in row) for row in columns.tolist())
    return "\n".join([*names, *rows]) + "\n"


def of(prefix, end="", n=3):
    return [f"{prefix}{k}{end}" for k in range(1, n + 1)]


HEAD = ",".join(["t", *of("q"), *of("tau")])
WHOLE = np.c_[T, Q, TAU]
BEFORE = ["Robot,KR10", "Exported,2026-11-29 10:00", ""]


@pytest.fixture
def kept(tmp_path):
    def keep(text, name="log.csv"):
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return keep


@pytest.mark.parametrize(
    ("comma", "decimal"), [(",", "."), (";", ","), (";", "."), ("\t", ","), (" ", ".")]
)
@pytest.mark.parametrize("before", [[], BEFORE, ["my log"], ["# a, comment"]], ids=len)
def test_lines_before_the_header_are_left_out(kept, before, comma, decimal) -> None:
    log = read_log(kept(table([*before, HEAD.replace(",", comma)], WHOLE, comma, decimal)))
    assert np.allclose(log.tau.numpy(), TAU)
    said = [w for w in log.warnings if "before the header left out" in w]
    plain = [line for line in before if line and not line.startswith("#")]
    assert len(said) == bool(plain)
    assert all(line in said[0] for line in plain)


def test_a_table_of_pairs_has_the_times_of_each_column(kept) -> None:
    names = [*of("Axis_", ".ActPos"), *of("Trq_", "_Nm")]
    later = 1000 * T + 2.5  # the torques, in ms
    blocks = [np.c_[1000 * T if k < 3 else later, x] for k, x in enumerate(WHOLE[:, 1:].T)]
    head = [
        "Name;Scope Project", "File;run1.svdx", "",
        ";".join(f"Name;{name}" for name in names),
        ";".join(["SampleTime[ms];10"] * 6), "",
    ]  # fmt: skip
    file = kept(table(head, np.concatenate(blocks, 1), ";", ","))
    log = read_log(file)
    said = "t='time [ms]' ms,q=Axis_{j}.ActPos,tau=Trq_{j}_Nm"
    assert any(said in w for w in log.warnings)
    assert log.samples == N - 1
    assert np.allclose(log.t.numpy(), T[1:])
    assert np.allclose(log.tau.numpy(), TAU[:-1] + 0.75 * np.diff(TAU, axis=0), atol=1e-3)


@pytest.mark.parametrize("head", [["t [s]", *of("q", " [deg]")], ["t", *of("q")]])
def test_units_in_brackets(kept, head) -> None:
    under = [] if "[" in head[0] else ["[s];[deg];[deg];[deg]"]
    log = read_log(kept(table([";".join(head), *under], np.c_[T, np.degrees(Q)], ";", ",")))
    assert np.allclose(log.q.numpy(), Q)


@pytest.mark.parametrize(("name", "comma"), [("log.csv", ","), ("log.txt", " ")])
def test_a_last_line_that_is_cut_is_left_out(kept, name, comma) -> None:
    text = table([HEAD.replace(",", comma)], WHOLE, comma)
    cut = text[: text.rindex(comma, 0, -60)]
    log = read_log(kept(cut, name))
    assert log.samples == N - 1
    assert any("the last line ends too soon" in w for w in log.warnings)
    with pytest.raises(LogError):  # in the middle it is a fault of the file
        read_log(kept(text.replace("\n0.3", "\n0.3\n0.3", 1), name))


def records():
    return [
        {"t": t, "q": q, "tau": x}
        for t, q, x in zip(T.tolist(), Q.tolist(), TAU.tolist(), strict=True)
    ]


@pytest.mark.parametrize("inside", [lambda x: x, lambda x: {"robot": "a", "n": [1], "data": x}])
def test_json_is_a_list_of_records(kept, inside) -> None:
    log = read_log(kept(json.dumps(inside(records())), "log.json"))
    assert np.allclose(log.tau.numpy(), TAU)


@pytest.mark.parametrize("text", ["{}", "[]", "[1]", '{"a": [{}], "b": [{}]}', "[{}, 1]", "x"])
def test_other_json_is_no_log(kept, text) -> None:
    with pytest.raises(LogError, match=r"list of objects|JSON") as info:
        read_log(kept(text, "log.json"))
    assert '"tau": [1.0, 2.0]' in str(info.value)


def test_json_lines_whose_last_is_cut(kept) -> None:
    lines = "\n".join(map(json.dumps, records()))
    log = read_log(kept(lines[:-9], "log.jsonl"))
    assert log.samples == N - 1
    assert any("ends too soon" in w for w in log.warnings)


@pytest.mark.parametrize("header", [True, False])
def test_a_file_a_signal_is_joined_by_time(kept, header) -> None:
    slower = np.c_[T, TAU][::2] + np.array([0.003, 0, 0, 0])
    kept(table([",".join(["t", *of("x")])] * header, slower), "log_tau.csv")
    file = kept(table([",".join(["t", *of("x")])] * header, np.c_[T, Q]), "log_q.csv")
    log = read_log(file, columns="t=log_q.csv[:,0],q=log_q.csv[:,1:4],tau=log_tau.csv[:,1:4]")
    inside = (slower[0, 0] <= T) & (slower[-1, 0] >= T)
    assert np.array_equal(log.t.numpy(), T[inside])
    assert np.array_equal(log.q.numpy(), Q[inside])
    expected = [np.interp(T[inside], slower[:, 0], x) for x in slower.T[1:]]
    assert np.allclose(log.tau.numpy(), np.stack(expected, 1))
    assert any("joined by time with log_q.csv, log_tau.csv" in w for w in log.warnings)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (table(["t,x"], np.c_[T + 9, T]), "not recorded at the same time"),
        (table(["t,x"], np.c_[0 * T, T]), "the times of b.csv do not increase"),
        (table(["t,x", "0,a"], np.c_[T, T]), "column x is not numeric"),
    ],
)
def test_a_file_beside_that_does_not_fit(kept, text, said) -> None:
    kept(text, "b.csv")
    with pytest.raises(LogError, match=said):
        read_log(kept(table(["t,q1"], np.c_[T, T])), columns="tau=b.csv[:,1:2]")


def test_actions_and_sensors_are_commands_and_positions(kept) -> None:
    head = ",".join(["timestamp", *(f"{x}_{k}" for x in ("action", "sensor") for k in range(3))])
    log = read_log(kept(table([head], np.c_[T, Q + 1, Q])))
    assert np.array_equal(log.q.numpy(), Q)
    assert np.array_equal(log.u.numpy(), Q + 1)


@pytest.mark.parametrize("own", ["tau_{}", "tau{}"])
def test_the_exact_torque_goes_before_others_which_are_named(kept, own) -> None:
    n = "q_{}" if "_" in own else "q{}"
    names = [x.format(k) for x in (n, own, "tau_ext_{}") for k in (1, 2, 3)]
    log = read_log(kept(table([",".join(["t", *names])], np.c_[T, Q, TAU, Q])))
    assert np.array_equal(log.tau.numpy(), TAU)
    assert any("other torques, left aside: tau_ext_{j}" in w for w in log.warnings)


LONG = 0.05 * np.arange(200)


@pytest.mark.parametrize("off", ["torque_enable", "motor_on", "null"])
def test_rows_with_motors_off_are_no_servo(kept, off) -> None:
    on = (LONG < 3) | (LONG > 6)
    u = [[0.1, 0.2] if here or off != "null" else [None, None] for here in on.tolist()]
    rows = [
        {"t": t, "q": [t, -t], "u": u[k], **({} if off == "null" else {off: bool(on[k])})}
        for k, t in enumerate(LONG.tolist())
    ]
    log = read_log(kept(json.dumps(rows), "log.json"))
    assert (log.trajectory_count, log.samples) == (2, int(on.sum()))
    assert any("the motors are off: left out; 2 trajectories" in w for w in log.warnings)
    # Beside a torque a free fall tells of loads and friction.
    rows = [row | {"tau": [1.0, 2.0], "u": [0.0, 0.0]} for row in rows]
    assert read_log(kept(json.dumps(rows), "log.json")).samples == len(LONG)


def test_commands_hold_over_a_short_gap(kept) -> None:
    rows = [
        {"t": t, "q": [t], "u": [0.1 if k < 3 or k % 10 == 0 else None]}
        for k, t in enumerate(LONG.tolist())
    ]
    assert read_log(kept(json.dumps(rows), "log.json")).samples == len(LONG)


def test_motors_that_are_never_on(kept) -> None:
    rows = [{"t": t, "q": [t], "u": [0.1], "enabled": 0} for t in T.tolist()]
    with pytest.raises(LogError, match="the motors are off in all of it"):
        read_log(kept(json.dumps(rows), "log.json"))


def test_a_folder_of_results_is_no_folder_of_logs(kept) -> None:
    from torchid.log.readers import is_log

    file = kept("{}", "gap.json")
    assert not is_log(file)
    assert require_log(file)
