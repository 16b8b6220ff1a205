"""Faults that dynamics show: order, signs, gains, gravity, lag, size; and their silence."""

import dataclasses

import numpy as np
import pytest
import torch

from tests.doctor.synthetic import clean, log_faults, mounted, settled
from tests.doctor.test_signals import NOT_MENDED
from tests.marks import quick_first, some
from torchid.app.options import numbers
from torchid.doctor.examine import examine
from torchid.log.readers import read_log, write_log

SHOWN = (
    "tau in mN m", "tau negated", "tau of a joint negated", "q of a joint negated",
    "q of two joints exchanged", "tau of two joints exchanged", "tip to base",
    "tau of a joint x 0.1", "tau of a joint x 100", "mounted on the ceiling",
    "mounted on a wall", "tilted by 15 deg", "tau 60 ms late", "tau 60 ms early",
)  # fmt: skip


def alarms(result):
    return [c for c in result.checks if c.verdict in ("wrong", "doubtful")]


def check(fault, name, seed, nominal=False):
    robot, log = clean(name, seed, nominal=nominal)
    case = log_faults.FAULTS[fault](robot, log, np.random.default_rng(seed))
    result = examine(case.robot, case.log)
    assert case.found(result.checks), alarms(result)
    return case, result


@pytest.mark.parametrize(
    "fault", quick_first(["q of a joint negated", "tau of a joint negated"], 1)
)
def test_a_sign_is_found_on_its_joint_and_mended(fault):
    case, result = check(fault, "3r", 0)
    again = examine(case.robot, result.mended())
    assert again.silent, alarms(again)


@pytest.mark.slow
def test_a_clean_log_is_silent_and_unchanged():
    robot, log = clean("3r", 0)
    result = examine(robot, log)
    assert result.silent, alarms(result)
    assert result.repairs == ()
    assert torch.equal(result.mended().q, log.q)


@pytest.mark.slow
def test_two_faults_at_once_are_both_found_and_mended():
    robot, log = clean("3r", 1)
    assert log.tau is not None
    sign = torch.tensor([1.0, -1.0, 1.0], dtype=torch.float64)
    bad = log.replace(q=log.q * 180 / torch.pi, tau=log.tau * sign)
    result = examine(robot, bad)
    assert {c.name for c in alarms(result)} == {"position unit", "torque sign"}
    assert torch.allclose(result.mended().q, log.q)
    mended = result.mended().tau
    assert mended is not None
    assert torch.allclose(mended, log.tau)


def test_currents_are_said_to_need_gains():
    robot, log = clean("3r", 0, nominal=True)
    result = examine(robot, log.replace(tau=None, current=log.tau / 10.0))
    (found,) = alarms(result)
    assert found.name == "torque unit"
    assert found.fix is not None
    option, gains, *_ = found.fix.split()
    assert option == "--gain"
    assert numbers(option, gains, 3) == pytest.approx(list(found.estimate), rel=1e-3)
    assert np.median(found.estimate) == pytest.approx(10.0, rel=0.4)


def test_a_log_without_torque_is_examined_all_the_same():
    robot, log = clean("3r", 0)
    result = examine(robot, log.replace(tau=None))
    assert [c.name for c in alarms(result)] == ["torque columns"]


def test_torque_that_no_arm_makes_is_said_to_be_so_and_nothing_else():
    robot, log = clean("3r", 0)
    t = log.t[:, None]
    hum = torch.sin(
        t * torch.tensor([3.1, 4.3, 2.7], dtype=torch.float64)
        + torch.sin(t * torch.tensor([0.9, 0.7, 1.3], dtype=torch.float64))
    )
    result = examine(robot, log.replace(tau=10 * hum))
    assert [c.name for c in alarms(result)] == ["content", "torque explained"]
    assert result.repairs == ()


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.1, 3.0])
def test_a_gain_is_measured(factor):
    robot, log = clean("3r", 0)
    assert log.tau is not None
    gains = torch.tensor([1.0, 1.0, factor], dtype=torch.float64)
    (found,) = alarms(examine(robot, log.replace(tau=log.tau * gains)))
    assert found.joints == (2,)
    assert found.estimate == pytest.approx(factor, rel=0.2)
    assert found.interval is not None
    assert found.interval[0] < found.estimate < found.interval[1]


@pytest.mark.nightly
@pytest.mark.parametrize("nominal", [False, True])
@pytest.mark.parametrize("fault", SHOWN)
def test_every_fault_on_a_small_arm(fault, nominal):
    for seed in range(2):
        check(fault, "3r", seed, nominal)


@pytest.mark.nightly
@pytest.mark.parametrize("fault", [f for f in log_faults.FAULTS if f not in NOT_MENDED])
def test_once_mended_written_and_read_again_the_doctor_is_silent(fault, tmp_path):
    robot, log = clean("3r", 0)
    case = log_faults.FAULTS[fault](robot, log, np.random.default_rng(0))
    if case is None:
        pytest.skip("not a fault that this arm can have")
    result = settled(examine(case.robot, case.log))
    path = tmp_path / "mended.parquet"
    write_log(result.mended(), path)
    again = examine(mounted(result), read_log(path))
    assert again.silent, alarms(again)


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["kuka_lwr4", "ur10e"])
@pytest.mark.parametrize("fault", SHOWN)
def test_every_fault_on_arms_of_six_and_seven_joints(fault, name):
    check(fault, name, 0)


@pytest.mark.parametrize("nominal", [False, True])
@pytest.mark.parametrize("name", some(["3r", "ur10e", "kuka_lwr4", "panda"], 1))
def test_clean_logs_are_silent(name, nominal):
    """Three logs, with gears and without in turn; those of an arm with nominal parameters have
    gears where those without have none."""
    for seed in range(3):
        result = examine(*clean(name, seed, nominal=nominal, gears=(seed % 2 == 0) ^ nominal))
        assert result.silent, alarms(result)


def test_gravity_says_how_the_arm_is_mounted():
    robot, log = clean("3r", 0)
    result = examine(dataclasses.replace(robot, gravity=-robot.gravity), log)
    (found,) = [c for c in alarms(result) if c.name == "gravity"]
    assert found.verdict == "wrong"
    assert "floor" in found.evidence
    assert np.asarray(found.estimate) == pytest.approx([0.0, 0.0, -9.81], abs=0.5)


def test_the_unit_is_judged_by_torque_whose_gains_are_mended():
    robot, log = clean("3r", 1, gears=True)
    gains = torch.tensor([1.0, 100.0, 1.0], dtype=torch.float64)
    (found,) = alarms(examine(robot, log.replace(tau=log.tau * gains)))
    assert (found.name, found.joints) == ("gain of a joint", (1,))
