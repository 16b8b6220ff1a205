"""The torque of a robot with effects as a module: the answer's, in any batch, with gradients."""

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

import torchid
from tests.arms import arm
from tests.effects.cases import RATE, robot, trajectory
from torchid.design.columns import Model
from torchid.design.segments import Samples, Segment
from torchid.dynamics import newton_euler
from torchid.effects.base import Effect, JointEffect, Motion
from torchid.effects.inertia import BodyEffect
from torchid.effects.model import ArmModel
from torchid.effects.registry import KINDS, effect_from_record, model_torque
from torchid.effects.transient import Saturation
from torchid.errors import TorchidError
from torchid.robot.model import Robot
from torchid.simulation.closed_loop import closed_loop

LAST = 5
"""A revolute joint, whose own inertia is the same in every posture."""
LONG = {"backlash", "contact", "plane_contact", "kinematic_error"}
"""Kinds that take a second, or load what takes one."""
every_kind = pytest.mark.parametrize(
    "kind",
    [pytest.param(k, id=n, marks=[pytest.mark.slow] * (n in LONG)) for n, k in KINDS.items()],
)
STEP = 1e-6


def with_one(kind: type[Effect]) -> Robot:
    """An arm with one effect, of the size of its example, that acts along the trajectory."""
    effect = kind.exemplar(LAST)
    if issubclass(kind, Saturation):
        effect = replace(effect, limit=1.0)
    return replace(robot(), effects=(effect.record(kind.example.values),))


def piece(start: int = 100, length: int = 40) -> tuple[tuple[Tensor, ...], Tensor]:
    """q, dq, ddq and t of a part of the trajectory."""
    own = trajectory()
    assert own.t is not None
    some = slice(start, start + length)
    return tuple(x[some].clone() for x in own.state), own.t[some]


def random_like(x: Tensor, seed: int) -> Tensor:
    g = torch.Generator().manual_seed(seed)
    return torch.randn(x.shape, generator=g, dtype=torch.float64)


def slope(function: Callable[[float], Tensor]) -> float:
    """Derivative of a sum at 0 by central differences."""
    with torch.no_grad():
        return float(function(STEP) - function(-STEP)) / (2 * STEP)


@every_kind
def test_the_torque_is_what_the_answer_predicts(kind: type[Effect], tmp_path) -> None:
    """Of a file written and read again, cause by cause. Effects that differentiate the model's
    torque see low-passed motion in a diagnosis, and the motion as it is here."""
    own = with_one(kind)
    torchid.write_robot(own, tmp_path / "corrected.yaml")
    model = torchid.load_model(tmp_path / "corrected.yaml")
    state, t = piece(0, 600)
    motion = Motion(*state, t=t)
    segment = Segment("run", RATE, 40.0, motion, torch.zeros_like(motion.q), own_velocity=True)
    pair = effect_from_record(own.effects[0], own)
    known = model_torque(own, [pair], motion)
    if not kind.smooth:
        answered = Model.of(own).torque(segment, Samples([segment], 8.0))
        torch.testing.assert_close(answered, known, rtol=1e-12, atol=1e-12)
    torch.testing.assert_close(model.torque(*state, t), known, rtol=1e-12, atol=1e-11)
    parts = model.parts(*state, t)
    assert list(parts) == ["rigid body", *model.values]
    rigid = newton_euler.inverse_dynamics(own, *state)
    torch.testing.assert_close(parts.pop("rigid body"), rigid, rtol=1e-12, atol=1e-12)
    torch.testing.assert_close(rigid + sum(parts.values()), known, rtol=1e-12, atol=1e-11)
    # What an event did to one log is nothing that a motion does.
    assert any(bool(x.any()) for x in parts.values()) or kind.name == "dropped_samples"


@every_kind
def test_two_motions_at_once_are_each_of_them(kind: type[Effect]) -> None:
    model = ArmModel(with_one(kind))
    each = [piece(), piece(160)]
    many = [torch.stack(x) for x in zip(*(state for state, _ in each), strict=True)]
    both = model.torque(*many, torch.stack([t for _, t in each]))
    for (state, t), tau in zip(each, both, strict=True):
        torch.testing.assert_close(tau, model.torque(*state, t), rtol=1e-12, atol=1e-11)


@pytest.mark.usefixtures("types_unchecked")
@every_kind
def test_gradients_of_motion_values_and_bodies(kind: type[Effect]) -> None:
    """Along a random direction of each, against central differences."""
    model = ArmModel(with_one(kind)).requires_grad_()
    state, t = piece()
    moved = [x.requires_grad_() for x in state]
    leaves = [*moved, *model.parameters()]
    scales = [1.0] * 3 + [float(p.detach().abs().mean()) for p in model.parameters()]
    ways = [
        random_like(x, k) * size for k, (x, size) in enumerate(zip(leaves, scales, strict=True))
    ]
    weight = random_like(moved[0], 9)
    tau = model.torque(*moved, t)
    with torch.no_grad():
        torch.testing.assert_close(tau, model.torque(*moved, t), rtol=1e-12, atol=1e-11)
    slopes = torch.autograd.grad((tau * weight).sum(), leaves)
    for k, (by, way) in enumerate(zip(slopes, ways, strict=True)):
        if k == 3 and kind.name == "backlash":
            continue  # the gear's stiffness is given by its resonance with the body

        def along(step: float, k: int = k, way: Tensor = way) -> Tensor:
            leaves[k].data += step * way
            out = (model.torque(*moved, t) * weight).sum()
            leaves[k].data -= step * way
            return out

        wanted = slope(along)
        assert float((by * way).sum()) == pytest.approx(wanted, rel=1e-4, abs=1e-4 * abs(wanted))


@every_kind
def test_single_precision_in_is_single_precision_out(kind: type[Effect]) -> None:
    model = ArmModel(with_one(kind))
    state, t = piece()
    exact = model.torque(*state, t)
    found = model.torque(*(x.float() for x in state), t)
    assert found.dtype is torch.float32
    assert float((found - exact).abs().max()) < 1e-4 * float(exact.abs().max())


@every_kind
def test_forward_dynamics_inverts_the_torque_or_refuses_by_name(kind: type[Effect]) -> None:
    model = ArmModel(with_one(kind))
    (q, dq, ddq), t = piece()
    tau = model.torque(q, dq, ddq, t)
    (effect,) = model._kinds.values()
    if effect.over_time and not isinstance(effect, JointEffect):
        with pytest.raises(TorchidError, match="other instants") as refused:
            model.forward_dynamics(q, dq, tau, t)
        assert kind.name in str(refused.value.got)
        return
    found = model.forward_dynamics(q, dq, tau, t)
    torch.testing.assert_close(model.torque(q, dq, found, t), tau, rtol=1e-9, atol=1e-9)
    if kind.name != "saturation":  # beyond a clip no reading tells how far
        torch.testing.assert_close(found, ddq, rtol=1e-8, atol=1e-8)


def friction(*more: dict) -> ArmModel:
    """Friction of every kind of loading on one joint of a small arm."""
    records = [
        {"effect": "viscous_friction", "joint": 2, "Fv": 0.4},
        {"effect": "load_dependent_friction", "joint": 2, "mu": 0.1},
        {"effect": "presliding_hysteresis", "joint": 2, "Fh": 0.7, "length": 0.05},
        {"effect": "load_hysteresis", "joint": 3, "mu_h": 0.1, "length": 0.02},
        *more,
    ]
    return ArmModel(replace(arm("3r"), effects=tuple(records)))


def moves(n: int = 3, seed: int = 4) -> list[Tensor]:
    """q, dq, ddq (80, n) of sines that turn."""
    t = torch.arange(80, dtype=torch.float64).unsqueeze(1) / 50
    w = 2.0 + torch.arange(n) + 0.1 * seed
    return [torch.sin(w * t), w * torch.cos(w * t), -(w**2) * torch.sin(w * t)]


LATE = {"effect": "time_delay", "joint": 1, "delay": 0.013}


@given(batch=st.lists(st.integers(0, 3), max_size=3), late=st.booleans(), seed=st.integers(0, 99))
@settings(max_examples=20)
def test_a_batch_of_motions_is_each_of_them(batch: list[int], late: bool, seed: int) -> None:
    model, count = friction(*[LATE] * late), math.prod(batch)
    each = [moves(seed=seed + k) for k in range(count)]
    empty = [torch.zeros(0, 80, 3, dtype=torch.float64)] * 3
    flat = [torch.stack(x) for x in zip(*each, strict=True)] if each else empty
    t = torch.arange(80, dtype=torch.float64) / 50
    tau = model.torque(*(x.reshape(*batch, 80, 3) for x in flat), t)
    assert tau.shape == (*batch, 80, 3)
    for own, motion in zip(tau.reshape(count, 80, 3), each, strict=True):
        torch.testing.assert_close(own, model.torque(*motion, t), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("cut", [1, 30, 79])
def test_a_motion_in_two_pieces_is_the_whole(cut: int) -> None:
    """The second piece begins with the last instant of the first, and its state."""
    model, whole = friction(), moves()
    tau = model.torque(*whole)
    state = model.state(whole[0][:cut])
    assert state.shape == (2,)
    rest = model.torque(*(x[cut - 1 :] for x in whole), state=state)
    torch.testing.assert_close(rest, tau[cut - 1 :], rtol=1e-12, atol=1e-12)
    after = model.state(whole[0][cut - 1 :], state)
    torch.testing.assert_close(after, model.state(whole[0]), rtol=1e-12, atol=1e-12)


@pytest.mark.slow
def test_gradients_of_accelerations() -> None:
    """Of the implicit function, by gradcheck: motion, torque, inertial parameters, coefficients."""
    model = friction().requires_grad_()
    q, dq, ddq = (x[20:23] for x in moves())
    tau = model.torque(q, dq, ddq).detach()

    def accelerations(q: Tensor, dq: Tensor, tau: Tensor, fv: Tensor) -> Tensor:
        name = "values.viscous_friction 2"
        return torch.func.functional_call(model, {name: fv}, (q, dq, tau), {}, tie_weights=False)

    model.forward = model.forward_dynamics  # what `functional_call` calls
    leaves = (q, dq, tau, model.values["viscous_friction 2"].detach())
    assert torch.autograd.gradcheck(accelerations, [x.requires_grad_() for x in leaves], atol=1e-5)


def test_a_trained_body_is_the_torque_at_once() -> None:
    model, motion = friction(), moves()
    before = model.torque(*motion)
    model.pi.data[:, 0] *= 2
    assert not torch.allclose(model.torque(*motion), before)
    torch.testing.assert_close(ArmModel(model.robot).torque(*motion), model.torque(*motion))


def test_gradients_after_a_simulation() -> None:
    """What a simulation without gradients has cached is no obstacle."""
    model = ArmModel(with_one(KINDS["joint_elasticity"]))
    reference = torchid.excite("3r", duration=4.0, restarts=1, iterations=0).log()
    closed_loop(arm("3r"), [reference], [[]])
    (q, dq, ddq), t = piece()
    model.torque(q.requires_grad_(), dq, ddq, t).sum().backward()
    assert q.grad is not None
    assert bool(q.grad.isfinite().all())


def test_what_is_lacking_is_said_by_name() -> None:
    thermal = {"effect": "thermal_friction_drift", "joint": 1, "dFv": 0.1, "dFc": 0.0, "T": 60.0}
    late = {"effect": "time_delay", "joint": 3, "delay": 0.01}
    model, (q, dq, ddq) = friction(thermal, late), moves()
    with pytest.raises(TorchidError, match="depends on time") as told:
        model.torque(q, dq, ddq)
    assert told.value.got == "thermal_friction_drift 1, time_delay 3"
    with pytest.raises(TorchidError, match="one alone is given") as told:
        model.torque(q[0], dq[0], ddq[0], torch.tensor(0.0))
    assert "presliding_hysteresis 2, load_hysteresis 3, time_delay 3" in str(told.value.got)
    with pytest.raises(TorchidError, match="t does not fit"):
        model.torque(q, dq, ddq, torch.arange(7.0))
    with pytest.raises(TorchidError, match="state does not fit"):
        friction().torque(q, dq, ddq, state=torch.zeros(3))
    with pytest.raises(TorchidError, match="does not say how sure it is"):
        model.sample(2)
    clipped = ArmModel(_clipped())
    with pytest.raises(TorchidError, match="or many do"):
        clipped.forward_dynamics(q, dq, torch.full_like(q, 1e4))


def _clipped() -> Robot:
    record = {"effect": "saturation", "joint": 2, "clip": 1.0, "limit": 1.0}
    return replace(arm("3r"), effects=(record,))


def test_names_of_causes() -> None:
    twice = {"effect": "cogging", "joint": 1, "a_s": 0.1, "a_c": 0.0}
    own = replace(
        arm("3r"),
        effects=(
            {**twice, "k": 12.0},
            {**twice, "k": 24.0},
            {"effect": "torque_crosstalk", "joint": 1, "source_joint": 3, "C": 0.1},
            {"effect": "base_tilt", "tilt_x": 0.01, "tilt_y": 0.0},
        ),
    )
    model = ArmModel(own)
    assert list(model.values) == [
        "cogging 1",
        "cogging 1_",
        "torque_crosstalk 1 from 3",
        "base_tilt",
    ]
    assert [dict(r) for r in model.effects] == [dict(r) for r in ArmModel(model.robot).effects]
    assert "4 effects" in repr(model)


def test_public_dynamics_have_the_effects() -> None:
    own, (q, dq, ddq) = torchid.load_robot("3r_friction"), moves()
    law = torch.tensor(
        [[0.0665, 0.1987, 0.0399], [0.245, 0.1523, 0.1827], [-0.1073, -0.1566, -0.0686]],
        dtype=torch.float64,
    )
    more = law[0] * dq + law[1] * torch.sign(dq) + law[2]
    rigid = torchid.inverse_dynamics(own, q, dq, ddq, rigid=True)
    torch.testing.assert_close(
        rigid, newton_euler.inverse_dynamics(own, q, dq, ddq), rtol=1e-12, atol=1e-12
    )
    torch.testing.assert_close(torchid.inverse_dynamics(own, q, dq, ddq), rigid + more)
    torch.testing.assert_close(torchid.forward_dynamics(own, q, dq, rigid + more), ddq)
    torch.testing.assert_close(torchid.forward_dynamics(own, q, dq, rigid, rigid=True), ddq)
    heavier = torchid.InertialParameters(2 * own.parameters.pi)
    torch.testing.assert_close(torchid.inverse_dynamics(own, q, dq, ddq, heavier), 2 * rigid + more)
    pi = own.parameters.pi.clone().requires_grad_()
    slopes = [
        torch.autograd.grad(
            torchid.inverse_dynamics(
                own, q, dq, ddq, torchid.InertialParameters(pi), rigid=body
            ).sum(),
            pi,
        )
        for body in (False, True)
    ]
    torch.testing.assert_close(*slopes)
    sets = torchid.InertialParameters(own.parameters.pi.expand(2, 1, -1, -1))
    with pytest.raises(TorchidError, match="one set"):
        torchid.inverse_dynamics(own, q, dq, ddq, sets)
    assert torchid.inverse_dynamics(own, q, dq, ddq, sets, rigid=True).shape == (2, 80, 3)


def test_a_simulated_log_has_the_effects() -> None:
    model, (q, dq, ddq) = friction(), moves()
    t = torch.arange(80, dtype=torch.float64) / 50
    log = torchid.simulate(model.robot, torchid.Log(t, q, dq, ddq), noise=None)
    assert log.tau is not None
    torch.testing.assert_close(log.tau, model.torque(q, dq, ddq, t))


def test_bodies_of_files_are_effects_like_others() -> None:
    """A payload in a file is its columns of the regressor, and the arm with the body."""
    kind = KINDS["payload"]
    own = with_one(kind)
    effect, values = effect_from_record(own.effects[0], own)
    assert isinstance(effect, BodyEffect)
    state, t = piece()
    carried = newton_euler.inverse_dynamics(effect.plant(robot(), values), *state)
    torch.testing.assert_close(ArmModel(own).torque(*state, t), carried)
