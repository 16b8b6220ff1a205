"""How many base parameters there are, which, and that they give the same torque."""

import math
import runpy
from pathlib import Path

import pytest
import torch

from tests.arms import ARMS, arm, mixed_arm
from tests.excitation.test_excitation import random_arm
from tests.identification.test_paper_tables import coefficients
from tests.marks import quick_first
from torchid.effects.registry import on_every_joint
from torchid.errors import IdentificationError, TorchidError
from torchid.identification.base_parameters import (
    base_parameters,
    group_columns,
    random_states,
    stacked_regressor,
    visible,
)
from torchid.robot.library import load_robot
from torchid.robot.model import Basis, Robot
from torchid.robot.yaml_file import from_mapping

BOTH = pytest.mark.parametrize("basis", ["report", "conditioned"])
EFFECTS = ("viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia")


def dh_arm(joints: list[dict], gravity=(0, 0, -9.81)) -> Robot:
    dh = {"convention": "classical", "joints": [{"d": 0, "theta": 0, **j} for j in joints]}
    return from_mapping({"name": "arm", "dh": dh, "gravity": list(gravity)}, "arm")


def planar(gravity) -> Robot:
    return dh_arm(
        [{"type": "R", "a": 0.4, "alpha": 0}, {"type": "R", "a": 0.3, "alpha": 0}], gravity
    )


def lwr(quarter: float) -> Robot:
    """The LWR's kinematics with twists written as `quarter` for pi/2."""
    turns = (1, -1, -1, 1, 1, -1, 0)
    lengths = (0, 0, 0.4, 0, 0.39, 0, 0)
    return dh_arm(
        [
            {"type": "R", "a": 0, "alpha": s * quarter, "d": d}
            for s, d in zip(turns, lengths, strict=True)
        ]
    )


ALONG, ACROSS = (0, 0, -9.81), (0, -9.81, 0)

COUNTS = {
    "3r": (lambda: load_robot("3r"), 15),
    "kuka_lwr4": (lambda: load_robot("kuka_lwr4"), 43),
    # Gautier and Khalil (1990): 7 n for n revolute joints, none parallel to the next or to gravity,
    # less 4 of the first link, which turns in a plane: J, m c_x, m c_y are left of it.
    "random 6R": (lambda: random_arm(3, "RRRRRR"), 38),
    "gravity along the axes": (lambda: planar(ALONG), 4),
    "gravity across the axes": (lambda: planar(ACROSS), 6),
    "one joint, gravity along": (lambda: dh_arm([{"type": "R", "a": 0.4, "alpha": 0}], ALONG), 1),
    "one joint, gravity across": (lambda: dh_arm([{"type": "R", "a": 0.4, "alpha": 0}], ACROSS), 3),
    "a slide": (lambda: dh_arm([{"type": "P", "a": 0, "alpha": 0}], ACROSS), 1),
    "three slides": (
        lambda: dh_arm([{"type": "P", "a": 0, "alpha": a} for a in (1.1, 0.7, 0.0)], ALONG),
        3,
    ),
    "a turn on a slide": (
        lambda: dh_arm(
            [{"type": "P", "a": 0, "alpha": 1.0}, {"type": "R", "a": 0.2, "alpha": 0}], ALONG
        ),
        4,
    ),
}  # fmt: skip


@BOTH
@pytest.mark.parametrize("name", COUNTS)
def test_counts(name, basis):
    make, count = COUNTS[name]
    base = base_parameters(make(), basis=basis)
    assert len(base) == base.n_rigid == count
    assert base.warnings == ()


@BOTH
@pytest.mark.parametrize("name", quick_first(["3r", "kuka_lwr4", "panda", "ur10e"], 1))
def test_the_answer_depends_on_no_seed_and_no_number_of_samples(name, basis):
    robot = load_robot(name)
    effects = on_every_joint(EFFECTS, robot.n)
    first = base_parameters(robot, effects, basis=basis)
    tries = [(seed, None) for seed in range(1, 20)] + [(1, 40), (2, 200), (3, 2000)]
    for seed, samples in tries:
        again = base_parameters(robot, effects, basis=basis, seed=seed, samples=samples)
        assert again.names == first.names
        assert again.independent == first.independent
        assert torch.allclose(again.grouping, first.grouping, atol=1e-8)


@BOTH
@pytest.mark.parametrize("effects", [(), EFFECTS], ids=["rigid", "with effects"])
@pytest.mark.parametrize("name", ["3r", "kuka_lwr4", "random 6R", "a turn on a slide", "mixed"])
def test_the_torque_is_that_of_the_base_parameters(name, effects, basis):
    robot = COUNTS[name][0]() if name in COUNTS else arm(name)
    kinds = on_every_joint(effects, robot.n)
    base = base_parameters(robot, kinds, basis=basis)
    y = stacked_regressor(robot, kinds, random_states(robot, seed=77, samples=300))
    generator = torch.Generator().manual_seed(5)
    full = torch.randn(8, y.shape[1], generator=generator, dtype=torch.float64)
    torque = y @ full.T
    own = y[:, list(base.independent)] @ base.project(full).T
    assert float((own - torque).abs().max() / torque.abs().max()) < 1e-10


@pytest.mark.parametrize("robot", [load_robot("kuka_lwr4"), random_arm(4, "RPRRP")], ids=str)
def test_the_stacked_regressor_with_effects_is_the_torque(robot):
    effects = on_every_joint(EFFECTS, robot.n)
    motion = random_states(robot, 1, 50)
    y = stacked_regressor(robot, effects, motion)
    values = torch.arange(1.0, len(effects) + 1, dtype=torch.float64)
    got = (y[:, 10 * robot.n :] @ values).reshape(-1, robot.n)
    v, c, o, r = values.reshape(4, robot.n)
    assert torch.allclose(got, v * motion.dq + c * motion.dq.sign() + o + r * motion.ddq)


def condition(robot: Robot, basis: Basis) -> float:
    """Of the base parameters' columns, each of length one, at states that chose nothing."""
    base = base_parameters(robot, basis=basis)
    y = stacked_regressor(robot, (), random_states(robot, seed=77, samples=1000))
    y = y[:, list(base.independent)]
    sizes = torch.linalg.svdvals(y / y.norm(dim=0))
    return float(sizes[0] / sizes[-1])


OBLIQUE = {f"oblique {k}{s}": mixed_arm(k, s) for k in ("RRRRRR", "RPRRPR") for s in (3, 6)}


@pytest.mark.parametrize("name", [*ARMS, "random 6R", "a turn on a slide", *OBLIQUE])
def test_the_conditioned_basis_is_well_conditioned(name):
    """Also where joint axes are oblique to the link frames, so that columns must be exchanged."""
    robot = OBLIQUE.get(name) or (COUNTS[name][0]() if name in COUNTS else arm(name))
    assert condition(robot, "conditioned") < 12
    assert condition(robot, "conditioned") <= condition(robot, "report")


def test_the_conditioned_base_parameters_of_the_panda_are_the_published_ones():
    """Gaz et al. 2019, supplementary material, table III: 43 groupings made by hand."""
    logs = runpy.run_path(str(Path(__file__).parents[2] / "torchid_bench/benchmarks/real_logs.py"))
    robot = load_robot("panda")
    base = base_parameters(robot)
    assert base.basis == robot.basis == "conditioned"
    published = torch.stack([logs["weights"](text, base) for text, _, _ in logs["PANDA"][:43]])
    ours = base.grouping
    signs = [ours[int((ours - p).norm(dim=1).argmin())] for p in published]
    assert torch.allclose(torch.stack(signs), published, atol=1e-12)
    assert len({tuple(row.tolist()) for row in signs}) == 43


@pytest.mark.parametrize("name", ["3r_friction", "kuka_lwr4", "panda", "ur10e"])
def test_the_robots_own_basis_is_the_default(name):
    robot = load_robot(name)
    own = "conditioned" if name in ("panda", "ur10e") else "report"
    assert base_parameters(robot).names == base_parameters(robot, basis=own).names
    assert base_parameters(robot).basis == robot.basis == own


@BOTH
def test_base_parameters_of_one_basis_are_combinations_of_the_others(basis):
    """Neither holds more than the other, and effects stay behind the rigid body."""
    robot = arm("ur10e")
    effects = on_every_joint(EFFECTS, robot.n)
    one, two = (base_parameters(robot, effects, basis=b) for b in ("report", "conditioned"))
    if basis == "conditioned":
        one, two = two, one
    turn = one.grouping[:, list(two.independent)]
    assert torch.allclose(turn @ two.grouping, one.grouping, atol=1e-8)
    assert (one.n_rigid, one.absorbed_effects()) == (two.n_rigid, two.absorbed_effects())
    rigid = one.n_rigid
    assert torch.allclose(turn[rigid:, rigid:], torch.eye(len(one) - rigid).double())


@BOTH
def test_twists_of_few_digits_change_nothing_of_the_structure(basis):
    """The regression that motivated rank.py: a twist of 1.5708 leaves residues of 1e-6 of columns
    that vanish or depend on others. They must neither take a direction that a later column needs,
    nor be kept (m2c2y - 270000 m2c2z)."""
    exact = base_parameters(lwr(math.pi / 2), basis=basis)
    assert len(exact) == 43
    for quarter in (1.570796327, 1.570796, 1.5708):
        base = base_parameters(lwr(quarter), basis=basis)
        assert base.independent == exact.independent
        assert [coefficients(n).keys() for n in base.names] == [
            coefficients(n).keys() for n in exact.names
        ]
        assert float((base.grouping - exact.grouping).abs().max()) < 1e-3
        assert base.warnings == ()


@BOTH
@pytest.mark.parametrize("name", COUNTS)
def test_names_read_back_as_the_grouping(name, basis):
    robot = COUNTS[name][0]()
    base = base_parameters(robot, on_every_joint(EFFECTS, robot.n), basis=basis)
    for text, row, lead in zip(base.names, base.grouping, base.independent, strict=True):
        read = coefficients(text.replace(" - ", "-").replace(" + ", "+"))
        shown = {
            base.parameter_names[k]: float(row[k]) for k in range(len(row)) if bool(visible(row)[k])
        }
        assert next(iter(read)) == base.parameter_names[lead]
        assert read == pytest.approx(shown, rel=1e-4)


@BOTH
@pytest.mark.parametrize("name", COUNTS)
def test_a_grouping_is_a_projection(name, basis):
    base = base_parameters(COUNTS[name][0](), basis=basis)
    identity = torch.eye(len(base), dtype=torch.float64)
    assert torch.equal(base.grouping[:, list(base.independent)], identity)
    assert sorted(base.independent + base.dependent) == list(range(len(base.parameter_names)))
    assert len(base.units) == len(base.names) == len(base)


def test_rotor_inertias_of_the_first_joints_are_absorbed():
    robot = load_robot("kuka_lwr4")
    base = base_parameters(robot, on_every_joint(EFFECTS, robot.n))
    assert base.absorbed_effects() == ["Ia1", "Ia2"]
    assert len(base) - base.n_rigid == 4 * 7 - 2
    first = next(name for name in base.names if "J1yy" in name)
    assert "Ia1" in coefficients(first)


def test_an_effect_given_twice_is_absorbed_by_itself():
    robot = load_robot("3r")
    base = base_parameters(robot, on_every_joint(("torque_offset", "torque_offset"), 3))
    assert base.absorbed_effects() == ["F01", "F02", "F03"]
    assert len(base) == 18


def test_columns_without_effect():
    y = torch.zeros(30, 4, dtype=torch.float64)
    with pytest.raises(IdentificationError, match="depends on no inertial parameter"):
        group_columns(y, list("abcd"), ["kg"] * 4, n_rigid_parameters=4)
    assert issubclass(IdentificationError, TorchidError)


def test_a_full_rank_matrix():
    """FIGAROH 1.0.2 finds rank 0 where no column is dependent."""
    generator = torch.Generator().manual_seed(0)
    y = torch.randn(30, 4, generator=generator, dtype=torch.float64)
    base = group_columns(y, list("abcd"), ["kg"] * 4, n_rigid_parameters=3)
    assert base.names == tuple("abcd")
    assert base.dependent == ()
    assert base.n_rigid == 3
    assert base.rank_gap[1] == 0
    assert base.warnings == ()


def test_a_doubtful_rank_is_said():
    generator = torch.Generator().manual_seed(0)
    y = torch.randn(300, 3, generator=generator, dtype=torch.float64)
    q = torch.linalg.qr(y).Q
    y = torch.stack([q[:, 0], q[:, 0] + 3e-4 * q[:, 1], q[:, 0] + 3e-5 * q[:, 2]], 1)
    base = group_columns(y, ["a", "b", "c"], ["kg"] * 3, n_rigid_parameters=3)
    assert base.names == ("a + c", "b")
    (warning,) = base.warnings
    assert "b was kept" in warning
    assert "c dropped" in warning
