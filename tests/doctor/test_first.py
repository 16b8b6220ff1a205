"""What a diagnosis asks of a log first."""

from dataclasses import replace
from unittest.mock import patch

import pytest
import torch

from tests.gap.small_logs import ONCE, ROBOT, Recording, arm, friction, logged
from torchid.doctor.check import judged
from torchid.doctor.examine import Examination, examine
from torchid.doctor.first import Doubts, WrongLogError, ask_first
from torchid.gap.diagnose import diagnose
from torchid.gap.settings import GapSettings

SOUND = logged(ROBOT, Recording(ONCE, duration=6.0))


def negated(joint: int):
    sign = torch.ones(3, dtype=torch.float64)
    sign[joint - 1] = -1.0
    return SOUND.replace(tau=SOUND.tau * sign)


def exchanged():
    return SOUND.replace(tau=SOUND.tau[:, [0, 2, 1]])


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (lambda: negated(2), "torque sign of joint 2"),
        pytest.param(exchanged, "joint order of joints 2, 3", marks=pytest.mark.slow),
        pytest.param(lambda: SOUND.replace(t=1e3 * SOUND.t), "time unit", marks=pytest.mark.slow),
    ],
)
def test_a_wrong_log_stops_and_says_how_it_is_mended(change, name):
    with pytest.raises(WrongLogError, match=name) as stop:
        ask_first(ROBOT, change())
    assert stop.value.got
    assert stop.value.expected
    assert "force=True" in stop.value.hint
    assert stop.value.examination.repairs or stop.value.examination.undecided


def test_a_sound_log_raises_no_doubt():
    assert ask_first(ROBOT, SOUND).short == ""
    assert ask_first(ROBOT, SOUND).warnings == ()


def test_what_bodies_explain_to_rounding_is_not_searched() -> None:
    """No fault's mending could gain enough; the whole examination, which says what every move would
    cost, has the same verdicts. One fault, and it is searched."""
    quiet = logged(ROBOT, Recording(ONCE, duration=6.0, noise=0.01))
    first, whole = examine(ROBOT, quiet, first=True), examine(ROBOT, quiet)
    assert first.search is not None
    assert whole.search is not None
    assert not first.search.costs
    assert whole.search.costs
    assert first.search.left.tolist() == pytest.approx(whole.search.left.tolist())
    verdicts = {c.name: c.verdict for c in whole.checks}
    assert all(verdicts[c.name] == c.verdict for c in first.checks)
    faulty = examine(ROBOT, negated(2), first=True).search
    assert faulty is not None
    assert faulty.costs


@pytest.mark.slow
def test_of_a_loaded_arm_torque_of_another_size_is_no_doubt():
    """But torque in another unit is one whatever it carries."""
    heavy = SOUND.replace(tau=3.0 * SOUND.tau)
    assert ask_first(ROBOT, heavy).short.startswith("Doubt: measured torque is 3")
    assert ask_first(ROBOT, heavy, loaded=True).short == ""
    with pytest.raises(WrongLogError, match="torque unit"):
        ask_first(ROBOT, SOUND.replace(tau=1e3 * SOUND.tau), loaded=True)


@pytest.mark.slow
def test_forced_the_fault_is_said_first():
    few = GapSettings(effects=("coulomb_friction",))
    with pytest.raises(WrongLogError):
        diagnose(ROBOT, negated(2), settings=few)
    found = diagnose(ROBOT, negated(2), settings=few, force=True)
    assert found.answer.headline.startswith("Wrong log: torque sign of joint 2.\n")
    assert not found.answer.confirmed
    assert "…" not in found.doubt
    assert found.warnings[0].startswith("Caution: torque has the wrong sign in joint 2")
    assert found.record.answer.doubt == found.doubt


@pytest.mark.slow
def test_forced_a_unit_that_looks_wrong_is_not_refused_again():
    few = GapSettings(effects=("coulomb_friction",))
    degrees = SOUND.replace(q=SOUND.q.rad2deg(), dq=None)
    limits = torch.tensor([[-3.0, 3.0]] * 3, dtype=torch.float64)
    robot = replace(ROBOT, limits=replace(ROBOT.limits, position=limits))
    found = diagnose(robot, degrees, settings=few, force=True)
    assert found.doubt.startswith("Wrong log: position unit")
    assert any("looks like degrees" in said for said in found.warnings)


def test_a_doubt_says_its_number_and_what_mends_it():
    late = judged("lag", "doubtful", "torque is 12.5 ms late (9.1 to 15.9 ms)", fix="tau(t) = x")
    found = Examination(ROBOT, SOUND, (late,))
    with patch("torchid.doctor.first.examine", return_value=found):
        doubts = ask_first(ROBOT, SOUND)
    assert doubts.short == "Doubt: torque is 12.5 ms late; tau(t) = x."
    assert doubts.warnings == ("Caution: torque is 12.5 ms late (9.1 to 15.9 ms); tau(t) = x.",)
    assert not doubts.wrong


@pytest.mark.slow
@pytest.mark.parametrize("size", [3.0, 0.0])
def test_a_doubt_that_the_answer_settles_is_gone_from_the_headline(size):
    log = logged(arm(friction(2, Fv=size)), Recording(ONCE, duration=6.0))
    few = GapSettings(effects=("viscous_friction",))
    doubts = Doubts("Doubt: torque is 12 ms late.", ("Caution: torque is 12 ms late.",))
    with patch("torchid.gap.diagnose.ask_first", return_value=doubts):
        found = diagnose(ROBOT, log, settings=few)
    assert found.doubt == "", found.answer.headline
    assert found.warnings[0] == doubts.warnings[0]
    wrong = replace(doubts, short="Wrong log: lag.", wrong=True)
    with patch("torchid.gap.diagnose.ask_first", return_value=wrong):
        assert diagnose(ROBOT, log, settings=few).answer.headline.startswith("Wrong log: lag.")
