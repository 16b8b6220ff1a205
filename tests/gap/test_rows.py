"""The log that a model was made from, as a file beside the model."""

import hashlib
import io
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from tests.gap.motions import ROBOT
from tests.gap.problems import CUTOFF, measured
from torchid.design.segments import Samples
from torchid.errors import RobotError
from torchid.gap.rows import (
    FINER,
    MOST,
    LogRows,
    kept,
    rows_of,
    source_of,
    stretches,
    trajectories,
    write_with_rows,
)
from torchid.gap.stacked import at_rate
from torchid.identification.base_parameters import base_parameters
from torchid.identification.knowledge import over_parameters
from torchid.robot.library import load_robot
from torchid.robot.model import Robot


def samples() -> Samples:
    return measured([]).samples


def knowing() -> Robot:
    base = base_parameters(ROBOT)
    eye = torch.eye(base.n_rigid, dtype=torch.float64)
    return replace(ROBOT, knowledge=over_parameters(eye, base, (), "monday"))


def test_rows_come_back_as_they_were_written(tmp_path: Path) -> None:
    rows = kept(samples(), ROBOT)
    path = tmp_path / "arm.rows.npz"
    again = LogRows.read(path, rows.write(path), ROBOT)
    for name in ("names", "joints", "rate", "cutoff", "lengths", "starts", "own_velocity"):
        assert getattr(again, name) == getattr(rows, name)
    assert again.signals.keys() == rows.signals.keys() == {"q", "dq", "ddq", "tau"}
    for name, x in again.signals.items():
        assert (x == rows.signals[name]).all()
        assert x.dtype == "float32"
    assert again.source == "run0 and 1 more"


def test_rows_have_twice_the_rate_of_the_fit_and_its_samples() -> None:
    full = samples()
    rows = kept(full, ROBOT)
    assert rows.rate == pytest.approx(FINER / full.interval)
    thin = Samples([at_rate(s, full.rate) for s in trajectories(rows)], CUTOFF)
    count = min(len(thin), len(full)) // 2
    for of in (lambda s: s.tau, lambda s: s.motion.q, lambda s: s.motion.ddq):
        a, b = (x.of([of(s).T for s in x.segments])[:, :count] for x in (full, thin))
        assert float((a - b).square().mean().sqrt()) < 0.01 * float(a.square().mean().sqrt())
    a, b = (x.of([s.motion.sign.T for s in x.segments])[:, :count] for x in (full, thin))
    assert float((a - b).abs().mean()) < 0.02


def test_of_a_long_log_stretches_are_kept_from_all_of_it() -> None:
    some = stretches([5 * MOST, MOST], MOST // 10)
    assert sum(r.stop - r.start for _, r in some) <= MOST
    assert {k for k, _ in some} == {0, 1}
    ends = [r.stop for k, r in some if k == 0]
    assert ends == sorted(ends)
    assert ends[0] < MOST < 4 * MOST < ends[-1]
    assert stretches([10, 20], 5) == [(0, slice(0, 10)), (1, slice(0, 20))]


def test_the_models_file_names_it(tmp_path: Path) -> None:
    path = tmp_path / "arm.yaml"
    write_with_rows(knowing(), kept(samples(), ROBOT), path)
    found = rows_of(load_robot(str(path)))
    assert isinstance(found, LogRows)
    assert found.names == ("run0", "run1")
    write_with_rows(knowing(), None, path)
    assert rows_of(load_robot(str(path))) is None


def test_rows_of_other_joints_are_refused(tmp_path: Path) -> None:
    rows = kept(samples(), ROBOT)
    path = tmp_path / "arm.rows.npz"
    sha256 = rows.write(path)
    other = replace(ROBOT, joint_names=("a", "b", "c"))
    with pytest.raises(RobotError, match="other joints"):
        LogRows.read(path, sha256, other)


Arrays = dict[str, Any]


def held(rows: LogRows) -> Arrays:
    """What a file of rows has."""
    names = ("names", "joints", "rate", "cutoff", "lengths", "starts", "moving", "own_velocity")
    return {name: getattr(rows, name) for name in names} | dict(rows.signals)


def with_one(arrays: Arrays, name: str, value: float) -> Arrays:
    x = arrays[name].copy()
    x[50, 1] = value
    return {name: x}


def wider(arrays: Arrays) -> Arrays:
    """A joint more than the file says."""
    return {k: np.c_[arrays[k], arrays[k][:, 0]] for k in ("q", "dq", "ddq", "tau")}


def empty(arrays: Arrays) -> Arrays:
    some = ("names", "lengths", "starts", "moving", "q", "dq", "ddq", "tau")
    return {k: np.asarray(arrays[k])[:0] for k in some}


DAMAGE: dict[str, tuple[Callable[[Arrays], Arrays], str]] = {
    "a signal is missing": (lambda x: {"tau": None}, "there is no tau"),
    "a field is missing": (lambda x: {"lengths": None}, "lengths"),
    "another length": (lambda x: {"q": x["q"][:-7]}, "q has the shape"),
    "NaN": (lambda x: with_one(x, "tau", np.nan), "tau holds something else"),
    "infinite": (lambda x: with_one(x, "q", np.inf), "q holds something else"),
    "text": (lambda x: {"tau": x["tau"].astype(str)}, "tau holds something else"),
    "objects": (lambda x: {"tau": np.array([[{}]], object)}, "Object arrays"),
    "text for a number": (lambda x: {"rate": "fast"}, "fast"),
    "another number of joints": (wider, "q has the shape"),
    "time goes back": (lambda x: {"starts": x["starts"][::-1]}, "time goes back"),
    "no rate": (lambda x: {"rate": 0.0}, "a rate of 0 Hz"),
    "a negative length": (
        lambda x: {"lengths": (-9, sum(x["lengths"]) + 9)}, "2 trajectories of"
    ),
    "no rows": (empty, "0 trajectories"),
}  # fmt: skip


@cache
def rows_of_a_log() -> LogRows:
    return kept(samples(), ROBOT)


@pytest.mark.parametrize("damage", DAMAGE)
def test_damaged_rows_are_refused_where_they_are_read(damage: str, tmp_path: Path) -> None:
    change, said = DAMAGE[damage]
    arrays = held(rows_of_a_log())
    arrays |= change(arrays)
    content = io.BytesIO()
    np.savez(content, **{k: x for k, x in arrays.items() if x is not None})
    refuses(content.getvalue(), said, tmp_path)


def test_so_is_a_byte_that_has_changed_before_it_was_named(tmp_path: Path) -> None:
    whole = tmp_path / "whole.npz"
    rows_of_a_log().write(whole)
    content = bytearray(whole.read_bytes())
    content[len(content) // 2] ^= 255
    refuses(bytes(content), "", tmp_path)


def refuses(content: bytes, said: str, folder: Path) -> None:
    """A file that the model's yaml names, by its right SHA-256."""
    path = folder / "arm.rows.npz"
    path.write_bytes(content)
    with pytest.raises(RobotError, match="is damaged") as error:
        LogRows.read(path, hashlib.sha256(content).hexdigest(), ROBOT)
    assert said in str(error.value.got)
    assert "`before=...`" in str(error.value)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["monday"], "monday"),
        (["run1[traj=0]", "run1[traj=1]"], "run1"),
        (["a", "b"], "a and 1 more"),
    ],
)
def test_a_log_is_called_by_its_files(names, said) -> None:
    assert source_of(names) == said
