"""One battery for every effect in the registry: a new one is covered by its registry line."""

from dataclasses import fields

import pytest
import torch

from tests.arms import arm, states
from tests.effects.cases import (
    JOINT,
    instances,
    instants,
    on_joint,
    planted,
    robot,
    shape_grid,
    trajectory,
)
from torchid.effects.base import Effect, JointEffect, Motion
from torchid.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from torchid.effects.registry import (
    FAMILIES,
    KINDS,
    effect_from_record,
    effect_kind,
)

JOINT_KINDS = {name: kind for name, kind in KINDS.items() if issubclass(kind, JointEffect)}
ON_A_SLIDER = {
    "1": "1",
    "s": "s",
    "rad": "m",
    "rad/s": "m/s",
    "1/rad": "1/m",
    "1/rad^2": "1/m^2",
    "N m": "N",
    "N m/rad": "N/m",
    "N m s/rad": "N s/m",
    "N m (s/rad)^a": "N (s/m)^a",
    "kg m^2": "kg",
    "rad/(N m)": "m/(N)",
}
"""Units in use, so that a new one gets a line in Coefficient.unit_for and here."""
OF_THE_ARM = {"N/m", "N s/m", "kg", "kg m", "kg m^2", "m", "rad", "m/s^2", "N", "N m"}
"""Units of coefficients that are the same on any joint."""
DISSIPATIVE = (
    "viscous_friction",
    "power_law_friction",
    "coulomb_friction",
    "stribeck_friction",
    "load_dependent_friction",
)

every_kind = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
joint_kind = pytest.mark.parametrize("kind", JOINT_KINDS.values(), ids=JOINT_KINDS)
shaped_kind = pytest.mark.parametrize(
    "kind", [pytest.param(k, id=name) for name, k in JOINT_KINDS.items() if k.shapes]
)


def motion(*batch: int) -> Motion:
    return Motion(*states(arm("3r"), *batch))


@every_kind
def test_registered_under_its_name(kind: type[Effect]) -> None:
    assert effect_kind(kind.name) is kind
    assert FAMILIES[kind.name] == kind.family
    assert kind.coefficients
    assert all(c.name and c.meaning for c in kind.coefficients)
    assert kind.__doc__
    assert all(len(x) > 10 for x in (kind.meaning, kind.remedy, kind.source))
    assert kind.needs <= {"t", "torque", "age", "robot", "velocity"}


@every_kind
def test_units_of_both_joint_types(kind: type[Effect]) -> None:
    for c in kind.coefficients:
        slider = c.unit_for(prismatic=True)
        assert c.unit_for(prismatic=False) == c.unit
        assert ON_A_SLIDER.get(c.unit) == slider or (c.unit == slider and slider in OF_THE_ARM)
    assert {s.unit for s in kind.shapes} <= set(ON_A_SLIDER)


@every_kind
def test_grids_of_shapes_are_in_order_and_in_bounds(kind: type[Effect]) -> None:
    for shape in kind.shapes:
        assert shape.name in {f.name for f in fields(kind)}
        assert shape.meaning
        assert list(shape.grid) in (sorted(set(shape.grid)), sorted(set(shape.grid))[::-1])
        assert shape.low <= min(shape.grid)
        assert max(shape.grid) <= shape.high
        assert shape.low > 0 or not shape.logarithmic


@every_kind
def test_columns_times_coefficients_is_the_torque(kind: type[Effect]) -> None:
    """On an arm with prismatic joints and oblique axes; all columns are finite, and those of some
    instance tell all its coefficients, by least squares."""
    told = False
    for effect in instances(kind):
        values = torch.tensor(planted(effect), dtype=torch.float64)
        columns = effect.torque_columns(trajectory(), robot())
        assert columns.shape == (*trajectory().q.shape, len(values))
        assert bool(columns.isfinite().all())
        torque = effect.all_torques(trajectory(), values.tolist(), robot())
        torch.testing.assert_close(torque, columns @ values, rtol=1e-12, atol=1e-12)
        rows, size = columns.flatten(0, 1), columns.flatten(0, 1).norm(dim=0)
        if bool((size > 0).all()) and float(torch.linalg.cond(rows / size)) < 1e6:
            told = True
            found = torch.linalg.lstsq(rows / size, torque.reshape(-1, 1)).solution.squeeze(-1)
            torch.testing.assert_close(found / size, values, rtol=1e-8, atol=1e-8)
    assert told


@every_kind
def test_a_record_gives_the_effect_back(kind: type[Effect]) -> None:
    for effect in instances(kind):
        values = planted(effect)
        record = effect.record(values)
        assert record["effect"] == kind.name
        again, read = effect_from_record(record, robot())
        assert (again, read) == (effect, values)


@joint_kind
@pytest.mark.parametrize("batch", [(), (1,), (5, 3), (0,)])
def test_any_batch_of_instants(kind: type[JointEffect], batch: tuple) -> None:
    if kind.memory:
        pytest.skip("needs time")
    effect, state = on_joint(kind), instants(trajectory(), *batch)
    columns = effect.columns(state)
    values = planted(effect)
    assert columns.shape == (*batch, len(values))
    torch.testing.assert_close(
        effect.torque(state, values), columns @ torch.tensor(values, dtype=torch.float64)
    )


@joint_kind
def test_coefficients_carry_the_joint_number_from_one(kind: type[JointEffect]) -> None:
    names = on_joint(kind).coefficient_names()
    assert names == [f"{c.name}{JOINT + 1}" for c in kind.coefficients]


@joint_kind
def test_acts_on_its_own_joint_only(kind: type[JointEffect]) -> None:
    """Motion of the other joints does not enter these effects, nor do they feel them."""
    state, effect = trajectory(), on_joint(kind)
    other = torch.arange(state.q.shape[1]) != JOINT
    q, dq, ddq = (x + other for x in state.state)
    assert torch.equal(effect.columns(state), effect.columns(state._replace(q=q, dq=dq, ddq=ddq)))
    assert not effect.torque_columns(state)[:, other].any()


@shaped_kind
def test_a_grid_of_shapes_in_one_batch_is_one_by_one(kind: type[JointEffect]) -> None:
    full = shape_grid(kind, trajectory())
    grids = [g[: min(len(x) for x in full)] for g in full]
    batch = kind.formula(trajectory(), *(g.reshape(-1, 1, 1) for g in grids))
    assert batch.shape == (len(grids[0]), *trajectory().q.shape, len(kind.coefficients))
    for k, values in enumerate(zip(*grids, strict=True)):
        one = kind(JOINT, **{s.name: float(v) for s, v in zip(kind.shapes, values, strict=True)})
        torch.testing.assert_close(batch[k, :, JOINT], one.columns(trajectory()))
        assert float((batch[k] - batch[k - 1]).abs().max()) > 0


def semi_implicit(state: Motion, dt: float) -> Motion:
    """The motion with positions an integrator makes of its speeds: q[k] = q[k-1] + dq[k] dt."""
    steps = state.dq * dt
    steps[..., 0, :] = 0
    return state._replace(q=state.q[..., :1, :] + steps.cumsum(-2))


@joint_kind
def test_formula_is_stepping_through_the_trajectory(kind: type[JointEffect]) -> None:
    """For a batch of arms (B, n), each with its own shapes, from the first instant on."""
    dt = 0.01
    state = semi_implicit(trajectory(), dt)
    shapes = [g[-2:] for g in shape_grid(kind, trajectory())]
    whole = kind.formula(state, *(s.reshape(-1, 1, 1) for s in shapes))
    whole = whole.expand(2, *whole.shape[-3:])

    def instant(k: int) -> Motion:
        return Motion(*(None if x is None else x[k].expand(2, *x.shape[1:]) for x in state))

    rows = [s.unsqueeze(-1).expand(2, state.q.shape[1]) for s in shapes]
    memory = kind.initial(instant(0), *rows)
    for k in range(300):
        columns, memory = kind.advance(instant(k), dt if k else 0.0, memory, *rows)
        torch.testing.assert_close(columns, whole[:, k], rtol=1e-10, atol=1e-12)
    assert (memory is not None) == kind.memory


@pytest.mark.parametrize("name", DISSIPATIVE)
def test_friction_takes_energy(name: str) -> None:
    """The drive's torque against friction has the sign of the speed: dq tau >= 0, both ways."""
    effect = on_joint(JOINT_KINDS[name])
    speed = trajectory().dq[:, JOINT]
    power = speed * effect.torque(trajectory(), [0.5])
    assert float(power.min()) >= 0
    assert float(power[speed > 0].max()) > 0
    assert float(power[speed < 0].max()) > 0


def test_physics_forbids_negative_friction() -> None:
    """All but the power law, which corrects the viscous friction either way."""
    for name in set(DISSIPATIVE) - {"power_law_friction"}:
        assert all(c.non_negative for c in KINDS[name].coefficients)


@joint_kind
def test_what_is_needed_is_asked_for(kind: type[JointEffect]) -> None:
    bare = Motion(*trajectory().state)
    missing = "|".join(kind.needs & {"t", "torque", "age"})
    if not missing:
        assert torch.equal(on_joint(kind).columns(bare), on_joint(kind).columns(trajectory()))
        return
    with pytest.raises(ValueError, match=f"{kind.name} needs the motion's ({missing})"):
        on_joint(kind).columns(bare)


@joint_kind
def test_columns_jump_at_reversals_only_where_they_say_so(kind: type[JointEffect]) -> None:
    """Two instants alike but for the sign of a speed of next to nothing."""
    if kind.memory:
        pytest.skip("the torque of a path")
    at = instants(trajectory())
    dq = torch.tensor([[-1e-9], [1e-9]], dtype=torch.float64).expand(2, len(at.q))
    both = Motion(*(None if x is None else x.expand(2, *x.shape) for x in at))._replace(dq=dq)
    jump = float(on_joint(kind).columns(both).diff(dim=0).abs().max())
    # The asymmetry jumps at the ends of its dead band instead.
    assert (jump > 1e-6) == (kind.jumps and kind.name != "asymmetric_friction")


def test_signs_by_hand() -> None:
    dq = torch.tensor([[0.0, 2.0, 0.0], [0.0, -2.0, 0.0], [0.0, 0.0, 0.0]], dtype=torch.float64)
    state = Motion(torch.zeros(3, 3, dtype=torch.float64), dq, 3 * dq)

    def torque(kind: type[Effect]) -> list[float]:
        return kind(1).torque(state, [0.5]).tolist()

    assert torque(ViscousFriction) == [1.0, -1.0, 0.0]
    assert torque(CoulombFriction) == [0.5, -0.5, 0.0]
    assert torque(TorqueOffset) == [0.5, 0.5, 0.5]
    assert torque(effect_kind("rotor_inertia")) == [3.0, -3.0, 0.0]


def test_smooth_sign_tends_to_the_sharp_one() -> None:
    state = motion(200)
    sharp = CoulombFriction(1).columns(state)
    slow = float(state.dq[:, 1].abs().min())
    gaps = [
        float((CoulombFriction(1, smoothing=s * slow).columns(state) - sharp).abs().max())
        for s in (1.0, 0.3, 0.1, 0.03)
    ]
    assert gaps == sorted(gaps, reverse=True)
    assert gaps[0] > 0.1
    assert gaps[-1] < 1e-12


def test_smooth_sign_has_a_gradient_at_rest() -> None:
    dq = torch.zeros(3, requires_grad=True, dtype=torch.float64)
    column = CoulombFriction(1, smoothing=0.1).columns(Motion(dq, dq, dq))
    (slope,) = torch.autograd.grad(column.sum(), dq)
    assert slope.tolist() == [0.0, 10.0, 0.0]
