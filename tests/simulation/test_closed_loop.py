"""Arms under control: equations of motion along the result, tracking, batches, rollouts."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from tests.arms import arm, relative
from tests.simulation.bodies import bare, effect, flywheel, reference
from torchid.effects.base import Motion
from torchid.effects.registry import KINDS, Valued, model_torque, nominal_effects
from torchid.errors import LogError, RobotError, TorchidError
from torchid.log.model import Log
from torchid.robot.model import Robot
from torchid.simulation.closed_loop import closed_loop, plant_of
from torchid.simulation.controller import Controller
from torchid.simulation.open_loop import rollout


def _motion(log: Log) -> Motion:
    assert log.dq is not None
    assert log.ddq is not None
    return Motion(log.q, log.dq, log.ddq, t=log.t - log.t[0])


def _tau(log: Log) -> Tensor:
    assert log.tau is not None
    return log.tau


def _mixed_effects(robot: Robot) -> list[Valued]:
    return [
        effect(robot, "coulomb_friction", joint=1, Fc=0.3),
        effect(robot, "stribeck_friction", joint=2, Fs=0.4, vs=0.1),
        effect(robot, "viscous_friction", joint=3, Fv=0.2),
        effect(robot, "rotor_inertia", joint=3, Ia=0.05),
        effect(robot, "load_dependent_friction", joint=2, mu=0.05),
        effect(robot, "torque_offset", joint=1, F0=0.1),
    ]


def test_without_unknown_effects_the_arm_follows() -> None:
    robot = arm("3r")
    log = reference(robot, 1.0)
    (out,) = closed_loop(robot, [log], [[]])
    assert torch.equal(out.t, log.t)
    assert float((out.q - log.q).abs().max()) < 1e-5


def test_the_log_obeys_the_equations_of_motion() -> None:
    robot = bare("3r")
    law = _mixed_effects(robot)
    (out,) = closed_loop(robot, [reference(robot, 1.5)], [law])
    assert out.dq is not None
    error = (model_torque(robot, law, _motion(out)) - _tau(out)).abs()
    moving = out.dq.abs() > 5e-3
    assert float(moving.double().mean()) > 0.9
    assert float(error[moving].max()) < 5e-4
    assert float(error[moving].median()) < 1e-6


@pytest.mark.nightly
def test_effects_change_how_the_arm_moves() -> None:
    robot = bare("3r")
    log = reference(robot, 1.0)
    plain, rough = closed_loop(robot, [log, log], [[], _mixed_effects(robot)])
    assert float((plain.q - rough.q).abs().max()) > 1e-3


def test_nominal_effects_are_in_the_arm_and_in_the_feed_forward() -> None:
    robot = arm("3r")
    record = {"effect": "viscous_friction", "joint": 2, "Fv": 1.5}
    known = replace(bare("3r"), effects=(record,))
    log = reference(robot, 1.0)
    (out,) = closed_loop(known, [log], [[]])
    assert float((out.q - log.q).abs().max()) < 1e-5
    expected = model_torque(known, nominal_effects(known), _motion(out))
    assert relative(_tau(out), expected) < 1e-6


@pytest.mark.nightly
def test_tracking_improves_with_the_gains() -> None:
    robot = bare("3r")
    log = reference(robot, 0.5)
    errors = [
        float(
            (
                closed_loop(robot, [log], [_mixed_effects(robot)], controller=Controller(f))[0].q
                - log.q
            )
            .square()
            .mean()
            .sqrt()
        )
        for f in (3.0, 6.0, 12.0)
    ]
    assert errors[0] > 2 * errors[1] > 4 * errors[2] > 0


@pytest.mark.nightly
def test_a_batch_is_its_arms_one_by_one() -> None:
    """Different references, lengths, torque effects and bodies."""
    robot = bare("3r")
    logs = [reference(robot, s, speed=v) for s, v in ((0.3, 0.8), (0.2, 0.4), (0.25, 0.6))]
    twice = [effect(robot, "cogging", joint=2, a_s=0.1, a_c=0.2, k=k) for k in (4, 12)]
    arms = [
        _mixed_effects(robot),
        [effect(robot, "link_inertia", joint=3, **_body(0.4)), *twice],
        [
            effect(robot, "presliding_hysteresis", joint=1, Fh=0.3, length=0.02),
            effect(robot, "coulomb_friction", joint=2, Fc=0.2, smoothing=0.01),
            effect(robot, "gear_coupling", joint=3, source_joint=2, Fvm=0.1, Iam=0.0, Fcm=0.05),
        ],
    ]
    together = closed_loop(robot, logs, arms)
    for k, log in enumerate(together):
        (alone,) = closed_loop(robot, [logs[k]], [arms[k]])
        assert log.samples == logs[k].samples
        assert float((log.q - alone.q).abs().max()) < 1e-12
        assert relative(_tau(log), _tau(alone)) < 1e-9


def test_arms_with_equal_effects_are_one_and_move_apart() -> None:
    """Recorded once; each has its own reference, and its own past."""
    robot = bare("3r")
    logs = [reference(robot, 0.2, speed=v) for v in (0.8, 0.4)]
    own = [[effect(robot, "presliding_hysteresis", joint=1, Fh=0.3, length=0.02)] for _ in logs]
    like = torch.zeros(2, 3, dtype=torch.float64)
    assert plant_of(robot, own, like).alike
    assert not plant_of(robot, [own[0], []], like).alike
    for log, motion, one in zip(closed_loop(robot, logs, own), logs, own, strict=True):
        (alone,) = closed_loop(robot, [motion], [one])
        assert torch.equal(log.q, alone.q)
        assert torch.equal(_tau(log), _tau(alone))


def _body(mass: float) -> dict[str, float]:
    """A ball of radius 5 cm, 10 cm along x."""
    round_, away = 0.4 * mass * 0.05**2, mass * 0.1**2
    names = ("m", "mx", "my", "mz", "Jxx", "Jxy", "Jxz", "Jyy", "Jyz", "Jzz")
    values = (mass, 0.1 * mass, 0, 0, round_, 0, 0, round_ + away, 0, round_ + away)
    return dict(zip(names, map(float, values), strict=True))


@pytest.mark.parametrize(
    ("name", "entries"),
    [
        ("payload", _body(0.5)),
        ("base_tilt", {"rx": 0.1, "ry": -0.05}),
    ],
)
def test_a_changed_arm_has_the_torque_of_the_changed_arm(
    name: str, entries: dict[str, float]
) -> None:
    robot = bare("3r")
    names = [c.name for c in KINDS[name].coefficients]
    law = effect(robot, name, **dict(zip(names, entries.values(), strict=True)))
    (out,) = closed_loop(robot, [reference(robot, 0.5)], [[law]])
    changed = law[0].plant(robot, law[1])  # type: ignore[attr-defined]
    assert relative(_tau(out), model_torque(changed, [], _motion(out))) < 1e-6
    assert relative(_tau(out), model_torque(robot, [], _motion(out))) > 1e-2


@pytest.mark.nightly
def test_slow_motion_sticks_and_slips_without_chatter() -> None:
    """A wheel pulled slowly over a friction that falls with speed, by a soft controller: it stands
    most of the time, and its speed changes sign no more often than it slips."""
    robot = flywheel()
    law = [
        effect(robot, "coulomb_friction", joint=1, Fc=0.5),
        effect(robot, "stribeck_friction", joint=1, Fs=0.5, vs=0.05),
    ]
    t = torch.arange(1200, dtype=torch.float64) / 500.0
    ramp = 0.03 * t.unsqueeze(-1)
    log = Log(t, ramp, torch.full_like(ramp, 0.03), torch.zeros_like(ramp))
    (out,) = closed_loop(robot, [log], [law], controller=Controller(1.5, 0.3))
    assert out.dq is not None
    stands = (out.dq == 0).squeeze()
    assert 0.5 < float(stands.double().mean()) < 0.99
    assert float(out.dq.min()) > -1e-3
    assert 2 <= int(stands.double().diff().abs().sum()) <= 60
    assert float(_tau(out)[stands].abs().max()) <= 1.0 + 1e-9


def test_torque_stays_within_its_limit() -> None:
    robot = bare("3r")
    log = reference(robot, 0.5, speed=1.5)
    (free,) = closed_loop(robot, [log], [[]])
    limit = tuple((0.6 * _tau(free).abs().amax(0)).tolist())
    (held,) = closed_loop(robot, [log], [[]], controller=Controller(torque_limit=limit))
    assert bool((_tau(held).abs() <= torch.tensor(limit, dtype=torch.float64) * 1.02).all())
    assert float((held.q - log.q).abs().max()) > 1e-3


@pytest.mark.nightly
def test_another_rate_is_the_same_motion() -> None:
    robot = bare("3r")
    log = reference(robot, 0.6, 100.0)
    law = [effect(robot, "viscous_friction", joint=2, Fv=0.5)]
    (slow,) = closed_loop(robot, [log], [law])
    (fast,) = closed_loop(robot, [log], [law], rate=1000.0)
    assert slow.samples == log.samples
    assert fast.samples == 10 * (log.samples - 1) + 1
    assert float((fast.q[::10] - slow.q).abs().max()) < 2e-5


@pytest.mark.nightly
def test_a_rollout_of_the_logged_torque_is_the_logged_motion() -> None:
    robot = bare("3r")
    law = [
        *_mixed_effects(robot),
        effect(robot, "torque_gain", joint=2, gain=0.1),
        effect(robot, "encoder_offset", joint=1, offset=0.05),
        effect(robot, "time_delay", joint=1, delay=1e-3),
    ]
    (log,) = closed_loop(robot, [reference(robot, 1.0)], [law])
    assert log.dq is not None
    windows = [slice(a, a + 250) for a in (20, 150, 250)]
    seen = _tau(log) * torch.tensor([1.0, 1.1, 1.0], dtype=torch.float64)
    q, dq = log.q - torch.tensor([0.05, 0, 0], dtype=torch.float64), log.dq
    out = rollout(
        robot,
        law,
        torch.stack([q[w][0] for w in windows]),
        torch.stack([dq[w][0] for w in windows]),
        torch.stack([seen[w] for w in windows]),
        1 / 500.0,
        torch.stack([log.t[w][0] for w in windows]),
    )
    assert out.ignored == ("time_delay",)
    assert not bool(out.diverged.any())
    for k, w in enumerate(windows):
        assert float((out.q[k] - q[w]).abs().max()) < 2e-3
    without = rollout(robot, [], q[20:21], dq[20:21], _tau(log)[None, 20:270], 1 / 500.0)
    assert float((without.q[0] - q[20:270]).abs().max()) > 2e-2


def test_errors() -> None:
    robot = bare("3r")
    log = reference(robot, 0.1)
    with pytest.raises(TorchidError, match="one list of effects"):
        closed_loop(robot, [log], [])
    with pytest.raises(LogError, match="needs q, dq and ddq"):
        closed_loop(robot, [log.replace(ddq=None)], [[]])
    with pytest.raises(LogError, match="one trajectory"):
        closed_loop(robot, [Log.concatenate([log, log])], [[]])
    with pytest.raises(RobotError, match="no inertial parameters"):
        closed_loop(robot.with_parameters(None), [log], [[]])
    with pytest.raises(TorchidError, match="torque limit"):
        closed_loop(robot, [log], [[]], controller=Controller(torque_limit=(1.0,)))
    with pytest.raises(TorchidError, match="runs away"):
        closed_loop(robot, [log], [[effect(robot, "torque_offset", joint=3, F0=1e9)]])


def test_a_coupled_motor_without_inertia_of_its_own_joint_is_refused() -> None:
    robot = bare("3r")
    coupled = effect(robot, "gear_coupling", joint=2, source_joint=1, Fvm=0.0, Iam=2.0, Fcm=0.0)
    whole = [effect(robot, "rotor_inertia", joint=j, Ia=2.0) for j in (1, 2)]
    closed_loop(robot, [reference(robot, 0.1)], [[coupled, *whole]])
    with pytest.raises(TorchidError, match="not positive definite"):
        closed_loop(robot, [reference(robot, 0.1)], [[coupled]])
