"""Explanations that a log cannot tell apart: all are named, none is applied until one is chosen."""

import numpy as np
import pytest
import torch

from tests.doctor.synthetic import clean, log_faults
from tests.marks import quick_first, some
from torchid.doctor.check import Choice, judged, with_choices
from torchid.doctor.examine import conclusion, examine, untold_checks
from torchid.doctor.repair import DropRows
from torchid.dynamics.regressor import regressor
from torchid.errors import LogError


def bad(fault, name="3r"):
    robot, log = clean(name, 0)
    case = log_faults.FAULTS[fault](robot, log, np.random.default_rng(0))
    return case.robot, case.log


def choices(result):
    return {choice.name for check in result.undecided for choice in check.choices}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "names"),
    [
        ("tau in mN m", {"torque unit mNm", "torque unit Ncm"}),
        ("t 2.5 times too slow", {"time scale", "velocity scale"}),
    ],
)
def test_nothing_is_applied_until_one_is_chosen(fault, names):
    robot, log = bad(fault)
    log = log if fault.startswith("tau") else log.replace(tau=None)
    result = examine(robot, log)
    assert choices(result) == names
    assert result.repairs == ()
    assert torch.equal(result.mended().t, log.t)
    for name in names:
        chosen = examine(robot, log, [name])
        assert chosen.undecided == ()
        (repair,) = chosen.repairs
        assert str(repair) in next(c.fix for c in result.undecided[0].choices if c.name == name)


@pytest.mark.parametrize("gears", quick_first([False, True], 1))
@pytest.mark.parametrize(
    ("signal", "name"),
    quick_first([("t", "time scale"), ("dq", "velocity scale")], 1, several=True),
)
def test_torque_tells_a_slow_clock_from_a_scaled_velocity(signal, name, gears):
    robot, log = clean("3r", 0, gears=gears)
    result = examine(robot, log.replace(**{signal: 2.5 * getattr(log, signal)}))
    (found,) = [c for c in result.checks if c.name == "velocity"]
    assert found.chosen == name
    mended = result.mended()
    assert torch.allclose(mended.t, log.t)
    assert torch.allclose(mended.dq, log.dq)


@pytest.mark.nightly
def test_either_sign_of_a_joint_in_the_plane_of_symmetry():
    """A 3R arm is its own mirror image: torque 1 negated is position 1 negated."""
    robot, log = clean("3r", 0)
    sign = torch.tensor([-1.0, 1.0, 1.0], dtype=torch.float64)
    negated = log.replace(tau=log.tau * sign)
    result = examine(robot, negated)
    assert choices(result) == {"torque sign 1", "position sign 1"}
    assert result.repairs == ()
    assert torch.equal(examine(robot, negated, ["torque sign 1"]).mended().tau, log.tau)
    assert torch.equal(examine(robot, negated, ["position sign 1"]).mended().q, log.q * sign)


@pytest.mark.nightly
def test_what_rests_on_a_choice_waits_for_it():
    robot, log = clean("3r", 0)
    sign = torch.tensor([-1.0, 1.0, -1.0], dtype=torch.float64)
    degrees = log.replace(tau=log.tau * sign, q=log.q * 180 / torch.pi)
    result = examine(robot, degrees)
    assert choices(result) == {"torque sign 1", "position sign 1"}
    mended = result.mended()
    assert torch.allclose(mended.q, log.q)  # found before, and the only explanation
    chosen = examine(robot, degrees, ["torque sign 1"])
    assert torch.equal(chosen.mended().tau, log.tau)
    applied = {c["name"] for c in result.plain()["checks"] if c["applicable"]}
    assert "position unit" in applied


@pytest.mark.slow
def test_a_name_that_is_not_offered_is_refused():
    robot, log = bad("tau in mN m")
    with pytest.raises(LogError, match="no such fix") as error:
        examine(robot, log, ["torque unit kNm"])
    assert error.value.available == ["torque unit mNm", "torque unit Ncm"]


@pytest.mark.parametrize(
    ("name", "turned", "invisible"),
    some([("3r", [0], True), ("3r", [1], False), ("kuka_lwr4", range(7), True)], 2, several=True),
)
def test_mirrored_bodies_make_the_torques_of_axes_turned_around(name, turned, invisible):
    """By least squares on the regressor, without the doctor: are -tau over -q of these joints a
    rigid body's torques too?"""
    robot, log = clean(name, 0)
    sign = torch.ones(robot.n, dtype=torch.float64)
    sign[list(turned)] = -1.0
    generator = torch.Generator().manual_seed(0)
    motion = torch.randn(3, 100, robot.n, generator=generator, dtype=torch.float64)
    parameters = torch.randn(10 * robot.n, generator=generator, dtype=torch.float64)
    tau = regressor(robot, *motion) @ parameters * sign
    matrix = regressor(robot, *(x * sign for x in motion)).flatten(0, 1)
    left = tau.flatten() - matrix @ torch.linalg.lstsq(matrix, tau.flatten(), driver="gelsd")[0]
    assert (float(left.norm() / tau.norm()) < 1e-9) is invisible
    result = examine(robot, log)
    shown = [c for c in result.checks if c.name == "unseen joint sign"]
    assert any(set(c.joints) == set(turned) for c in shown) is invisible


def test_a_log_too_short_is_not_said_to_be_fine():
    result = examine(*clean("kuka_lwr4", 0, duration=6.0))
    assert result.silent
    text = conclusion(result)
    assert text.startswith("No fault found in what could be checked. This log cannot tell:")
    assert "joint order" in text
    assert "the log lasts" in text
    assert result.plain()["conclusion"] == text
    assert set(result.plain()["untold"]) >= {"joint order", "torque sign", "gravity", "lag"}


@pytest.mark.slow
def test_a_good_log_says_so():
    result = examine(*clean("3r", 0))
    assert untold_checks(result) == ()
    assert conclusion(result) == "Nothing speaks against this log."


def test_one_joint_that_moves_shows_nothing_about_the_others():
    robot, log = clean("3r", 0)
    still = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
    alone = log.replace(q=log.q * still, dq=log.dq * still, ddq=None, tau=log.tau)
    result = examine(robot, alone)
    assert "joint order" in untold_checks(result)
    assert "This log cannot tell:" in conclusion(result)


def test_a_doubtful_repair_waits_until_it_is_chosen():
    offer = Choice.by("gain of joint 2", DropRows((0,), "a test"))
    found = judged("size", "doubtful", "joint 2: may be a gain", joints=(1,))
    waiting = with_choices(found, [offer], (), sure=False)
    assert waiting.repairs == ()
    assert "gain of joint 2" in str(waiting.fix)
    assert not waiting.undecided  # one offer does not stop the checks that follow
    chosen = with_choices(found, [offer], ["gain of joint 2"], sure=False)
    assert (chosen.chosen, chosen.repairs) == ("gain of joint 2", offer.repairs)
    sure = with_choices(found, [offer], ())
    assert (sure.repairs, sure.choices) == (offer.repairs, ())
