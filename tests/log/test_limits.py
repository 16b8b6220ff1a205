"""Logs far outside of the limits of the robot they are said to be of."""

import pytest
import torch

from torchid.log.limits import beyond_limits

from .examples import uniform

WIDE = torch.tensor([[-2.0, 2.0], [-2.0, 2.0]], dtype=torch.float64)


def test_within_the_limits_nothing_is_said() -> None:
    log = uniform(2)
    assert beyond_limits(log) == ()
    size = float(log.signals["tau"].abs().max())
    torque = torch.tensor([[-1.0, 1.0]] * 2, dtype=torch.float64) * size / 2
    assert beyond_limits(log, position_limits=WIDE, torque_limits=torque) == ()
    unknown = torch.tensor([[-torch.inf, torch.inf], [torch.nan, torch.nan]], dtype=torch.float64)
    assert beyond_limits(log, position_limits=unknown, torque_limits=unknown) == ()


@pytest.mark.parametrize(("size", "told"), [(1e3, True), (1.0, False)])
def test_torques_in_another_unit(size: float, told: bool) -> None:
    log = uniform(2)
    tau = log.signals["tau"]
    limits = torch.stack([-tau.abs().amax(0), tau.abs().amax(0)], -1)
    limits[1] = torch.inf
    tau = size * tau
    tau[3] = torch.nan
    tau[7] = 1e9  # a spike
    said = beyond_limits(log.replace(tau=tau), torque_limits=limits)
    assert len(said) == told
    if told:
        assert said[0].startswith("torques more than 3 times the robot's limits (tau1 ")
        assert "tau2" not in said[0]


@pytest.mark.parametrize(("shift", "told"), [(0.2, False), (-2.0, True), (2.0, True)])
def test_positions_of_another_zero(shift: float, told: bool) -> None:
    log = uniform(2)
    q = log.q.clone()
    low, high = q.amin(0), q.amax(0)
    q[:, 1] += shift
    q[5, 0] = torch.inf
    (said,) = beyond_limits(log.replace(q=q), position_limits=torch.stack([low, high], -1)) or ("",)
    assert said.startswith("positions far outside the robot's limits (q2 ") == told
