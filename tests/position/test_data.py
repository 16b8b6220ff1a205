"""Logs of commands and positions that cannot be what they should be, each in a clear sentence."""

from pathlib import Path

import pytest
import torch

import torchid
from tests.position.planted import planted, robot, true_servos
from torchid.errors import LogError, TorchidError
from torchid.export.correct import correct
from torchid.log.model import Log
from torchid.position.data import missing_commands, prepare, tracks_of
from torchid.position.model import ServoArm
from torchid.report.position import change_table
from torchid.results.files import load

ONE = torch.ones(3, dtype=torch.float64)


@pytest.fixture(scope="module")
def log() -> Log:
    return planted(true_servos(3), motions=2, seconds=8.0)


@pytest.mark.parametrize("gain", [1 / 3, 0.5, 2.5, -1.0])
def test_commands_of_another_size_show_at_once(log: Log, gain: float) -> None:
    """Of an actuator with a gear, say; a servo that trails its commands is none."""
    assert log.u is not None
    assert prepare(robot(), log).command_gain.tolist() == [1.0, 1.0, 1.0]
    u = log.u.clone()
    u[:, 1] /= gain
    found = prepare(robot(), log.replace(u=u)).command_gain
    assert found[[0, 2]].tolist() == [1.0, 1.0]
    assert float(found[1]) == pytest.approx(gain, rel=0.15)


def test_missing_commands_are_held(log: Log) -> None:
    assert log.u is not None
    u = log.u.clone()
    u[100:120, 1] = torch.nan
    u[300, 1] = torch.nan
    with_gaps = log.replace(u=u)
    found = tracks_of(with_gaps, ONE).u
    assert torch.equal(found[100:120, 1], log.u[99, 1].expand(20))
    assert torch.equal(found[:, 0], log.u[:, 0])
    assert torch.equal(found[301:], log.u[301:])
    assert missing_commands(with_gaps) == (
        "joint 2: 21 of 800 commands are missing, at most 0.4 s of them in a row: the one before "
        "is held.",
    )
    assert missing_commands(log) == ()
    # Not the last one of the motion before.
    u[400:410, 2] = torch.nan
    with pytest.raises(LogError, match="begins without commands") as info:
        tracks_of(log.replace(u=u), ONE)
    assert info.value.got == "no number in u3 in its first 10 rows"


def test_positions_that_are_no_numbers(log: Log) -> None:
    q = log.q.clone()
    q[7, 1] = torch.nan
    with pytest.raises(LogError, match="column q2 has 1 values that are empty") as info:
        prepare(robot(), log.replace(q=q))
    assert "row 8" in info.value.problem


def test_time(log: Log) -> None:
    with pytest.raises(LogError, match="does not look like seconds") as info:
        tracks_of(log.replace(t=1e3 * log.t), ONE)
    assert "t=t ms" in (info.value.hint or "")
    with pytest.raises(LogError, match="time does not increase"):
        tracks_of(log.replace(t=log.t.clamp(max=3.0)), ONE)
    t = log.t.clone()
    t[50:400] += 1.0
    with pytest.raises(LogError, match="not evenly sampled") as info:
        tracks_of(log.replace(t=t), ONE)
    assert "number the parts in a column traj" in (info.value.hint or "")


@pytest.mark.slow
def test_nothing_to_tell_from(log: Log) -> None:
    still = torch.zeros_like(log.q) + log.q[:1]
    with pytest.raises(LogError, match="no joint moves"):
        prepare(robot(), log.replace(q=still))
    with pytest.raises(LogError, match="too short"):
        prepare(robot(), planted(true_servos(3), motions=1, seconds=5.0))
    with pytest.raises(LogError, match="has no commands"):
        prepare(robot(), log.replace(u=None))


def test_servos_know_the_unit_of_their_logs(log: Log) -> None:
    """Of a motion that says nothing of it, and of one whose velocities do."""
    scale = ONE.clone()
    scale[2] = 2.3
    assert log.u is not None
    other = log.replace(q=log.q / scale, u=log.u / scale)
    assert torch.allclose(prepare(robot(), other, scale).q, prepare(robot(), log).q)
    told = other.replace(dq=prepare(robot(), log).dq)
    assert float(prepare(robot(), told).scale[2]) == pytest.approx(2.3, rel=0.05)
    assert torch.equal(prepare(robot(), told, scale).scale, scale)


def test_a_log_in_another_unit_than_the_servos_is_refused(log: Log, tmp_path: Path) -> None:
    scale = ONE.clone()
    scale[2] = 2.3
    assert log.u is not None
    other = log.replace(q=log.q / scale, u=log.u / scale, dq=prepare(robot(), log).dq)
    arm = ServoArm(robot(), true_servos(3), ONE)
    with pytest.raises(TorchidError, match="joint 3 in another unit than the servos'"):
        correct(robot(), arm, other, "mjcf", tmp_path)


@pytest.mark.slow
def test_servos_of_the_file_that_are_right_leave_no_gap(log: Log, tmp_path: Path) -> None:
    """A second session of an arm that is as it was: nothing is sought, and nothing has changed."""
    std = torch.full_like(true_servos(3).joint, torch.nan)
    std[:, 0] = 0.1
    ServoArm(robot(), true_servos(3), ONE, std).write(tmp_path / "corrected.yaml")
    found = torchid.diagnose(tmp_path / "corrected.yaml", log, force=True)
    assert found.status == "no_gap"
    assert found.answer.error == "the error of the file's servos"
    assert found.answer.after.value < 2.0  # encoder counts of 1.5 mrad
    states = {c.parameter: c.state for c in found.changes if c.joint == 1}
    assert states["delay"] == "as known"
    assert "changed" not in states.values()
    again = load_result(found, tmp_path)
    assert again.changes == found.changes
    table = change_table(found.record)
    assert "as known" in [row[-1] for row in table.rows]
    kept = ServoArm.read(tmp_path / "corrected.yaml")
    assert kept.std is not None
    assert torch.equal(kept.std.isfinite(), std.isfinite())


def load_result(found, folder: Path):
    found.save(folder / "gap.json")
    return load(folder / "gap.json")
