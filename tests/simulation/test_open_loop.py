"""Rollouts: closed form, batches, sensors undone, divergence."""

from dataclasses import replace

import pytest
import torch

from tests.simulation.bodies import INERTIA, bare, effect, flywheel, reference
from torchid.errors import TorchidError
from torchid.simulation.closed_loop import closed_loop
from torchid.simulation.open_loop import rollout


def test_a_wheel_under_a_ramp_of_torque() -> None:
    """tau = t: dq = t^2 / 2I, q = t^3 / 6I."""
    robot = flywheel()
    t = torch.arange(51, dtype=torch.float64) * 0.01
    zero = torch.zeros(1, 1, dtype=torch.float64)
    linear = rollout(robot, [], zero, zero, t.reshape(1, -1, 1), 0.01)
    assert torch.allclose(linear.dq[0, :, 0], t**2 / (2 * INERTIA), atol=1e-12)
    assert torch.allclose(linear.q[0, :, 0], t**3 / (6 * INERTIA), atol=1e-6)


def test_the_clock_of_each_window_counts() -> None:
    """Friction that drifts with time: a wheel started later loses another speed."""
    robot = flywheel()
    law = [effect(robot, "thermal_friction_drift", joint=1, **_thermal())]
    start, tau = torch.zeros(2, 1, dtype=torch.float64), torch.zeros(2, 51, 1, dtype=torch.float64)
    out = rollout(
        robot,
        law,
        start,
        torch.ones(2, 1, dtype=torch.float64),
        tau,
        0.01,
        torch.tensor([0.0, 100.0], dtype=torch.float64),
    )
    alone = rollout(
        robot, law, start[:1], torch.ones(1, 1, dtype=torch.float64), tau[:1], 0.01, 100.0
    )
    assert float((out.dq[0, -1] - out.dq[1, -1]).abs()) > 1e-3
    torch.testing.assert_close(alone.dq[0], out.dq[1], rtol=1e-12, atol=1e-12)


def _thermal() -> dict[str, float]:
    from torchid.effects.registry import KINDS

    return {c.name: 0.2 for c in KINDS["thermal_friction_drift"].coefficients}


@pytest.mark.parametrize(
    ("name", "entries", "undone"),
    [
        ("torque_gain", {"joint": 2, "gain": 0.3}, True),
        ("torque_crosstalk", {"joint": 1, "source_joint": 2, "C": 0.2}, True),
        ("encoder_offset", {"joint": 3, "offset": 0.2}, True),
        ("time_delay", {"joint": 2, "delay": 0.004}, False),
        ("joint_elasticity", {"joint": 2, "compliance": 1e-3}, False),
    ],
)
def test_sensors_are_undone_where_they_can_be(
    name: str, entries: dict[str, float], undone: bool
) -> None:
    """The measured log of an arm, replayed, is the measured log."""
    from torchid.simulation.sensors import sensed_log

    robot = bare("3r")
    law = [effect(robot, name, **entries)]
    (true,) = closed_loop(robot, [reference(robot, 0.2)], [law])
    seen = sensed_log(robot, true, law)
    assert seen.dq is not None
    assert seen.tau is not None
    out = rollout(robot, law, seen.q[:1], seen.dq[:1], seen.tau.unsqueeze(0), 1 / 500)
    assert out.ignored == (() if undone else (name,))
    ((kind, values),) = law
    with_it = replace(robot, effects=(kind.record(values),))
    same = rollout(with_it, [], seen.q[:1], seen.dq[:1], seen.tau.unsqueeze(0), 1 / 500)
    assert same.ignored == out.ignored
    torch.testing.assert_close(same.q, out.q, rtol=1e-12, atol=1e-12)
    if undone:
        assert float((out.q[0] - seen.q).abs().max()) < 1e-4
        plain = rollout(robot, [], seen.q[:1], seen.dq[:1], seen.tau.unsqueeze(0), 1 / 500)
        assert float((plain.q[0] - seen.q).abs().max()) > 1e-3


def test_divergence_is_reported_for_its_arm_only() -> None:
    robot = flywheel()
    tau = torch.ones(3, 40, 1, dtype=torch.float64)
    tau[1, 20:] = 1e9
    tau[2, 10] = float("nan")
    zero = torch.zeros(3, 1, dtype=torch.float64)
    out = rollout(robot, [], zero, zero, tau, 0.01)
    assert out.diverged.tolist() == [False, True, True]
    assert bool(out.q[0].isfinite().all())
    assert out.q[1, :, 0].isfinite().sum() in range(18, 23)
    assert bool(out.q[2, 12:].isnan().all())


def test_a_gain_that_cannot_be_undone_diverges_without_an_error() -> None:
    robot = flywheel()
    law = [effect(robot, "torque_gain", joint=1, gain=-1.0)]
    zero = torch.zeros(1, 1, dtype=torch.float64)
    assert rollout(
        robot, law, zero, zero, torch.ones(1, 5, 1, dtype=torch.float64), 0.01
    ).diverged.tolist() == [True]


def test_the_time_between_samples_is_positive() -> None:
    zero = torch.zeros(1, 1, dtype=torch.float64)
    with pytest.raises(TorchidError, match="positive"):
        rollout(flywheel(), [], zero, zero, torch.ones(1, 5, 1, dtype=torch.float64), 0.0)
