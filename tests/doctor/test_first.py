"""What a diagnosis asks of a log first."""

from dataclasses import replace

import pytest
import torch

from tests.gap.small_logs import ONCE, ROBOT, Recording, logged
from torchid.doctor.first import LONGEST, WrongLogError, ask_first
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


@pytest.mark.slow
def test_forced_the_fault_is_said_first():
    few = GapSettings(effects=("coulomb_friction",), rollout=False)
    with pytest.raises(WrongLogError):
        diagnose(ROBOT, negated(2), settings=few)
    found = diagnose(ROBOT, negated(2), settings=few, force=True)
    assert found.answer.headline.startswith("Wrong log: torque sign of joint 2. ")
    assert len(found.answer.headline) <= 160
    assert len(found.doubt) < LONGEST + 15
    assert found.warnings[0].startswith("Caution: torque has the wrong sign in joint 2")
    assert found.record.answer.doubt == found.doubt


@pytest.mark.slow
def test_forced_a_unit_that_looks_wrong_is_not_refused_again():
    few = GapSettings(effects=("coulomb_friction",), rollout=False)
    degrees = SOUND.replace(q=SOUND.q.rad2deg(), dq=None)
    limits = torch.tensor([[-3.0, 3.0]] * 3, dtype=torch.float64)
    robot = replace(ROBOT, limits=replace(ROBOT.limits, position=limits))
    found = diagnose(robot, degrees, settings=few, force=True)
    assert found.doubt.startswith("Wrong log: position unit")
    assert any("looks like degrees" in said for said in found.warnings)
