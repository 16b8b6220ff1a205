"""`torchid log show`, and the options that say how a log is read."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.log.recordings import messages_of, write_bag
from torchid.log.columns import columns_of
from torchid.log.readers import read_log, write_log

DEG = math.pi / 180


@pytest.fixture
def foreign(folder, tmp_path) -> tuple[Path, str]:
    """The check log under other names, in degrees and milliseconds; its mapping."""
    log = read_log(folder / "check.csv")
    columns = {"time_ms": 1e3 * log.t.numpy()}
    for k in range(3):
        columns[f"pos_{k}"] = log.q[:, k].numpy() / DEG
        columns[f"eff_{k}"] = -1e3 * log.signals["tau"][:, k].numpy()
    rows = np.stack(list(columns.values()), 1)
    path = tmp_path / "theirs.csv"
    lines = [";".join(columns), *(";".join(repr(float(x)) for x in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path, "t=time_ms ms,q=pos_{j0} deg,tau=-eff_{j0} mNm"


def test_show(command, folder, tmp_path):
    target = tmp_path / "log.json"
    result = command("log", "show", folder / "fit.parquet", "--json", target)
    assert result.code == 0
    assert "3 joints, 2 trajectories" in result.out
    record = json.loads(target.read_text())
    assert record["schema"] == "torchid.log/1"
    log = read_log(folder / "fit.parquet")
    assert record["samples"] == log.samples
    assert [t["rate"] for t in record["trajectories"]] == pytest.approx([100.0, 100.0])
    assert [t["duration"] for t in record["trajectories"]] == pytest.approx(log.duration)
    ranges = {s["signal"]: s["range"] for s in record["signals"]}
    assert ranges["q"][1] == pytest.approx([float(log.q[:, 1].min()), float(log.q[:, 1].max())])
    assert record["absent"] == ["dq", "ddq", "current", "ql", "u"]
    assert record["problem"] is None


def test_a_picture_has_what_looks_wrong(command, folder, tmp_path):
    log, picture = read_log(folder / "check.csv"), tmp_path / "channels.png"
    write_log(log.replace(tau=log.tau.abs()), tmp_path / "sizes.csv")
    result = command("log", "show", tmp_path / "sizes.csv", "--plot", picture)
    assert result.code == 0
    assert "tau1, tau2, tau3: no value is negative" in result.out
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_sum_of_two_columns_is_read(command, folder, tmp_path):
    log = read_log(folder / "check.csv")
    q = log.q.clone()
    q[:, 2] += q[:, 1]
    write_log(log.replace(q=q), tmp_path / "ground.csv")
    mapping, mended = "q=[q1,q2,q3-q2]", tmp_path / "mended.parquet"
    result = command("log", "show", tmp_path / "ground.csv", "--columns", mapping, "--save", mended)
    assert result.code == 0
    torch.testing.assert_close(read_log(mended).q, log.q, atol=1e-6, rtol=0)


def test_convert(command, folder, foreign, tmp_path):
    path, columns = foreign
    target = tmp_path / "ours.parquet"
    result = command("log", "show", path, "--columns", columns, "--out", target)
    assert result.code == 0
    assert "pos_{j0}, in deg" in result.out
    ours, log = read_log(target), read_log(folder / "check.csv")
    for name in ("q", "tau"):
        torch.testing.assert_close(ours.signals[name], log.signals[name], rtol=1e-14, atol=0.0)
    torch.testing.assert_close(ours.t, log.t, rtol=1e-14, atol=0.0)
    before = target.read_bytes()
    assert command("log", "show", path, "--out", target).code == 1
    assert target.read_bytes() == before


@pytest.mark.slow
def test_a_proposed_mapping_works(command, foreign):
    path, _ = foreign
    result = command("log", "show", path)
    assert result.code == 1
    proposed = result.err.split('--columns "')[1].split('"')[0]
    assert proposed == "t=time_ms ms,q=pos_{j0} deg,tau=eff_{j0}"
    result = command("log", "show", path, "--columns", proposed, "--robot", "3r_friction")
    assert result.code == 0
    assert "cannot be used as it is" not in result.out
    result = command("log", "show", path, "--columns", "t=time_ms ms,q=pos_{j0}")
    assert "Of degrees: read it with" in result.out


def test_one_mapping_for_logs_of_several_kinds(command, foreign, folder):
    path, columns = foreign
    way_out = "torchid log show LOG --columns .. --save run.parquet"
    for logs in ((path, folder / "check.csv"), (folder / "check.csv",)):
        result = command("log", "show", *logs, "--columns", columns)
        assert result.code == 1
        assert result.err.count(way_out) == 1
        assert "needs no mapping" in result.err
    other = path.with_name("other.csv")
    other.write_text(path.read_text().replace("pos_", "angle_"))
    result = command("log", "show", path, other, "--columns", columns)
    assert way_out in result.err
    assert "no columns pos_{j0} in order" in result.err
    result = command("log", "show", path, "--columns", "q=angle_{j}")
    assert result.code == 1
    assert way_out not in result.err


def test_steps_back_and_gaps_are_counted(command, folder, tmp_path):
    columns = columns_of(read_log(folder / "check.csv"))
    t = columns["t"].copy()
    t[200:] += 0.5
    t[100], t[101] = t[101], t[100]
    log = read_log(folder / "check.csv").replace(t=torch.from_numpy(t))
    write_log(log, tmp_path / "a.parquet")
    target = tmp_path / "log.json"
    result = command("log", "show", tmp_path / "a.parquet", "--json", target)
    assert result.code == 0
    record = json.loads(target.read_text())
    (timing,) = record["trajectories"]
    assert (timing["gaps"], timing["backwards"]) == (1, 1)
    assert timing["longest"] == pytest.approx(0.51)
    assert "time does not increase" in record["problem"]
    assert "cannot be used as it is" in result.out


def test_rounding_of_stamps_is_no_jitter(command, folder, tmp_path):
    log = read_log(folder / "check.csv")
    for k, start in enumerate((0.0, 1.7e9)):
        write_log(log.replace(t=log.t + start), tmp_path / f"{k}.parquet")
        target = tmp_path / "log.json"
        assert command("log", "show", tmp_path / f"{k}.parquet", "--json", target).code == 0
        record = json.loads(target.read_text())
        (timing,) = record["trajectories"]
        assert timing["jitter"] == 0.0
        assert timing["gaps"] == 0
        assert timing["rate"] == pytest.approx(100.0, rel=1e-7)
        assert record["problem"] is None


def test_a_log_with_holes_is_shown(command, folder, tmp_path):
    columns = {
        name: column.copy() for name, column in columns_of(read_log(folder / "check.csv")).items()
    }
    for name in ("t", "q2", "tau1"):
        columns[name][5:9] = np.nan
    columns["tau3"][:] = np.inf
    np.savez(tmp_path / "a.npz", **columns)
    target = tmp_path / "log.json"
    result = command("log", "show", tmp_path / "a.npz", "--json", target)
    assert result.code == 0
    record = json.loads(target.read_text())
    assert "column t has 4 values that are empty, NaN" in record["problem"]
    ranges = {s["signal"]: s["range"] for s in record["signals"]}
    assert ranges["tau"][2] == [None, None]
    assert ranges["q"][1] == [np.nanmin(columns["q2"]), np.nanmax(columns["q2"])]


def test_repeats_are_shown(command, folder, tmp_path):
    log = read_log(folder / "check.csv")
    write_log(log, tmp_path / "again.csv")
    target = tmp_path / "log.json"
    result = command("log", "show", folder / "check.csv", tmp_path / "again.csv", "--json", target)
    assert "repeated motion" in result.out
    record = json.loads(target.read_text())
    found = [r for r in record["repeats"] if (r["first"], r["second"]) == ("check", "again")]
    assert sum(r["duration"] for r in found) > 0.8 * log.duration[0]
    assert all(r["start_first"] == pytest.approx(r["start_second"], abs=1e-6) for r in found)


def test_a_bag_with_several_topics(command, folder, tmp_path):
    log = read_log(folder / "check.csv")
    names = ["joint_1", "joint_2", "joint_3"]
    topics = {name: messages_of(log, names, (2, 0, 1)) for name in ("/a/states", "/b/states")}
    path = write_bag(tmp_path / "bag", "mcap", topics)
    result = command("log", "show", path)
    assert result.code == 1
    for name in topics:
        assert name in result.err
    target = tmp_path / "log.json"
    result = command(
        "log", "show", path, "--topic", "/b/states", "--robot", "3r_friction", "--json", target
    )
    assert result.code == 0
    assert "/a/states" in result.out
    assert "rad or m" not in result.out  # the robot has no prismatic joint
    record = json.loads(target.read_text())
    assert record["files"][0]["topic"] == "/b/states"
    sources = {s["signal"]: s["source"] for s in record["signals"]}
    assert sources == {"q": "position", "tau": "effort"}
    assert record["signals"][0]["range"][2] == pytest.approx(
        [float(log.q[:, 2].min()), float(log.q[:, 2].max())]
    )
