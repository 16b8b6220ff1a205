"""Gap diagnoses and files of sets: the same cause under other names, sizes, what could not be
tested, and what sets leave open."""

import io
import json

import pytest
import torch
from rich.console import Console

from tests.export.arms import write_urdf
from tests.gap_files import diagnosis, named
from tests.gap_files import hidden as untested
from torchid.errors import TorchidError
from torchid.feasibility.sets import ParameterSets, nominal_set, sets_record
from torchid.fleet.compare import common_robot, compare_results, read_results
from torchid.report.compare import cause_table, parameter_table, verdict
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot


def compared(*paths):
    return compare_results(paths)


def printed(found):
    console = Console(width=160, record=True, file=io.StringIO())
    console.print(cause_table(found), parameter_table(found))
    return console.export_text()


def test_the_same_effect_with_another_size(tmp_path):
    found = compared(
        diagnosis(tmp_path / "a.json", named(Fc=0.5), named("torque_offset", 1, F0=1.0)),
        diagnosis(tmp_path / "b.json", named(Fc=0.8), named("torque_offset", 1, F0=1.01)),
    )
    assert all(c.states == ("named", "named") for c in found.causes)
    by_name = {p.name: p for p in found.parameters}
    assert by_name["Fc2"].p < 1e-4
    assert by_name["Fc2"].between == pytest.approx(0.3 / 2**0.5, rel=0.02)
    assert by_name["F01"].p > 0.5
    assert "1 agree and 1 differs" in verdict(found)


def test_another_name_that_cannot_be_told_apart_is_the_same_cause(tmp_path):
    found = compared(
        diagnosis(tmp_path / "a.json", named("stribeck_friction", 2, ["coulomb_friction"], Fs=0.4)),
        diagnosis(tmp_path / "b.json", named()),
        diagnosis(tmp_path / "c.json", named()),
    )
    (cause,) = found.causes
    assert cause.label == "coulomb_friction or stribeck_friction of joint 2"
    assert cause.states == ("named",) * 3
    own = {p.name: p.own.isfinite().tolist() for p in found.parameters}
    assert own == {"Fc2": [False, True, True], "Fs2": [True, False, False]}


@pytest.mark.parametrize("other", [named(joint=3), named("viscous_friction", 2, Fv=0.4)])
def test_another_joint_or_an_unrelated_effect_is_another_cause(tmp_path, other):
    found = compared(diagnosis(tmp_path / "a.json", named()), diagnosis(tmp_path / "b.json", other))
    assert [c.states.count("named") for c in found.causes] == [1, 1]
    assert "No effect is named in all" in verdict(found)


def test_what_could_not_be_tested_is_not_missing(tmp_path):
    hidden = untested("coulomb_friction", 2, 0.9)
    found = compared(
        diagnosis(tmp_path / "a.json", named()), diagnosis(tmp_path / "b.json", hidden=[hidden])
    )
    assert found.causes[0].states == ("named", "not_testable")
    assert found.causes[0].smallest == (None, 0.9)
    assert "of joint 2 (not testable in all)" in verdict(found)
    assert "not testable below 0.9" in printed(found)


def test_sizes_are_shown_of_what_only_one_names(tmp_path):
    a = diagnosis(tmp_path / "a.json", named(Fc=0.4321))
    b = diagnosis(tmp_path / "b.json", named("viscous_friction", joint=3, Fv=1.25))
    text = printed(compared(a, b))
    assert "0.432 ± 0.02" in text
    assert "1.25 ± 0.02" in text


def test_torque_of_corrected_models(tmp_path):
    """They differ by exactly the friction that one of them has."""
    friction = {"effect": "coulomb_friction", "joint": 2, "Fc": 0.6}
    found = compared(
        diagnosis(tmp_path / "a.json", named(), effects=[friction]),
        diagnosis(tmp_path / "b.json"),
    )
    spread = found.torque.spread.tolist()
    assert spread[0] == spread[2] == 0
    assert spread[1] == pytest.approx(0.6 / 2**0.5, rel=0.01)  # at rest, at both ends, none
    data = json.loads(json.dumps(found.plain(), allow_nan=False))
    assert data["causes"][0]["states"] == ["named", "not_found"]


def test_another_arm_and_an_incomplete_file_are_refused(tmp_path):
    a = diagnosis(tmp_path / "a.json", named())
    with pytest.raises(TorchidError, match="different kinematics"):
        compared(a, diagnosis(tmp_path / "b.json", named(), robot="kuka_lwr4"))
    broken = {**json.loads(a.read_text())}
    del broken["which"]
    (tmp_path / "c.json").write_text(json.dumps(broken))
    with pytest.raises(TorchidError, match="missing required field `which`"):
        compared(a, tmp_path / "c.json")


def sets(path, *, mass=0.0, spread=0.01, count=5, seed=0):
    """The 3R's parameters with noise of a share of each; link 2 heavier by `mass` [kg]."""
    robot = load_robot("3r")
    generator = torch.Generator().manual_seed(seed)
    pi = robot.parameters.pi.double()
    noise = torch.randn(count, *pi.shape, generator=generator, dtype=torch.float64)
    pi = pi * (1 + spread * noise)
    pi[:, 1, 0] += mass
    ids = tuple(f"p_{k}" for k in range(count))
    made = ParameterSets(ids, InertialParameters(pi), (), pi.new_zeros(count, 0))
    path.write_text(json.dumps(sets_record(made, robot).plain()))
    return path


def test_sets_differ_where_their_ranges_are_apart(tmp_path):
    paths = [sets(tmp_path / f"{k}.json", mass=k, seed=k) for k in range(3)]
    found = compared(*paths)
    by_name = {p.name: p for p in found.parameters}
    assert by_name["m2"].verdict == "differ"
    assert by_name["m2"].between == pytest.approx(1, rel=0.05)
    assert by_name["m3"].verdict == "agree"
    assert found.about == ("5 sets",) * 3
    assert float(found.torque.spread[1]) > 10 * float(found.torque.spread[0])
    data = json.loads(json.dumps(found.plain(), allow_nan=False))
    assert data["kind"] == "parameter sets"


def test_the_robot_of_a_file_is_found_again(tmp_path):
    folder = tmp_path / "robot"
    folder.mkdir()
    urdf = write_urdf(folder)
    robot = load_robot(urdf)
    for name in "ab":
        (tmp_path / f"{name}.json").write_text(
            json.dumps(sets_record(nominal_set(robot), robot).plain())
        )
    results = read_results([tmp_path / "a.json", tmp_path / "b.json"])
    assert common_robot(results).source == str(urdf)
    urdf.rename(folder / "other.urdf")
    with pytest.raises(TorchidError, match="`robot="):
        common_robot(results)


def test_what_sets_leave_open_and_what_they_say_nothing_of(tmp_path):
    files = [
        sets(tmp_path / "a.json", spread=2.0, count=40, seed=0),
        sets(tmp_path / "b.json", spread=2.0, count=40, seed=1),
    ]
    found = compared(*files)
    assert not found.having("differ")
    assert len(found.having("never_determined")) > 10
    single = [sets(tmp_path / f"{k}.json", count=1, seed=k) for k in range(2)]
    found = compared(*single)
    assert len(found.having("not_compared")) == len(found.parameters)
    assert "none is tested" in verdict(found)
