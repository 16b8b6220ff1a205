"""Sets of physical parameters and their file: nothing is lost, and nothing bad is let in."""

import json
from pathlib import Path

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.arms import arm, consistent_parameters
from torchid.effects.friction import CoulombFriction, ViscousFriction
from torchid.errors import RobotError, TorchidError
from torchid.feasibility.sets import ParameterSets, joined, nominal_set, read_sets, sets_record
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot

NUMBERS = st.floats(allow_nan=False, allow_infinity=False)


def some_sets(n: int, count: int = 3) -> ParameterSets:
    effects = (ViscousFriction(0), CoulombFriction(n - 1))
    return ParameterSets(
        tuple(f"p_{k}" for k in range(count)),
        consistent_parameters(n, 5, (count,)),
        effects,
        torch.rand(count, 2, dtype=torch.float64),
    )


def written(path: Path, data: object) -> Path:
    path.write_text(data if isinstance(data, str) else json.dumps(data), encoding="utf-8")
    return path


def entry(**changes: object) -> dict[str, object]:
    """A good set of the 3R, with changes; a value of ... removes the key."""
    good = {
        "id": "a",
        "mass": [1.0, 2.0, 3.0],
        "com": [[0.1, 0.2, 0.3]] * 3,
        "inertia_about_com": [[1.0, 0.1, 0.2, 1.1, 0.3, 1.2]] * 3,
        "effects": [{"effect": "viscous_friction", "joint": 2, "Fv": 0.5}],
    }
    return {k: v for k, v in (good | changes).items() if v is not ...}


@pytest.mark.parametrize("name", ["3r", "3r_friction", "kuka_lwr4_friction"])
def test_nominal_set_holds_the_robot(name: str) -> None:
    robot = load_robot(name)
    sets = nominal_set(robot)
    assert sets.ids == (robot.name,)
    assert len(sets) == 1
    assert torch.equal(sets.parameters.pi[0], robot.parameters.pi)
    assert len(sets.coefficient_names()) == sets.coefficients.shape[1] == len(robot.effects)
    assert sets.vector.shape == (1, 10 * robot.n + len(robot.effects))
    assert torch.equal(sets.vector[0, : robot.n], robot.parameters.mass)
    assert torch.equal(sets.to_robot(robot, 0).parameters.pi, robot.parameters.pi)


def test_robot_without_parameters_is_refused() -> None:
    with pytest.raises(RobotError, match="parameters"):
        nominal_set(load_robot("panda"))


def test_parts_and_joined_undo_each_other() -> None:
    sets = some_sets(3, 5)
    again = joined([sets.part([0, 1]), sets.part([2]), sets.part([3, 4])])
    assert again.ids == sets.ids
    assert torch.equal(again.vector, sets.vector)
    mixed = sets.part([4, 0])
    assert mixed.ids == ("p_4", "p_0")
    assert torch.equal(mixed.vector, sets.vector[[4, 0]])


@pytest.mark.parametrize("name", ["3r", "3r_friction", "kuka_lwr4_friction", "panda"])
def test_file_is_lossless(name: str, tmp_path: Path) -> None:
    robot = arm(name)
    for sets in (nominal_set(robot), some_sets(robot.n)):
        path = written(tmp_path / "sets.json", sets_record(sets, robot).plain())
        again = read_sets(path, robot)
        assert again.ids == sets.ids
        assert again.effects == sets.effects
        assert torch.equal(again.vector, sets.vector)


@pytest.mark.nightly
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(NUMBERS, min_size=30, max_size=30), NUMBERS)
def test_any_finite_numbers_survive_the_file(tmp_path: Path, pi: list[float], fv: float) -> None:
    numbers = torch.tensor(pi, dtype=torch.float64).reshape(1, 3, 10)
    sets = ParameterSets(
        ("x",),
        InertialParameters(numbers),
        (ViscousFriction(1),),
        torch.tensor([[fv]], dtype=torch.float64),
    )
    robot = load_robot("3r")
    again = read_sets(written(tmp_path / "s.json", sets_record(sets, robot).plain()), robot)
    # Of the bits, not of the values: -0.0 is not 0.0.
    assert torch.equal(again.vector.view(torch.int64), sets.vector.view(torch.int64))


def test_four_ways_to_write_a_set_agree(tmp_path: Path) -> None:
    """Centre of mass or first moment, inertia about the one point or the other."""
    robot = load_robot("3r")
    p = consistent_parameters(3, 2)
    places = {"com": p.com, "first_moment": p.first_moment}
    inertias = {
        "inertia_about_com": p.inertia_about_com,
        "inertia_about_link_frame": p.inertia_about_link_frame,
    }
    for place, c in places.items():
        for inertia, j in inertias.items():
            record = {"mass": p.mass.tolist(), place: c.tolist(), inertia: j.tolist()}
            sets = read_sets(written(tmp_path / "s.json", {"sets": [record]}), robot)
            torch.testing.assert_close(sets.parameters.pi[0], p.pi, rtol=1e-13, atol=1e-15)
            assert sets.ids == ("1",)
            assert sets.coefficients.shape == (1, 0)


def test_a_massless_link_keeps_its_first_moment(tmp_path: Path) -> None:
    record = entry(mass=[0.0, 1.0, 1.0], com=..., first_moment=[[0.1, 0.0, 0.0]] * 3)
    sets = read_sets(written(tmp_path / "s.json", {"sets": [record]}), load_robot("3r"))
    assert sets.parameters.pi[0, 0, :4].tolist() == [0.0, 0.1, 0.0, 0.0]


BAD_FILES = {
    "half written": (json.dumps({"sets": [entry()]})[:-20], "not JSON"),
    "no sets": ({"sets": []}, "holds no parameter sets"),
    "duplicate id": ({"sets": [entry(), entry()]}, "same id"),
    "id of an unnamed one": ({"sets": [entry(id="2"), entry(id=...)]}, "same id"),
    "other effects": ({"sets": [entry(), entry(id="b", effects=[])]}, "same effects"),
}
BAD_SETS = {
    "no mass": (entry(mass=...), "field `mass`"),
    "no place": (entry(com=...), "needs one of com and first_moment"),
    "two places": (entry(first_moment=[[0, 0, 0]] * 3), "needs one of com and first_moment"),
    "no inertia": (entry(inertia_about_com=...), "needs one of inertia_about_com"),
    "too few links": (entry(mass=[1.0, 2.0]), r"com`"),
    "too many links": (entry(com=[[0, 0, 0]] * 7), r"com`"),
    "inertia of nine": (entry(inertia_about_com=[[1.0] * 9] * 3), r"n 6 numbers, got \(3, 9\)"),
    "ragged": (entry(com=[[0, 0, 0], [0, 0], [0, 0, 0]]), r"\$\.sets\[0\]\.com"),
    "null inside": (entry(mass=[1.0, None, 2.0]), "`mass` is not all finite"),
    "effect without name": (entry(effects=[{"joint": 1, "Fv": 1.0}]), "needs the key 'effect'"),
    "unknown effect": (entry(effects=[{"effect": "glue", "joint": 1}]), "unknown effect 'glue'"),
    "effect on joint 0": (
        entry(effects=[{"effect": "viscous_friction", "joint": 0, "Fv": 1}]),
        "a joint that does not exist",
    ),
    "effect without coefficient": (
        entry(effects=[{"effect": "viscous_friction", "joint": 1}]),
        "a number 'Fv'",
    ),
    "effect twice": (
        entry(effects=[{"effect": "viscous_friction", "joint": 1, "Fv": 1.0}] * 2),
        "listed twice",
    ),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_files_are_refused(case: str, tmp_path: Path) -> None:
    content, said = BAD_FILES[case]
    path = written(tmp_path / "sets.json", content)
    with pytest.raises(TorchidError, match=said) as caught:
        read_sets(path, load_robot("3r"))
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("case", BAD_SETS)
def test_bad_sets_are_refused(case: str, tmp_path: Path) -> None:
    content, said = BAD_SETS[case]
    path = written(tmp_path / "sets.json", {"sets": [content]})
    with pytest.raises(TorchidError, match=said):
        read_sets(path, load_robot("3r"))
