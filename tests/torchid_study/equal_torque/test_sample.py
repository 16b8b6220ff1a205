"""Families with equal torque: the torque, the violations, the spread, the sampler itself."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.arms import arm, mixed_arm, relative, states
from tests.marks import some
from tests.oracles import PinocchioOracle
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.errors import TorchidError
from torchid.feasibility.bounds import Bounds, read_bounds
from torchid.feasibility.conditions import Conditions, conditions
from torchid.feasibility.margins import feasibility, kinds
from torchid.feasibility.sets import ParameterSets, nominal_set
from torchid.identification.base_parameters import (
    BaseParameters,
    base_parameters,
    random_states,
    stacked_regressor,
)
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid_study.equal_torque import hit_and_run
from torchid_study.equal_torque import sample as equal_torque
from torchid_study.equal_torque.sample import (
    EqualTorqueSets,
    equal_torque_sets,
    equal_torque_space,
    kernel,
)

ROBOTS = ("3r", "kuka_lwr4", "3r_friction", "mixed")
TOTAL = {"3r": (4.0, 8.0), "3r_friction": (4.0, 8.0), "kuka_lwr4": (13.0, 18.0)}


def interior_reference(
    start: ParameterSets, base: BaseParameters, asked: Conditions, outer: Bounds
) -> ParameterSets:
    """The firmly feasible set with the torque of `start`: the analytic centre of all of them."""
    walk = equal_torque_space(start, base, asked, outer)
    region = walk.region(walk.limits(1))
    z, inside = hit_and_run.interior_point(region)
    assert bool(inside[0]), "no set with this torque"
    return walk.sets(hit_and_run.analytic_centre(region, z, 80)[0], ("interior",))


class Setting:
    """A robot with a firmly feasible reference, its conditions and the outer bounds."""

    def __init__(self, robot: Robot, start: ParameterSets, geometry: Bounds, outer: Bounds):
        self.robot, self.start, self.geometry, self.outer = robot, start, geometry, outer
        mass = float(start.parameters.mass.sum())
        total = TOTAL.get(robot.name, (0.8 * mass, 1.2 * mass))
        self.base: BaseParameters = base_parameters(robot, start.effects)
        self.conditions: Conditions = conditions(robot, com_box=geometry.com, total_mass=total)
        self.reference = interior_reference(start, self.base, self.conditions, self.geometry)

    def family(self, **options: object) -> EqualTorqueSets:
        options = {"per_kind": 30, "chains": 12, **options}
        return equal_torque_sets(
            self.robot,
            self.base,
            self.reference,
            self.conditions,
            self.outer,
            **options,  # type: ignore[arg-type]
        )


def feasible_lwr(nominal: ParameterSets) -> ParameterSets:
    """The published parameters with 0.02 kg m^2 more about every axis, which makes a body of
    every link."""
    own = nominal.parameters
    inertia = own.inertia_about_com.clone()
    inertia[..., [0, 3, 5]] += 0.02
    return replace(nominal, parameters=InertialParameters.from_com(own.mass, own.com, inertia))


def boxes_around(start: ParameterSets) -> tuple[Bounds, Bounds]:
    """Bounds with 5 cm and 20 cm of room around the centres of mass."""
    own = start.parameters
    com, mass = own.com[0].unsqueeze(-1), own.mass[0]
    size = 4 * own.inertia_about_link_frame[0].abs().amax(-1, keepdim=True).expand(-1, 6)
    made = []
    for name, room, heaviest in (("normal", 0.05, 3.0), ("loose", 0.2, 6.0)):
        sides = torch.tensor([-room, room], dtype=torch.float64)
        limits = torch.stack([torch.zeros_like(mass), heaviest * mass], -1)
        made.append(Bounds(name, limits, com + sides, torch.stack([-size, size], -1), {}))
    return made[0], made[1]


@lru_cache
def setting(name: str) -> Setting:
    if name == "mixed":
        start = nominal_set(arm(name))
        return Setting(arm(name), start, *boxes_around(start))
    robot = load_robot(name)
    start = nominal_set(robot)
    corrected = "_corrected" if name == "kuka_lwr4" else ""
    if name == "kuka_lwr4":
        start = feasible_lwr(start)
    geometry = read_bounds(robot, f"normal{corrected}")
    return Setting(robot, start, geometry, read_bounds(robot, f"loose{corrected}"))


@lru_cache
def family(name: str) -> EqualTorqueSets:
    return setting(name).family()


def of_kind(found: EqualTorqueSets, kind: str) -> ParameterSets:
    return found.sets.part([k for k, own in enumerate(found.kind) if own == kind])


@pytest.mark.parametrize("name", ROBOTS)
def test_the_kernel_is_orthonormal_and_changes_no_torque(name: str) -> None:
    case = setting(name)
    directions = kernel(case.base.grouping)
    p, b = len(case.base.parameter_names), len(case.base)
    assert directions.shape == (p, p - b)
    torch.testing.assert_close(directions.T @ directions, torch.eye(p - b, dtype=torch.float64))
    y = stacked_regressor(case.robot, case.start.effects, random_states(case.robot, seed=5))
    assert float((y @ directions).abs().max()) < 1e-11 * float(y.abs().max())


@pytest.mark.parametrize("name", some(ROBOTS, 1))
def test_torque_is_the_references(name: str) -> None:
    case, found = setting(name), family(name)
    motion = [x.unsqueeze(1) for x in states(case.robot, 20)]
    tau = inverse_dynamics(case.robot, *motion, found.sets.parameters)
    expected = inverse_dynamics(case.robot, *motion, case.reference.parameters)
    assert relative(tau, expected.expand_as(tau)) < 1e-9
    start = inverse_dynamics(case.robot, *motion, case.start.parameters)
    assert relative(expected, start) < 1e-9
    assert torch.equal(found.sets.coefficients, case.start.coefficients.expand(len(found.sets), -1))


@pytest.mark.nightly
@pytest.mark.parametrize("name", ROBOTS)
def test_pinocchio_finds_the_same_torque(name: str) -> None:
    case, found = setting(name), family(name)
    motion = states(case.robot, 4)
    expected = PinocchioOracle(case.start.to_robot(case.robot, 0)).inverse_dynamics(*motion)
    # Pinocchio replaces a negative mass by a tiny positive one.
    for kind in dict.fromkeys(found.kind):
        if kind == "mass":
            continue
        one = of_kind(found, kind).to_robot(case.robot, 0)
        assert relative(PinocchioOracle(one).inverse_dynamics(*motion), expected) < 1e-9


@pytest.mark.nightly
@pytest.mark.parametrize("name", ROBOTS)
def test_each_set_violates_exactly_what_was_asked_for(name: str) -> None:
    case, found = setting(name), family(name)
    checked = feasibility(found.sets, case.conditions)
    for k, kind in enumerate(found.kind):
        asked = set() if kind == "feasible" else set(kind.split("+"))
        assert kinds(checked.reasons(k)) == asked
    for kind in dict.fromkeys(found.kind):
        assert found.kind.count(kind) == 30, found.warnings
    # Prismatic joints and an oblique gravity determine the masses of the mixed arm.
    missing = {"mass", "total_mass"} if name == "mixed" else set()
    assert set(equal_torque.KINDS) - set(found.kind) == missing
    assert len(found.warnings) == len(missing)


@pytest.mark.nightly
@pytest.mark.parametrize(
    "name", [n if n == "3r" else pytest.param(n, marks=pytest.mark.nightly) for n in ROBOTS]
)
def test_feasible_sets_by_the_definitions(name: str) -> None:
    """Bodies by the eigenvalues of the inertia tensors, in numpy; boxes and sums by hand."""
    case = setting(name)
    sets = of_kind(family(name), "feasible").parameters
    mass, com = sets.mass.numpy(), (sets.first_moment / sets.mass.unsqueeze(-1)).numpy()
    xx, xy, xz, yy, yz, zz = np.moveaxis(sets.inertia_about_link_frame.numpy(), -1, 0)
    about_frame = np.moveaxis(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), (0, 1), (2, 3))
    shift = (com**2).sum(-1)[..., None, None] * np.eye(3) - com[..., :, None] * com[..., None, :]
    a, b, c = np.moveaxis(np.linalg.eigvalsh(about_frame - mass[..., None, None] * shift), -1, 0)
    assert (mass > 0).all()
    assert (a > 0).all()
    assert (a + b > c).all()
    box = case.conditions.com_box.numpy()
    assert (com >= box[..., 0]).all()
    assert (com <= box[..., 1]).all()
    low, high = case.conditions.total_mass.tolist()
    assert (mass.sum(-1) > low).all()
    assert (mass.sum(-1) < high).all()


@pytest.mark.parametrize("name", some(ROBOTS, 1))
def test_degrees_are_spread(name: str) -> None:
    case, found = setting(name), family(name)
    checked = feasibility(found.sets, case.conditions)
    for kind, slight in (("inertia", -0.02), ("com", -0.02), ("inertia+com", -0.3)):
        degree = checked.degree[[k for k, own in enumerate(found.kind) if own == kind]]
        assert float(degree.max()) > slight, kind
        assert float(degree.min()) < -0.5, kind
    firm = checked.degree[[k for k, own in enumerate(found.kind) if own == "feasible"]]
    assert float(firm.max()) > 0.08
    assert float(firm.min()) < 0.03


@pytest.mark.nightly
def test_same_seed_same_sets_and_other_kinds_do_not_matter() -> None:
    case = setting("3r")
    options = {"per_kind": 8, "chains": 4}
    one = case.family(kinds=("com", "inertia"), **options)
    two = case.family(kinds=("com", "inertia"), **options)
    assert torch.equal(one.sets.vector, two.sets.vector)
    assert torch.equal(one.cluster, two.cluster)
    alone = case.family(kinds=("inertia",), **options)
    assert torch.equal(of_kind(one, "inertia").vector, alone.sets.vector)
    other = case.family(kinds=("inertia",), seed=1, **options)
    assert not torch.equal(other.sets.vector, alone.sets.vector)


@pytest.mark.nightly
def test_clusters_are_chains_of_one_kind() -> None:
    found = family("kuka_lwr4")
    assert len(set(found.sets.ids)) == len(found.sets) == len(found.kind) == len(found.cluster)
    assert found.sets.ids[0] == "feasible_0001"
    assert "inertia_com_0001" in found.sets.ids
    owners: dict[int, set[str]] = {}
    for chain, kind in zip(found.cluster.tolist(), found.kind, strict=True):
        owners.setdefault(chain, set()).add(kind)
    assert all(len(own) == 1 for own in owners.values())
    for kind in set(found.kind):
        own = [c for c, k in zip(found.cluster.tolist(), found.kind, strict=True) if k == kind]
        assert len(set(own)) > 4


@pytest.mark.slow
def test_analytic_centre_does_not_depend_on_the_start() -> None:
    case = setting("3r")
    asked = case.base, case.conditions, case.geometry
    nominal = interior_reference(case.start, *asked)
    other = interior_reference(of_kind(family("3r"), "com").part([3]), *asked)
    torch.testing.assert_close(other.vector, nominal.vector, rtol=1e-5, atol=1e-7)


def test_kinds_without_a_condition_are_named() -> None:
    case = setting("3r")
    free = conditions(case.robot, com_box=case.geometry.com)
    found = equal_torque_sets(
        case.robot,
        case.base,
        case.reference,
        free,
        case.outer,
        kinds=("total_mass", "feasible"),
        per_kind=4,
        chains=2,
    )
    assert found.kind == ("feasible",) * 4
    assert [w.split(":")[0] for w in found.warnings] == ["kind total_mass"]


def test_published_lwr_has_no_feasible_set() -> None:
    case = setting("kuka_lwr4")
    nominal = nominal_set(case.robot)
    with pytest.raises(AssertionError, match="no set with this torque"):
        interior_reference(nominal, case.base, case.conditions, case.geometry)
    with pytest.raises(TorchidError, match="inertia_3"):
        equal_torque_sets(case.robot, case.base, nominal, case.conditions, case.outer)


def test_bad_requests_are_refused() -> None:
    case = setting("3r")
    with pytest.raises(TorchidError, match="no such kind"):
        case.family(kinds=("inertia+mood",))
    with pytest.raises(TorchidError, match="positive"):
        case.family(per_kind=0)
    with pytest.raises(TorchidError, match="1 set of 3 links"):
        equal_torque_sets(
            case.robot, case.base, setting("kuka_lwr4").start, case.conditions, case.outer
        )


def test_draws_are_uniform() -> None:
    """A unit ball times [0, 1]: mean square radius 3/5, mean and variance of the interval, and no
    chain that stays where it began. The ball is the matrix inequality [[E, v], [v', 1]] > 0."""
    k, eye = 40, torch.eye(4, dtype=torch.float64)
    f = torch.zeros(4, 4, 4, dtype=torch.float64)
    for axis in range(3):
        f[axis, 3, axis] = f[3, axis, axis] = 1.0
    region = hit_and_run.Region(
        torch.tensor([[0.0, 0, 0, 1], [0, 0, 0, -1]], dtype=torch.float64)
        .expand(k, 2, 4)
        .contiguous(),
        torch.tensor([0.5, 0.5], dtype=torch.float64).expand(k, 2).contiguous(),
        f.reshape(16, 4).expand(k, 16, 4).contiguous(),
        eye.flatten().expand(k, 16).contiguous(),
    )
    y = hit_and_run.hit_and_run(region, list(range(k)), 50, 8)
    square = y[..., :3].square().sum(-1)
    error = 4 * float(square.mean(1).std()) / k**0.5
    assert float(square.max()) < 1.0
    assert abs(float(square.mean()) - 0.6) < max(error, 0.02)
    assert abs(float(y[..., 3].mean())) < 0.03
    assert float(y[..., 3].var()) == pytest.approx(1 / 12, rel=0.1)


@pytest.mark.nightly
@settings(max_examples=6, derandomize=True)
@given(seed=st.integers(0, 1000), letters=st.sampled_from(["RR", "RRP", "PRR", "RPRR", "RRRRR"]))
def test_random_arms(seed: int, letters: str) -> None:
    robot = mixed_arm(letters, seed)
    start = nominal_set(robot)
    case = Setting(robot, start, *boxes_around(start))
    found = case.family(kinds=("feasible", "inertia", "com"), per_kind=6, chains=6, seed=seed)
    checked = feasibility(found.sets, case.conditions)
    for k, kind in enumerate(found.kind):
        assert kinds(checked.reasons(k)) == {kind} - {"feasible"}
    assert found.kind.count("feasible") == 6
    motion = [x.unsqueeze(1) for x in states(robot, 5, seed=seed)]
    tau = inverse_dynamics(robot, *motion, found.sets.parameters)
    expected = inverse_dynamics(robot, *motion, start.parameters)
    assert relative(tau, expected.expand_as(tau)) < 1e-9
