"""What can be exported: identifications, sets, extractions, robots; and what is refused."""

import json
import sys
from dataclasses import replace

import pytest
import torch

from tests.arms import arm, consistent_parameters, relative
from tests.export.arms import FRICTION, exported, with_other
from tests.fleet.records import identification as identified
from torchid.effects.base import Motion
from torchid.effects.registry import nominal_others, on_every_joint
from torchid.errors import TorchidError
from torchid.export.dynamics import (
    Dynamics,
    folded_robot,
    nearest_representative,
    random_states,
    robot_torque,
)
from torchid.export.export import export_dynamics, require_feasible
from torchid.export.results import base_dynamics, carried, load, robot_dynamics, set_dynamics
from torchid.feasibility.record import check_sets
from torchid.feasibility.sets import ParameterSets, nominal_set, sets_record
from torchid.identification.base_parameters import base_parameters, nominal_values
from torchid.identification.model import model_torque
from torchid.position.model import ServoArm
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot, named_robot
from torchid.robot.tree import Choice
from torchid.simulation.servo import Servos

EFFECTS = ("viscous_friction", "rotor_inertia")


def identification(tmp_path, robot, name="kuka_lwr4"):  # type: ignore[no-untyped-def]
    """A file as `torchid identify` writes it, with the values of the robot's parameters."""
    effects = tuple(on_every_joint(EFFECTS, robot.n))
    base = base_parameters(robot, effects)
    values = nominal_values(robot, base)
    b = len(base)
    path = identified(tmp_path / "identification.json", 0, robot=robot, effects=EFFECTS)
    data = json.loads(path.read_text()) | {
        "robot_source": name,
        "base_values": values.tolist(),
        "undetermined": [base.names[3]],
        "covariance": torch.diag(torch.full((b,), 0.04, dtype=torch.float64)).tolist(),
        "factor": torch.eye(b + 1, dtype=torch.float64).tolist(),
    }
    path.write_text(json.dumps(data))
    return path, base, effects, values


def sets_file(tmp_path, robot, scales=(1.0, 2.0, -1.0), **more):  # type: ignore[no-untyped-def]
    """Three sets, the last one infeasible."""
    pi = consistent_parameters(robot.n, 4).pi
    effects = tuple(on_every_joint(["viscous_friction"], robot.n))
    sets = ParameterSets(
        ("a", "b", "c"),
        InertialParameters(torch.stack([s * pi for s in scales])),
        effects,
        torch.full((3, robot.n), 0.3, dtype=torch.float64),
    )
    path = tmp_path / "sets.json"
    path.write_text(json.dumps({**sets_record(sets, robot).plain(), **more}))
    return path


def test_base_parameters_have_the_identifications_torque(tmp_path):
    robot = arm("kuka_lwr4")
    path, base, effects, values = identification(tmp_path, robot)
    found = base_dynamics(path, named_robot(path, load(path), None))
    motion = random_states(robot, 3)
    own = model_torque(robot, base, effects, values, motion)
    assert relative(found.torque(motion), own) < 1e-14
    assert "not determined" in found.warnings[0]
    near = nearest_representative(robot, found.base)
    assert relative(robot_torque(near, motion), own) < 1e-11
    # The values are of the robot's own parameters, so nothing has to change.
    assert torch.allclose(near.parameters.pi, robot.parameters.pi, atol=1e-9)


def test_base_parameters_as_code(tmp_path):
    robot = arm("kuka_lwr4")
    path, *_ = identification(tmp_path, robot)
    done = export_dynamics(base_dynamics(path, robot), "c", tmp_path, "out", nominal=robot)
    assert all(c.ok is not False for c in done.comparisons)
    assert done.check is None


@pytest.mark.nightly
def test_base_parameters_of_no_bodies_are_written_as_the_nearest_bodies(tmp_path):
    robot = arm("kuka_lwr4")  # its published parameters are infeasible
    path, *_ = identification(tmp_path, robot)
    asked = base_dynamics(path, robot)
    done = export_dynamics(asked, "yaml", tmp_path, "out", nominal=robot)
    assert done.check is not None
    assert bool(done.check.feasibility.feasible[0])
    assert all(c.ok is not False for c in done.comparisons)
    # What is said of the price is what the file's own torque shows.
    (said,) = [w for w in done.warnings if "these are bodies" in w]
    percent = float(said.split("up to ")[1].split(" %")[0])
    motion = random_states(robot, seed=7)
    wanted = asked.torque(motion)
    missed = robot_torque(load_robot(str(done.files[0])), motion) - wanted
    largest = 100 * float((missed.norm(dim=0) / wanted.norm(dim=0)).max())
    assert percent / 3 < largest < 3 * percent
    forced = export_dynamics(asked, "urdf", tmp_path, "o", nominal=robot, force=True)
    assert forced.comparisons[0].difference < 1e-9


def test_feasible_base_parameters_are_written(tmp_path):
    robot = replace(arm("kuka_lwr4"), bounds={}).with_parameters(consistent_parameters(7, 2))
    path, *_ = identification(tmp_path, robot)
    done = export_dynamics(base_dynamics(path, robot), "yaml", tmp_path, "o", nominal=robot)
    assert all(c.ok is not False for c in done.comparisons)


def test_the_best_feasible_set_is_taken(tmp_path):
    robot = arm("3r")
    path = sets_file(tmp_path, robot)

    def chosen(asked=None):  # type: ignore[no-untyped-def]
        return set_dynamics(path, load(path), robot, asked, "none")

    assert "largest degree of 2 feasible sets" in chosen().title
    assert "'b'" in chosen("b").title
    (tmp_path / "extraction.json").write_text(
        json.dumps({"sets": [{"id": k, "phi": p} for k, p in zip("abc", (3, 2, 1), strict=True)]})
    )
    assert "'b'" in chosen().title
    assert "least loss of 2 feasible sets" in chosen().title
    with pytest.raises(TorchidError, match="no such set") as raised:
        chosen("z")
    assert raised.value.available == ["a", "b", "c"]


def test_a_set_brings_its_own_effects_only(tmp_path):
    robot = replace(arm("3r"), effects=FRICTION)
    found = set_dynamics(*(lambda p: (p, load(p)))(sets_file(tmp_path, robot)), robot, "a", "none")
    assert {e["effect"] for e in found.robot.effects} == {"viscous_friction"}
    assert [w.partition("left out: ")[2][:25] for w in found.warnings] == [
        "joint 2: joint_spring k =", "joint 1: stribeck_frictio",
    ]  # fmt: skip


def test_effects_beside_the_sets_come_with_them(tmp_path):
    robot = replace(arm("3r"), effects=FRICTION)
    others = nominal_others(robot)
    (path := tmp_path / "near.json").write_text(
        json.dumps(sets_record(nominal_set(robot), robot, others).plain())
    )
    bare = replace(robot, effects=())
    found = set_dynamics(path, load(path), bare, None, "none")
    assert found.warnings == ()
    assert len(found.robot.effects) == len(robot.effects)
    motion = random_states(robot, 1)
    assert relative(found.torque(motion), robot_torque(robot, motion)) < 1e-14
    path.write_text(json.dumps({**json.loads(path.read_text()), "other_effects": [3]}))
    with pytest.raises(TorchidError, match="other_effects"):
        set_dynamics(path, load(path), bare, None, "none")


def test_an_extraction_without_parameters_looks_beside_it(tmp_path):
    robot = arm("3r")
    sets_file(tmp_path, robot)
    path = tmp_path / "study.json"
    entries = [{"id": k, "phi": p} for k, p in zip("abc", (1, 2, 3), strict=True)]
    path.write_text(json.dumps({"robot": "3r", "sets": entries}))
    assert "'a'" in set_dynamics(path, load(path), robot, None, "none").title
    (tmp_path / "sets.json").unlink()
    with pytest.raises(TorchidError, match="without their parameters"):
        set_dynamics(path, load(path), robot, None, "none")


def test_infeasible_sets_are_refused_with_labels_and_evidence(tmp_path):
    robot = arm("3r")
    path = sets_file(tmp_path, robot)
    found = set_dynamics(path, load(path), robot, "c", "none")
    for to in ("urdf", "mjcf", "yaml", "c"):
        with pytest.raises(TorchidError, match="infeasible") as raised:
            export_dynamics(found, to, tmp_path, "out", nominal=robot, geometry="none")
        assert "mass_1 (-" in raised.value.got
        assert "inertia_2 (not positive definite" in raised.value.got
    assert [p.name for p in tmp_path.iterdir()] == ["sets.json"]
    done = export_dynamics(found, "urdf", tmp_path, "o", nominal=robot, geometry="none", force=True)
    assert done.comparisons[0].ok
    assert not bool(done.check.feasibility.feasible[0])


def test_pseudo_inertia_is_not_mistaken_for_the_inertia_about_the_origin(tmp_path):
    """Peers checked the inertia about the link's origin, and let this body pass: about its centre
    of mass it is none."""
    robot = arm("3r")
    pi = consistent_parameters(3, 4).pi.clone()
    pi[1] = torch.tensor([1.0, 0.3, 0.0, 0.0, 0.05, 0.0, 0.0, 0.06, 0.0, 0.07], dtype=torch.float64)
    dynamics = Dynamics(robot.with_parameters(InertialParameters(pi)), "robot", "a test")
    checked = check_sets(dynamics.robot, nominal_set(dynamics.robot), geometry="none")
    with pytest.raises(TorchidError) as raised:
        require_feasible(dynamics, checked)
    assert raised.value.got.startswith("inertia_2")


def test_the_robot_is_the_one_recorded(tmp_path):
    path = tmp_path / "r.json"
    assert named_robot(path, {"robot": "x", "robot_source": "3r"}, None).name == "3r"
    assert named_robot(path, {"robot": "3r"}, None).name == "3r"
    exported(with_other(arm("3r")), "urdf", tmp_path)
    assert named_robot(path, {"robot": "x", "robot_source": "out.urdf"}, None).name == "3r"
    with pytest.raises(TorchidError, match="`robot="):
        named_robot(path, {"robot": "x", "robot_source": "gone.urdf"}, None)


def test_a_robot_needs_parameters():
    with pytest.raises(TorchidError, match="no inertial parameters"):
        robot_dynamics(replace(arm("3r"), parameters=None))


def test_a_payload_becomes_part_of_the_last_link(tmp_path):
    payload = {
        "effect": "payload", "m": 1.5, "mx": 0.1, "my": 0.0, "mz": 0.02,
        "Jxx": 0.03, "Jxy": 0.0, "Jxz": 0.0, "Jyy": 0.03, "Jyz": 0.0, "Jzz": 0.02,
    }  # fmt: skip
    robot = with_other(arm("3r"), effects=(*FRICTION, payload))
    done = exported(robot, "urdf", tmp_path)
    assert all(c.difference < 1e-12 for c in done.comparisons)
    assert not any("payload" in words for words in done.beside)
    heavier = folded_robot(robot).parameters.mass - robot.parameters.mass
    assert heavier.tolist() == pytest.approx([0, 0, 1.5])
    # Beside an effect that is taken from the model itself, it stays an effect.
    tilt = {"effect": "encoder_offset", "joint": 1, "offset": 0.01, "at": 0.03}
    both = with_other(arm("3r"), effects=(payload, tilt))
    assert folded_robot(both) is both
    assert all(c.ok is not False for c in exported(both, "urdf", tmp_path).comparisons)


def test_a_payload_that_is_no_body_is_not_exported(tmp_path):
    """Its link alone is one, and the error says that the two together are none."""
    hung = {"effect": "payload", "m": 1.5, "mx": 0.6, "my": 0.0, "mz": 0.0}
    hung |= dict.fromkeys(("Jxx", "Jxy", "Jxz", "Jyy", "Jyz", "Jzz"), 0.0)
    robot = with_other(arm("3r"), effects=(hung,))
    with pytest.raises(TorchidError, match="infeasible, so not exported") as error:
        exported(robot, "urdf", tmp_path)
    assert "inertia_3" in str(error.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["3r", "panda", "ur10e", "mixed"])
def test_the_yaml_is_lossless(tmp_path, name):
    robot = with_other(arm(name))
    done = exported(robot, "yaml", tmp_path)
    assert done.comparisons[0].difference == 0.0
    assert len(done.in_file) == len(FRICTION)


def test_packages_that_are_not_installed_are_told(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    own, *others = exported(with_other(arm("3r")), "urdf", tmp_path).comparisons
    assert own.ok
    assert [(c.difference, c.note) for c in others[:1]] == [(None, "not installed")]


def test_states_are_within_limits():
    robot = arm("panda")
    motion: Motion = random_states(robot, 0)
    for name, x in zip(("position", "velocity"), motion.state, strict=False):
        low, high = getattr(robot.limits, name).unbind(-1)
        assert bool(((x >= low) & (x <= high)).all())


def test_what_is_not_reproduced_is_not_kept(tmp_path, monkeypatch):
    from torchid.export import write_plain

    exact = write_plain.robot_yaml

    def rounded(robot):  # type: ignore[no-untyped-def]
        """To six digits, as peers did."""
        pi = (robot.parameters.pi * 1e6).round() / 1e6
        return exact(robot.with_parameters(InertialParameters(pi)))

    monkeypatch.setattr(write_plain, "robot_yaml", rounded)
    (tmp_path / "out.yaml").write_text("old")
    with pytest.raises(TorchidError, match="does not reproduce"):
        exported(with_other(arm("3r")), "yaml", tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["out.yaml"]
    assert (tmp_path / "out.yaml").read_text() == "old"


def test_servos_are_exported_as_far_as_joints_have_fields(tmp_path):
    servos = Servos.neutral(3, kp=260.0, damping=22.0, armature=0.8, coulomb=1.5, delay=0.02)
    ServoArm(load_robot("3r"), servos, torch.ones(3, dtype=torch.float64)).write(
        tmp_path / "a.yaml"
    )
    found = carried(str(tmp_path / "a.yaml"), None, Choice(), None, None).dynamics
    sizes = {(e["effect"], e["joint"]) for e in found.robot.effects}
    names = ("viscous_friction", "coulomb_friction", "rotor_inertia")
    assert sizes == {(name, j) for name in names for j in (1, 2, 3)}
    urdf = export_dynamics(found, "urdf", tmp_path / "out", nominal=load_robot("3r"))
    assert "of the servos kp, delay are not in it" in urdf.warnings[0]
