"""What the doctor mends, other commands take: after each fault, and after two at once."""

import numpy as np
import pytest
import torch

from tests.doctor.synthetic import clean, log_faults, mounted, settled
from tests.doctor.test_signals import NOT_MENDED
from torchid.doctor.examine import examine
from torchid.doctor.first import ask_first
from torchid.identification.identify import identify
from torchid.log.checks import check_log

MENDED = [f for f in log_faults.FAULTS if f not in NOT_MENDED]
PAIRS = [
    tuple(MENDED[k] for k in np.random.default_rng(seed).choice(len(MENDED), 2, replace=False))
    for seed in range(60)
]


def planted(*faults, name="3r"):
    """The arm and its log with one fault after the other, or None where it cannot have one."""
    robot, log = clean(name, 0, nominal=True)
    for fault in faults:
        case = log_faults.FAULTS[fault](robot, log, np.random.default_rng(1))
        if case is None:
            pytest.skip("not a fault that this arm can have")
        robot, log = case.robot, case.log
    return robot, log


def mended(robot, log):
    """The arm with its gravity, and the examination once the first of all choices is made."""
    result = settled(examine(robot, log))
    return mounted(result), result


def taken(robot, log):
    """Whether the checks of `identify` and of `gap` take a log; a LogError says why not."""
    check_log(log, n=robot.n, robot_name=robot.name, position_limits=robot.limits.position)
    ask_first(robot, log)
    return True


@pytest.mark.nightly
@pytest.mark.parametrize("fault", MENDED)
def test_a_mended_copy_is_identified_and_may_be_diagnosed(fault):
    robot, result = mended(*planted(fault))
    copy = result.mended()
    assert taken(robot, copy)
    assert bool(torch.isfinite(identify(robot, [copy]).std).all())


@pytest.mark.nightly
@pytest.mark.parametrize("faults", PAIRS, ids="; ".join)
def test_after_two_faults_a_mended_copy_is_taken(faults):
    robot, result = mended(*planted(*faults))
    assert taken(robot, result.mended())
