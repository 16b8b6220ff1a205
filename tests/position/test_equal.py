"""What is known of servos beside the log: a maker's values."""

import math
from dataclasses import replace

import pytest
import torch

from tests.position.planted import planted, robot, true_servos
from torchid.position.data import prepare
from torchid.position.effects import CORE
from torchid.position.equal import SHEET_STD, with_data_sheets
from torchid.position.judge import Equations, equations
from torchid.simulation.servo_loop import windows_of


@pytest.fixture(scope="module")
def known() -> Equations:
    """Of true servos, a third of which the log says nothing of."""
    servos = true_servos(3)
    data = prepare(robot(), planted(servos, motions=2, seconds=8.0, seed=4))
    free = dict.fromkeys(CORE, torch.ones(3, dtype=torch.bool))
    found = equations(data, servos, free, windows_of(data.tracks, 2.0))
    gram, pull = found.gram.clone(), found.pull.clone()
    k = CORE.index("kp")
    gram[:, 2, k], gram[:, 2, :, k], pull[:, 2, k] = 0.0, 0.0, 0.0
    return replace(found, gram=gram, pull=pull)


def test_what_a_log_leaves_open_is_the_makers(known: Equations) -> None:
    sheets = [{}, {"kp": 390.0}, {"kp": 390.0, "clip": 9.0}]
    moves = torch.ones(3, dtype=torch.bool)
    found = with_data_sheets(known, sheets, moves)
    kp, before, after = found.servos.of("kp"), known.deviations(), found.deviations()
    k = CORE.index("kp")
    # Two sources of a logarithm, weighed by their variances.
    for j in (1, 2):
        own, said = float(before[j, k]) ** -2, SHEET_STD**-2
        expected = (own * math.log(260) + said * math.log(390)) / (own + said)
        assert math.log(float(kp[j])) == pytest.approx(expected, abs=1e-6)
        assert float(after[j, k]) == pytest.approx((own + said) ** -0.5, rel=1e-6)
    assert abs(float(kp[2]) - 390) < 15 < abs(float(kp[1]) - 390)
    # Torques are known by their shares of kp, which stay as they were.
    share = found.servos.of("damping") / kp
    assert float(share[2]) == pytest.approx(float((known.servos.of("damping") / 260)[2]), rel=0.02)
    torch.testing.assert_close(found.servos.joint[0], known.servos.joint[0])


def test_a_joint_at_rest_stays_as_it_is(known: Equations) -> None:
    still = torch.zeros(3, dtype=torch.bool)
    found = with_data_sheets(known, [{"kp": 390.0}] * 3, still)
    torch.testing.assert_close(found.servos.joint, known.servos.joint)
