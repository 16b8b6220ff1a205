"""A run that contradicts the others."""

import pytest
import torch

from tests.gap.small_logs import ONCE, ROBOT, Recording, arm, carrying, friction, logged
from torchid.doctor.hypothesis import Hypothesis, Judge
from torchid.doctor.runs import check_runs
from torchid.doctor.samples import Samples, samples
from torchid.log.model import Log

PLAIN = logged(ROBOT, Recording(ONCE[:2], duration=6.0))


def only(log: Log):
    rows = samples(log)
    assert isinstance(rows, Samples)
    (check,) = check_runs(Judge(ROBOT, rows), Hypothesis.literal(ROBOT))
    return check


def after(robot):
    """The plain runs, and a third one of another arm."""
    return Log.concatenate([PLAIN, logged(robot, Recording((2,), duration=6.0, seed=1))])


def test_a_run_with_a_load_is_named_with_its_mass():
    check = only(after(carrying(0.8, (0.2, 0.0, 0.0), 2e-3)))
    assert check.verdict == "wrong"
    assert check.evidence.startswith("run run2 contradicts the others")
    assert check.estimate == pytest.approx(0.8, rel=0.3)
    assert "apart" in check.fix


def test_a_run_that_agrees_with_another_is_not_the_one_that_contradicts():
    """A load that is grasped during the last run is in none of the others."""
    how = Recording((2,), duration=6.0, seed=1)
    empty, full = (logged(robot, how) for robot in (ROBOT, carrying(1.5, (0.2, 0.0, 0.0), 2e-3)))
    held = torch.arange(len(empty.t)) >= 0.3 * len(empty.t)
    grasped = empty.replace(tau=torch.where(held.unsqueeze(1), full.tau, empty.tau))
    check = only(Log.concatenate([PLAIN, grasped]))
    assert "run0" not in check.evidence
    assert "run1" not in check.evidence


def test_a_run_of_a_warmer_arm_contradicts_none():
    assert only(after(arm(friction(1, Fv=0.4), friction(2, Fc=0.6)))).verdict == "fine"


def test_runs_of_one_arm_agree_and_one_run_has_no_others():
    assert only(PLAIN).verdict == "fine"
    rows = samples(logged(ROBOT, Recording((0,), duration=6.0)))
    assert isinstance(rows, Samples)
    assert check_runs(Judge(ROBOT, rows), Hypothesis.literal(ROBOT)) == []
