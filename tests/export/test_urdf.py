"""URDF: an edited copy keeps all but the dynamics; Pinocchio and MuJoCo agree with the result."""

import difflib
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lxml import etree

from tests.arms import ISSUE_ARMS, arm, mixed_arm, relative, states
from tests.export.arms import FRICTION, exported, with_other, write_urdf
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.errors import TorchidError
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot


def pinocchio_torque(path: Path, robot, q, dq, ddq):  # type: ignore[no-untyped-def]
    """Of the rigid body, by Pinocchio, without any code of the export."""
    pin = pytest.importorskip("pinocchio")
    model = pin.buildModelFromUrdf(str(path))
    model.gravity.linear = robot.gravity.numpy()
    data = model.createData()
    out = []
    for row in zip(q.numpy(), dq.numpy(), ddq.numpy(), strict=True):
        full = []
        for joint, value in zip(list(model.joints)[1:], row[0], strict=True):
            full += [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
        out.append(pin.rnea(model, data, np.array(full), row[1], row[2]).copy())
    return torch.from_numpy(np.stack(out))


@pytest.mark.parametrize("name", ISSUE_ARMS)
def test_a_new_file_of_a_built_in_robot(name, tmp_path):
    robot = with_other(arm(name))
    done = exported(robot, "urdf", tmp_path)
    assert [c.ok for c in done.comparisons] == [True] * 3
    assert all(c.difference < 1e-12 for c in done.comparisons)
    motion = states(robot, 10)
    own = inverse_dynamics(robot, *motion)
    assert relative(pinocchio_torque(done.files[0], robot, *motion), own) < 1e-12
    again = load_robot(done.files[0])
    assert (again.name, again.joint_names) == (robot.name, robot.joint_names)
    for limit in ("position", "velocity", "torque"):
        known = getattr(robot.limits, limit)
        assert known is None or torch.equal(getattr(again.limits, limit), known)


def test_oblique_gravity_and_joints_of_a_new_file(tmp_path):
    robot = mixed_arm()
    done = exported(robot, "urdf", tmp_path)
    again = load_robot(done.files[0])
    assert again.gravity.tolist() == robot.gravity.tolist()  # from the sidecar
    motion = states(robot, 10)
    own = inverse_dynamics(robot, *motion)
    assert relative(inverse_dynamics(again, *motion), own) < 1e-12
    assert relative(pinocchio_torque(done.files[0], robot, *motion), own) < 1e-12


def test_the_copy_keeps_everything_else(tmp_path):
    original = write_urdf(tmp_path)
    before = original.read_bytes()
    robot = with_other(load_robot(original))
    (tmp_path / "new").mkdir()
    done = exported(robot, "urdf", tmp_path / "new", original)
    assert original.read_bytes() == before
    text = done.files[0].read_text()
    assert text.startswith('<?xml version="1.0" encoding="utf-8"?>\n<!-- a comment -->\n<robot ')
    untouched = r"<(visual|axis|limit|transmission|gazebo|parent|child)\b[^>]*>"
    old = [m.group() for m in re.finditer(untouched, before.decode())]
    assert [m.group() for m in re.finditer(untouched, text)] == old
    assert 'filename="package://none.stl"' in text
    motion = states(robot, 10)
    own = inverse_dynamics(robot, *motion)
    assert relative(pinocchio_torque(done.files[0], robot, *motion), own) < 1e-12


def test_links_behind_fixed_joints_are_part_of_the_moving_link(tmp_path):
    original = write_urdf(tmp_path)
    done = exported(with_other(load_robot(original)), "urdf", tmp_path, original)
    root = etree.parse(str(done.files[0])).getroot()
    heavy = [link.get("name") for link in root.iter("link") if link.find("inertial") is not None]
    assert heavy == ["base", "l1", "l2", "l3", "l4", "l5", "l6"]
    text = done.files[0].read_text()
    assert "inertial (0.5 kg) is part of that of link 'l2'" in text
    assert "inertial (0.25 kg) is part of that of link 'l6'" in text


def test_numbers_are_exact(tmp_path):
    """Peers rounded what they had identified to six digits."""
    original = write_urdf(tmp_path)
    robot = with_other(load_robot(original))
    done = exported(robot, "urdf", tmp_path, original)
    joint = etree.parse(str(done.files[0])).getroot().find("joint[@name='j1']/dynamics")
    assert float(joint.get("damping")) == 0.123456789012345
    assert float(joint.get("friction")) == 1 / 3
    again = load_robot(done.files[0])
    assert relative(again.parameters.pi, robot.parameters.pi) < 1e-15


def test_inertia_is_about_the_centre_of_mass_of_its_own_link(tmp_path):
    """Peers wrote the inertia about the link's origin, and shifted by one body."""
    original = write_urdf(tmp_path)
    robot = with_other(load_robot(original))
    done = exported(robot, "urdf", tmp_path, original)
    root = etree.parse(str(done.files[0])).getroot()
    for i, name in enumerate(robot.link_names):
        inertial = root.find(f"link[@name='{name}']/inertial")
        pi = robot.parameters.pi[i]
        m, c = float(pi[0]), (pi[1:4] / pi[0]).tolist()
        assert float(inertial.find("mass").get("value")) == m
        place = [float(x) for x in inertial.find("origin").get("xyz").split()]
        assert place == pytest.approx(c, rel=1e-15)
        moment = float(inertial.find("inertia").get("ixx"))
        assert moment == pytest.approx(float(pi[4]) - m * (c[1] ** 2 + c[2] ** 2), rel=1e-12)


def test_what_urdf_does_not_know_is_in_the_sidecar(tmp_path):
    original = write_urdf(tmp_path)
    robot = with_other(load_robot(original))
    done = exported(robot, "urdf", tmp_path, original)
    assert [path.name for path in done.files] == ["out.urdf", "out.urdf.effects.yaml"]
    assert len(done.in_file) == 2
    assert len(done.beside) == 4
    again = load_robot(done.files[0])
    assert {e["effect"] for e in again.effects} == {e["effect"] for e in FRICTION}
    assert all(words in done.files[0].read_text() for words in done.beside)
    # An export that needs no sidecar takes a stale one away.
    plain = exported(with_other(robot, effects=FRICTION[:2]), "urdf", tmp_path, original)
    assert [path.name for path in plain.files] == ["out.urdf"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["arm.urdf", "out.urdf"]


def test_friction_that_the_result_does_not_have_is_taken_out(tmp_path):
    original = write_urdf(tmp_path)
    done = exported(with_other(load_robot(original), effects=()), "urdf", tmp_path, original)
    assert load_robot(done.files[0]).effects == ()


def test_relative_meshes_are_found_from_another_folder(tmp_path):
    original = write_urdf(tmp_path)
    text = original.read_text().replace("package://none.stl", "meshes/arm.stl")
    original.write_text(text)
    (tmp_path / "a" / "b").mkdir(parents=True)
    done = exported(with_other(load_robot(original)), "urdf", tmp_path / "a" / "b", original)
    assert 'filename="../../meshes/arm.stl"' in done.files[0].read_text()
    same = exported(with_other(load_robot(original)), "urdf", tmp_path, original)
    assert 'filename="meshes/arm.stl"' in same.files[0].read_text()


def test_tags_that_are_not_edited_stay_as_they_are_written(tmp_path):
    """Exporters of CAD programs write one attribute a line."""
    original = write_urdf(tmp_path)
    text = original.read_text()
    text = text.replace('<axis xyz="0 0 1"/>', "<axis\n      xyz = '0 0 1' />")
    text = text.replace('<link name="flange"/>', '<link\n  name="flange">\n  <!-- a > b --></link>')
    text = text.replace("<gazebo", "<note><![CDATA[ <a b='1'> & ]]></note><gazebo")
    original.write_text(text + "<!-- the end -->\n")
    done = exported(with_other(load_robot(original)), "urdf", tmp_path, original)
    old, new = original.read_text().splitlines(), done.files[0].read_text().splitlines()
    changed = [line for line in difflib.ndiff(old, new) if line[0] in "-+"]
    words = ("inerti", "origin", "mass ", "dynamics", "torchid", "joint ")
    assert [line for line in changed if not any(word in line for word in words)] == []
    assert sum(line[0] == "-" for line in changed) < 40


def test_windows_line_ends_and_a_latin_encoding_stay(tmp_path):
    original = write_urdf(tmp_path)
    text = original.read_text().replace("utf-8", "iso-8859-1").replace("a comment", "Gerät")
    original.write_bytes(text.replace("\n", "\r\n").encode("latin-1"))
    done = exported(with_other(load_robot(original)), "urdf", tmp_path, original)
    written = done.files[0].read_bytes()
    assert "Gerät".encode("latin-1") in written
    assert written.count(b"\n") == written.count(b"\r\n")


def test_a_branch_off_the_chain_keeps_its_inertials_and_is_told(tmp_path):
    original = write_urdf(tmp_path)
    robot = load_robot(original, tip="l4")
    done = exported(with_other(robot), "urdf", tmp_path, original, tip="l4")
    assert any("count twice" in note for note in done.notes)
    assert all(c.ok is not False for c in done.comparisons)
    aside = [c for c in done.comparisons if "left aside" in c.note]
    assert len(aside) == 2
    root = etree.parse(str(done.files[0])).getroot()
    assert root.find("link[@name='l5']/inertial/mass").get("value") == "0.8"


def test_the_original_is_never_overwritten(tmp_path):
    original = write_urdf(tmp_path).rename(tmp_path / "out.urdf")
    before = original.read_bytes()
    with pytest.raises(TorchidError, match="take the place of the original"):
        exported(with_other(load_robot(original)), "urdf", tmp_path, original)
    assert original.read_bytes() == before


def test_other_frames_than_the_original_are_refused(tmp_path):
    original = write_urdf(tmp_path)
    robot = with_other(load_robot(original))
    before = robot.before.clone()
    before[2, 0, 3] += 1e-3
    with pytest.raises(TorchidError, match="frames elsewhere") as raised:
        exported(replace(robot, before=before), "urdf", tmp_path, original)
    assert raised.value.got == "links 3"
    with pytest.raises(TorchidError, match="another arm"):
        exported(with_other(arm("3r")), "urdf", tmp_path, original)
    assert [p.name for p in tmp_path.iterdir()] == ["arm.urdf"]


def test_a_first_moment_without_mass_is_refused(tmp_path):
    robot = with_other(arm("3r"))
    pi = robot.parameters.pi.clone()
    pi[1, 0] = 0.0
    massless = robot.with_parameters(InertialParameters(pi))
    from torchid.export.dynamics import Dynamics
    from torchid.export.export import export_dynamics

    dynamics = Dynamics(massless, "robot", "a test")
    with pytest.raises(TorchidError, match="no centre of mass"):
        export_dynamics(dynamics, "urdf", tmp_path, "out", nominal=massless, force=True)
    assert list(tmp_path.iterdir()) == []


def test_exporting_an_export_changes_its_head_only(tmp_path):
    original = write_urdf(tmp_path)
    once = exported(with_other(load_robot(original)), "urdf", tmp_path, original).files[0]
    (tmp_path / "again").mkdir()
    twice = exported(load_robot(once), "urdf", tmp_path / "again", once).files[0]
    assert twice.read_text().count("torchid export: dynamics") == 1
    a, b = load_robot(once), load_robot(twice)
    assert relative(b.parameters.pi, a.parameters.pi) < 1e-14
    assert sorted(map(str, a.effects)) == sorted(map(str, b.effects))


@settings(max_examples=5, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 10_000), scale=st.sampled_from([1e-4, 1.0, 1e3]))
def test_random_bodies_survive_the_round_trip(seed, scale, tmp_path):
    original = tmp_path / "arm.urdf"
    if not original.exists():
        write_urdf(tmp_path)
    robot = with_other(load_robot(original), seed=seed)
    robot = robot.with_parameters(InertialParameters(scale * robot.parameters.pi))
    done = exported(robot, "urdf", tmp_path, original)
    assert all(c.difference < 1e-11 for c in done.comparisons)
    again = load_robot(done.files[0])
    assert torch.allclose(again.parameters.pi, robot.parameters.pi, rtol=1e-13, atol=1e-15 * scale)
