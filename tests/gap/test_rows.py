"""The log that a model was made from, as a file beside the model."""

from dataclasses import replace
from pathlib import Path

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


def test_another_file_than_the_models_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "arm.yaml"
    write_with_rows(knowing(), kept(samples(), ROBOT), path)
    beside = tmp_path / "arm.rows.npz"
    content = bytearray(beside.read_bytes())
    content[len(content) // 2] ^= 1
    beside.write_bytes(bytes(content))
    with pytest.raises(RobotError, match=r"not the file that the model was written with") as error:
        rows_of(load_robot(str(path)))
    assert "--no-rows" in str(error.value)


def test_a_file_that_is_missing_is_said(tmp_path: Path) -> None:
    path = tmp_path / "arm.yaml"
    write_with_rows(knowing(), kept(samples(), ROBOT), path)
    (tmp_path / "arm.rows.npz").unlink()
    said = rows_of(load_robot(str(path)))
    assert isinstance(said, str)
    assert said.startswith("Caution: ")


def test_rows_of_other_joints_are_refused(tmp_path: Path) -> None:
    rows = kept(samples(), ROBOT)
    path = tmp_path / "arm.rows.npz"
    sha256 = rows.write(path)
    other = replace(ROBOT, joint_names=("a", "b", "c"))
    with pytest.raises(RobotError, match="other joints"):
        LogRows.read(path, sha256, other)


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
