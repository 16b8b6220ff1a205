"""Tables of other programs: HDF5, MATLAB, text of all kinds, arrays; what is wrong with them."""

import builtins
import importlib.util
import math
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
import torch
from scipy.io import savemat

from torchid.design.motion import measurements
from torchid.errors import LogError, MissingExtraError
from torchid.log.model import Log
from torchid.log.readers import read_log

from .examples import proposed, uniform
from .test_readers import save

T = 0.1 * np.arange(5)
ARRAYS = {"q": "pos", "dq": "vel", "tau": "trq"}


def arrays_of(log: Log, names: dict[str, str]) -> dict[str, np.ndarray]:
    return {name: log.signals[signal].numpy() for signal, name in names.items()}


def expect(read: Log, log: Log, signals: tuple[str, ...] = tuple(ARRAYS)) -> None:
    assert tuple(read.signals) == signals
    assert torch.equal(read.t, log.t)
    for name in signals:
        assert torch.equal(read.signals[name], log.signals[name]), name


@pytest.fixture
def log() -> Log:
    return uniform(3, samples=40)


MAPPING = "t=time,q=pos,dq=vel,tau=trq"


@pytest.mark.parametrize("columns", ["column", "row"])
@pytest.mark.parametrize("joints_in_rows", [False, True])
def test_mat(tmp_path: Path, log: Log, columns: str, joints_in_rows: bool) -> None:
    values = {k: a.T if joints_in_rows else a for k, a in arrays_of(log, ARRAYS).items()}
    path = tmp_path / "a.mat"
    savemat(path, {"time": log.t.numpy(), **values, "note": "by hand"}, oned_as=columns)
    expect(read_log(path, columns=MAPPING), log)
    own = {
        k: a.T if joints_in_rows else a for k, a in arrays_of(log, {k: k for k in ARRAYS}).items()
    }
    savemat(path, {"t": log.t.numpy(), **own}, oned_as=columns)
    expect(read_log(path), log)


def test_mat_structs(tmp_path: Path, log: Log) -> None:
    path = tmp_path / "a.mat"
    savemat(path, {"run": {"time": log.t.numpy(), "meas": arrays_of(log, ARRAYS)}})
    mapping = str(proposed(path)).split('"')[1]
    assert mapping == "t=run.time,q=run.meas.pos,dq=run.meas.vel,tau=run.meas.trq"
    expect(read_log(path, columns=mapping), log)


def write_v73(path: Path, content: dict) -> None:
    """As MATLAB does: HDF5 behind a header of 512 bytes, arrays transposed."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, array in content.items():
            file.create_dataset(name, data=np.atleast_2d(array).T if array.ndim == 1 else array.T)
    with open(path, "r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def test_mat_v73(tmp_path: Path, log: Log) -> None:
    path = tmp_path / "a.mat"
    write_v73(
        path,
        {"run/time": log.t.numpy(), **{f"run/{k}": v for k, v in arrays_of(log, ARRAYS).items()}},
    )
    expect(read_log(path, columns="t=run.time,q=run.pos,dq=run.vel,tau=run.trq"), log)
    with pytest.raises(LogError) as info:
        read_log(path, columns="t=run.clock,q=run.pos")
    assert "run.pos (40 x 3)" in info.value.available
    assert 'q=run.pos,dq=run.vel,tau=run.trq"' in str(proposed(path))


def test_hdf5(tmp_path: Path, log: Log) -> None:
    path = tmp_path / "a.h5"
    q, tau = log.q.numpy(), log.signals["tau"].numpy()
    with h5py.File(path, "w") as file:
        file["run/time"] = (log.t.numpy() * 1e9).round().astype(np.int64)
        file["run/state"] = np.concatenate([tau, q], 1)
        file["run/image"] = np.zeros((40, 4, 4))
        file["run/scalar"] = 3.0
        for k in range(3):
            file[f"run/joint{k}/vel"] = log.signals["dq"].numpy()[:, k]
    text = "t=run/time ns,q=run/state[:,3:],tau=run/state[:,:3],dq=run/joint{j0}/vel"
    read = read_log(path, columns=text)
    assert torch.allclose(read.t, log.t, atol=1e-15)
    expect(read.replace(t=log.t), log)
    rows = tmp_path / "rows.hdf5"
    with h5py.File(rows, "w") as file:
        file["t"], file["q"] = log.t.numpy(), log.q.numpy()
        file["state"] = np.concatenate([tau, q], 1).T
    expect(read_log(rows, columns="tau=state[[0,1,2],:]"), log, ("q", "tau"))


def test_hdf5_fields_of_a_compound_dataset(tmp_path: Path, log: Log) -> None:
    table = np.zeros(40, dtype=[("t", "f8"), ("p", "f8", (3,))])
    table["t"], table["p"] = log.t.numpy(), log.q.numpy()
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["table"] = table
    expect(read_log(tmp_path / "a.h5", columns="t=table/t,q=table/p"), log, ("q",))


def test_a_wildcard_is_a_trajectory_each(tmp_path: Path) -> None:
    logs = {k: uniform(2, samples=20 + k) for k in (10, 2, 0)}
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for k, one in logs.items():
            file[f"data/demo_{k}/q"], file[f"data/demo_{k}/t"] = one.q.numpy(), one.t.numpy()
        file["data/demo_7/q"] = np.zeros((5, 2))  # without time
    read = read_log(tmp_path / "a.h5", columns="t=data/demo_*/t,q=data/demo_*/q")
    assert read.names == ("a[0]", "a[2]", "a[10]")
    assert [part.samples for part in read.trajectories()] == [20, 22, 30]
    for part, k in zip(read.trajectories(), (0, 2, 10), strict=True):
        assert torch.equal(part.q, logs[k].q)
    assert proposed(tmp_path / "a.h5") == 'perhaps `columns="t=data/demo_*/t,q=data/demo_*/q"`'
    with pytest.raises(LogError, match=r"no columns run_\*/q"):
        read_log(tmp_path / "a.h5", columns="t=data/demo_*/t,q=run_*/q")


def test_lists_in_parquet_are_arrays(tmp_path: Path, log: Log) -> None:
    path = tmp_path / "a.parquet"
    state = list(np.concatenate([log.q.numpy(), log.signals["tau"].numpy()], 1))
    pa.parquet.write_table(pa.table({"t": log.t.numpy(), "state": pa.array(state)}), path)
    expect(read_log(path, columns="q=state[:,0:3],tau=state[:,3:6]"), log, ("q", "tau"))
    for wrong, text in {"state[0:3]": "no column", "state[:,9]": "has no column 9",
                        "state[1:2,0:3]": "cannot be understood", "state[:,3:3]": "is left",
                        "t[:,0:3]": "no table"}.items():  # fmt: skip
        with pytest.raises(LogError, match=text):
            read_log(path, columns=f"q={wrong}")
    pa.parquet.write_table(pa.table({"t": T[:2], "q": [[1.0, 2.0], [3.0]]}), path)
    with pytest.raises(LogError, match="not equally long"):
        read_log(path, columns="q=q")


CSV = {
    "comments": "# recorded by hand\n# on Monday\nms,p1\n0,1.5\n100,2.5\n",
    "names in a comment": "# ms p1\n0 1.5\n100 2.5\n",
    "spaces": "  ms   p1\n   0   1.5  \n 100   2.5\n",
    "decimal comma": "ms;p1\n0;1,5\n100;2,5\n",
    "decimal comma and tab": "ms\tp1\n0\t1,5\n100\t2,5\n",
}


@pytest.mark.parametrize("case", CSV)
@pytest.mark.parametrize("suffix", [".csv", ".txt", ".dat", ".tsv"])
def test_text_as_it_comes(tmp_path: Path, case: str, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_text(CSV[case])
    log = read_log(path, columns="t=ms ms,q=p{j}")
    assert log.t.tolist() == pytest.approx([0, 0.1])
    assert log.q.flatten().tolist() == [1.5, 2.5]


def test_text_without_header(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("".join(f"{t} {2 * t} {3 * t}\n" for t in T))
    log = read_log(path, columns="t=data[:,0],q=data[:,1:3]")
    assert torch.allclose(log.q, torch.tensor(np.stack([2 * T, 3 * T], 1), dtype=torch.float64))
    with pytest.raises(LogError, match="no header line") as info:
        read_log(path)
    assert "data[:,0]" in str(info.value)


@pytest.mark.parametrize(
    ("names", "mapping"),
    [
        (["time_ms", "pos_1", "pos_2", "eff_1", "eff_2"], "t=time_ms ms,q=pos_{j},tau=eff_{j}"),
        (
            ["timestamp", "target_q_0", "target_q_1", "actual_q_0", "actual_q_1", "actual_qd_0",
             "actual_qd_1", "actual_current_0", "actual_current_1"],
            "t=timestamp,q=actual_q_{j0},dq=actual_qd_{j0},i=actual_current_{j0},u=target_q_{j0}",
        ),
        (
            ["Time [s]", "Joint 1 Position (deg)", "Joint 2 Position (deg)",
             "Joint 1 Torque [mNm]", "Joint 2 Torque [mNm]"],
            "t='Time [s]',q='Joint {j} Position (deg)' deg,tau='Joint {j} Torque [mNm]' mNm",
        ),
        (
            ["stamp_ns", "shoulder.pos", "elbow.pos", "shoulder.vel", "elbow.vel"],
            "t=stamp_ns ns,q=[shoulder.pos, elbow.pos],dq=[shoulder.vel, elbow.vel]",
        ),
        (
            ["ts", "pos base [deg]", "pos arm [deg]"],
            "t=ts,q=['pos base [deg]', 'pos arm [deg]'] deg",
        ),
        (
            ["Time (ms)", "wrist_bend pos [deg]", "base pos [deg]", "base vel [deg/s]",
             "wrist_bend vel [deg/s]", "base trq [mNm]", "wrist_bend trq [mNm]"],
            "t='Time (ms)' ms,q=['wrist_bend pos [deg]', 'base pos [deg]'] deg,"
            "dq=['wrist_bend vel [deg/s]', 'base vel [deg/s]'] deg/s,"
            "tau=['wrist_bend trq [mNm]', 'base trq [mNm]'] mNm",
        ),
        (
            ["stamp", "base cmd pos [°]", "arm cmd pos [°]", "base act pos [°]", "arm act pos [°]",
             "temperature [°C]", "base trq [kNm]", "arm trq [kNm]"],
            "t=stamp,q=['base act pos [°]', 'arm act pos [°]'] °,"
            "tau=['base trq [kNm]', 'arm trq [kNm]'] kNm,"
            "u=['base cmd pos [°]', 'arm cmd pos [°]'] °",
        ),
        (
            ["time", "S_pos_deg", "L_pos_deg", "S_torque_nm", "L_torque_nm"],
            "t=time,q=[S_pos_deg, L_pos_deg] deg,tau=[S_torque_nm, L_torque_nm]",
        ),
        (
            ["Zeit [ms]", "Istwinkel A1 [Grad]", "Istwinkel A2 [Grad]", "Sollwinkel A1 [Grad]",
             "Sollwinkel A2 [Grad]", "Drehzahl A1 [1/min]", "Drehzahl A2 [1/min]",
             "Drehmoment A1 [Nm]", "Drehmoment A2 [Nm]"],
            "t='Zeit [ms]' ms,q='Istwinkel A{j} [Grad]' Grad,dq='Drehzahl A{j} [1/min]' 1/min,"
            "tau='Drehmoment A{j} [Nm]',u='Sollwinkel A{j} [Grad]' Grad",
        ),
        (
            ["tiempo", "posicion_1", "posicion_2", "velocidad_1", "velocidad_2"],
            "t=tiempo,q=posicion_{j},dq=velocidad_{j}",
        ),
        (["time", "pos_1", "pos_2", "goal_1", "goal_2"], "t=time,q=pos_{j},u=goal_{j}"),
        (["time", "q_1", "q_2", "q_cmd_1", "q_cmd_2"], "t=time,q=q_{j},u=q_cmd_{j}"),
        (["t", "q1", "q2", "effort_1", "effort_2", "x"], None),
        (["a", "b", "c"], None),
        (["time", "b1", "c1"], None),
        (["time", "pos_7"], None),
    ],
)  # fmt: skip
def test_a_mapping_is_proposed(tmp_path: Path, names: list[str], mapping: str | None) -> None:
    path = save(tmp_path / "a.csv", {name: k + T for k, name in enumerate(names)})
    if names[:2] == ["t", "q1"]:
        log = read_log(path)
        assert list(log.signals) == ["q"]
        assert 'no torque by our names: perhaps `columns="tau=effort_{j}"`' in log.warnings[-1]
        with pytest.raises(LogError, match="has no torque") as info:
            measurements(log, None)
        assert info.value.hint == log.warnings[-1]
        return
    if mapping is None:
        with pytest.raises(LogError) as info:
            read_log(path)
        assert info.value.available == names
        assert str(info.value.hint).startswith("say which are which")
        return
    named = " (joints in the order of the file)" if "=[" in mapping else ""
    assert proposed(path) == f'perhaps `columns="{mapping}"`{named}'
    read = read_log(path, columns=mapping)
    assert read.n == 2
    assert torch.allclose(read.q[:, 1], read.q[:, 0] + (read.q[0, 1] - read.q[0, 0]))


@pytest.mark.parametrize("order", [(0, 1, 2, 3, 4), (3, 0, 4, 2, 1)])
def test_a_mapping_is_proposed_in_the_order_of_the_robot(
    tmp_path: Path, order: tuple[int, ...]
) -> None:
    """The joints of each quantity in another order, beside a gripper's; two of them numbered."""
    joints = ("shoulder_pan_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint")
    labels = ["shoulder_pan", "elbow", "wrist_1", "wrist_2", "gripper"]
    columns = {"Time [s]": T}
    columns |= {f"{labels[k]} pos [deg]": 10 * k + T for k in order}
    columns |= {f"{labels[k]} trq [mNm]": 100 * k + T for k in reversed(order)}
    path = save(tmp_path / "a.csv", columns)
    said = str(proposed(path, joints))
    mapping = said.split('"')[1]
    assert said == f'perhaps `columns="{mapping}"`'
    read = read_log(path, columns=mapping, joints=joints)
    assert read.q[0].tolist() == pytest.approx([math.pi / 18 * k for k in range(4)])
    assert read.signals["tau"][0].tolist() == pytest.approx([0.1 * k for k in range(4)])


@pytest.mark.parametrize("joints", [(), ("pivot",), ("shoulder", "elbow")])
def test_a_mapping_of_the_only_joint_is_proposed(tmp_path: Path, joints: tuple[str, ...]) -> None:
    """Without a number or a name; of several joints such columns are none's."""
    names = ["position", "desired position", "velocity [deg/sec]", "time", "torque [mNm]", "pos_7"]
    path = save(tmp_path / "a.csv", {name: k + T for k, name in enumerate(names)})
    if len(joints) > 1:
        assert str(proposed(path, joints)).startswith("say which are which")
        return
    mapping = (
        "t=time,q=position,dq='velocity [deg/sec]' deg/sec,tau='torque [mNm]' mNm,"
        "u='desired position'"
    )
    assert proposed(path, joints) == f'perhaps `columns="{mapping}"`'
    read = read_log(path, columns=mapping, joints=joints)
    assert read.n == 1
    assert read.q[:, 0].tolist() == pytest.approx(list(T))


def test_names_that_a_shell_would_change_are_not_proposed(tmp_path: Path) -> None:
    path = save(tmp_path / "a.csv", {"time": T, "$a pos": T, "$b pos": T})
    with pytest.raises(LogError) as info:
        read_log(path)
    assert str(info.value.hint).startswith("say which are which")


def without(monkeypatch: pytest.MonkeyPatch, package: str) -> None:
    """As if a package was not installed."""
    real = builtins.__import__

    def importing(name: str, *rest: object, **named: object) -> object:
        if name.partition(".")[0] == package:
            raise ImportError(name)
        return real(name, *rest, **named)

    monkeypatch.setattr(builtins, "__import__", importing)
    found = importlib.util.find_spec
    monkeypatch.setattr(
        "importlib.util.find_spec", lambda name: None if name == package else found(name)
    )


def test_missing_extras(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_v73(tmp_path / "a.mat", {"t": T})
    for name in ("a.h5", "a.bag", "a.mcap", "a.db3"):
        (tmp_path / name).write_bytes(b"not empty")
    without(monkeypatch, "h5py")
    without(monkeypatch, "rosbags")
    for name, extra in (("a.h5", "hdf5"), ("a.mat", "hdf5"), ("a.bag", "ros"), ("a.mcap", "ros")):
        with pytest.raises(MissingExtraError) as info:
            read_log(tmp_path / name)
        assert info.value.hint == f"pip install 'torchid[{extra}]'"
        assert name in str(info.value)


def test_nothing_to_read_in_it(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"note": "nothing"})
    with pytest.raises(LogError, match="no array of numbers") as info:
        read_log(tmp_path / "a.mat")
    assert info.value.got == "note"
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["scalar"] = 1.0
    with pytest.raises(LogError, match="no dataset"):
        read_log(tmp_path / "a.h5")


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"t": T, "p": np.array(["a"] * 5, dtype=object)}, "column p is not numeric"),
        ({"t": T, "p": T[:4]}, "another length than t"),
        ({"t": T, "p": np.zeros((5, 2, 2))}, "wrong number of dimensions"),
        ({"t": np.zeros((5, 2)), "p": T}, "wrong number of dimensions"),
        ({"t": T, "p": T, "w": np.zeros((5, 2))}, "t is one column"),
    ],
)
def test_mapped_columns_are_checked(tmp_path: Path, columns: dict, message: str) -> None:
    if columns["p"].dtype == object:
        path = save(tmp_path / "a.parquet", columns)
    else:
        path = save(tmp_path / "a.npz", columns)
    with pytest.raises(LogError, match=message):
        read_log(path, columns="q=p,t=w" if "w" in columns else "q=p")


def test_only_bags_have_topics(tmp_path: Path) -> None:
    path = save(tmp_path / "a.csv", {"t": T, "q1": T})
    with pytest.raises(LogError, match="has no topics") as info:
        read_log(path, topic="/joint_states")
    assert "torchid log show LOG --topic .. --save run.parquet" in str(info.value.hint)


def test_a_mapped_column_that_is_there_twice(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,p,p\n0,1,2\n1,2,3\n")
    with pytest.raises(LogError, match="two columns p"):
        read_log(tmp_path / "a.csv", columns="q=p")


def test_measured_torque_goes_before_a_computed_one(tmp_path: Path) -> None:
    names = ["time", "pos_1", "pos_2", "computed_torque_1", "computed_torque_2"]
    names += ["motor_torque_1", "motor_torque_2"]
    path = save(tmp_path / "a.csv", {name: k + T for k, name in enumerate(names)})
    assert proposed(path) == 'perhaps `columns="t=time,q=pos_{j},tau=motor_torque_{j}"`'


def test_of_a_table_without_time_the_rate_is_asked_for(tmp_path: Path) -> None:
    names = [f"{what}_{k}" for what in ("pos", "vel") for k in range(4)]
    path = save(tmp_path / "a.csv", {name: k + T for k, name in enumerate(names)})
    said = str(proposed(path, ("a", "b", "c")))
    assert 'columns="t=HZ Hz,q=pos_{0..2},dq=vel_{0..2}"' in said
    assert "HZ: samples a second" in said
    assert "the first 3 of 4 columns" in said
    columns = said.split('"')[1].replace("HZ", "100")
    assert read_log(path, columns=columns).n == 3
    ours = save(tmp_path / "b.csv", {"q1": T, "q2": T})
    assert proposed(ours) == 'perhaps `columns="t=HZ Hz"` (HZ: samples a second)'


def test_of_columns_that_look_alike_none_is_taken(tmp_path: Path) -> None:
    names = ["time", "pos_1", "pos_2", "left eff_1", "left eff_2", "right eff_1", "right eff_2"]
    path = save(tmp_path / "a.csv", {name: k + T for k, name in enumerate(names)})
    assert "several columns may be meant" in str(proposed(path))
