"""Servos carried out into MuJoCo: refitted, written, and moved there by a log's commands."""

from dataclasses import replace
from pathlib import Path

import mujoco
import pytest
import torch
from lxml import etree
from typer.testing import CliRunner

import torchid
from tests.arms import consistent_parameters
from tests.marks import some
from tests.position.planted import planted, robot, true_servos
from torchid.app.commands import app
from torchid.effects.servo import INDEX
from torchid.errors import TorchidError
from torchid.export.correct import correct
from torchid.export.dynamics import require_same_arm
from torchid.export.export import export_dynamics
from torchid.export.releases import has_field
from torchid.export.results import servo_dynamics
from torchid.export.servo_mjcf import (
    SAID,
    ServosInMujoco,
    said_in_mjcf,
    unsaid_parameters,
)
from torchid.log.readers import write_log
from torchid.position.data import tracks_of
from torchid.position.model import ServoArm
from torchid.position.replay import replay
from torchid.robot.library import load_robot
from torchid.robot.model import link_poses
from torchid.robot.origin import same_places
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import windows_of

PID = has_field("pid")
CASES = {
    "plain": {},
    "limits": {"acceleration": (2, 4.0), "speed": (3, 0.5)},
    "rate": {"kd": (2, 25.0)},
}


def arm_with(servos: Servos) -> ServoArm:
    return ServoArm(robot(), servos, torch.ones(3, dtype=torch.float64))


@pytest.mark.nightly
def test_a_stop_is_where_positions_end(tmp_path):
    """A stop of the simulation of servos gives way, a joint's limit does not: nor does one of the
    file, where the log is beyond it."""
    arm = arm_with(true_servos(3, stop_high=(3, 0.1)))
    log = planted(arm.servos, motions=3, seconds=8.0, seed=2)
    low, high = log.q.amin(0), log.q.amax(0)
    limits = torch.stack([low - 1.0, high + torch.tensor([1.0, -0.05, 1.0])], 1)
    given = replace(robot(), limits=replace(robot().limits, position=limits))
    done = correct(given, arm, log, "mjcf", tmp_path)
    said = f"joint 2: the log reaches {float(high[1]):.4g} rad (m), and the limit of "
    (widened,) = (w for w in done.warnings if "the log reaches" in w)
    assert widened.startswith(said)
    last = 1e3 * float((log.q - log.u)[:, 2].square().mean().sqrt())
    assert float(done.judged.nominal[2]) == pytest.approx(last)
    assert float(done.judged.engine[2]) < 0.5 * last
    model = mujoco.MjModel.from_xml_path(str(done.files[0]))
    assert model.joint("joint_3").range[1] == pytest.approx(float(high[2]))
    assert model.joint("joint_2").range == pytest.approx([float(low[1]) - 1, float(high[1])])
    assert model.joint("joint_1").range == pytest.approx(limits[0].tolist())


@pytest.mark.parametrize("name", some(CASES, 1))
def test_the_file_moves_as_the_arm_did(name, tmp_path):
    """A plain servo by its file alone, a limit of acceleration by set points that are joints, one
    of speed by <pid>; the command's rate at run time."""
    arm = arm_with(true_servos(3, **CASES[name]))
    log = planted(arm.servos, motions=3, seconds=6.0, seed=2)
    other = planted(arm.servos, motions=3, seconds=6.0, seed=5)
    done = correct(robot(), arm, log, "mjcf", tmp_path, held_out=other, with_effects="mjlab")
    found = done.judged
    assert found.held_out == "3 held-out logs"
    assert float(found.nominal.min()) > 20.0
    # MuJoCo's own solution of dry friction, and encoder counts of 1.5 mrad.
    assert float(found.run_time.max()) < 1.5
    points = name == "limits"
    said = said_in_mjcf(arm.servos, set_points=True)
    assert done.no_field == unsaid_parameters(arm.servos, said)
    assert list(done.no_field) == {"rate": ["kd"], "plain": []}.get(name, [] if PID else ["speed"])
    said = [j for j in range(3) if not any(j in on for on in done.no_field.values())]
    # Straight pieces of the braking way; without set points joint 2 errs 65.
    assert float(found.engine[said].max()) < (4.0 if points else 1.5)
    if done.no_field:
        assert float(found.engine.max()) > 3.0
    nq = mujoco.MjModel.from_xml_path(str(done.files[0])).nq
    assert nq == 3 + points
    assert mujoco.MjModel.from_xml_path(str(done.files[1])).nq == 3
    assert [f.name for f in done.files] == [
        "3r_corrected.xml", "3r_corrected_effects.xml", "3r_corrected_actuator_mjlab.py",
        "3r_corrected_servos.yaml", "3r_corrected_effects.yaml",
    ]  # fmt: skip
    for file in done.files[3:]:
        assert float(replay(ServoArm.read(file), other).error.max()) < 1.5
    errors = done.record.judged.position_error_mrad
    assert float(errors.engine[1]) == pytest.approx(float(found.engine[1]))
    done.save(tmp_path / "correction.json")
    assert torchid.load(tmp_path / "correction.json").plain() == done.plain()
    said = [(row["parameter"], row["joints"]) for row in done.plain()["servos_without"]]
    assert said == [(name, [j + 1 for j in on]) for name, on in done.no_field.items()]


ACTUATED = """<mujoco>
  <compiler angle="degree"/>
  <option timestep="0.001"/>
  <default><position kp="998" forcerange="-3 3" ctrlrange="-100 100"/></default>
  {world}
  <actuator>
    <motor name="other" joint="joint_2"/>
    <position name="servo_1" joint="joint_1"/>
    <position joint="joint_2"/>
  </actuator>
  <keyframe><key name="home" ctrl="0 0"/></keyframe>
</mujoco>
"""


def with_actuators(folder):
    """The 3R as an MJCF with actuators of its own, and defaults of them."""
    one = export_dynamics(load_robot("3r"), "mjcf", folder, "plain", nominal=load_robot("3r"))
    root = etree.parse(str(one.files[0])).getroot()
    for node in root.iter("joint"):
        node.attrib.pop("range", None)
    world = etree.tostring(root.find("worldbody"), encoding="unicode")
    path = folder / "own.xml"
    path.write_text(ACTUATED.format(world=world))
    return path


def test_servos_take_the_place_of_a_files_friction_and_say_what_is_lost(tmp_path):
    """They were fitted without it, but with its springs; meshes may be missing."""
    own = with_actuators(tmp_path)
    text = own.read_text().replace(
        "<joint ", '<joint damping="50" frictionloss="9" armature="2" ', 1
    )
    mesh = '<asset><mesh name="m" file="none.stl"/></asset><worldbody><geom type="mesh" mesh="m"/>'
    own.write_text(text.replace("<worldbody>", mesh, 1))
    servos = true_servos(3, acceleration=(2, 4.0))
    arm = replace(arm_with(servos), robot=load_robot(own))
    done = export_dynamics(
        servo_dynamics(arm), "mjcf", tmp_path / "out", nominal=arm.robot, plain=True
    )
    model = ServosInMujoco(done.files[0], arm.robot).model
    for name, field in (("damping", model.dof_damping), ("armature", model.dof_armature)):
        assert field == pytest.approx(servos.of(name).numpy())
    assert model.dof_frictionloss == pytest.approx(servos.of("coulomb").numpy())
    assert "of the servos acceleration are not in it" in done.files[0].read_text()


def test_a_base_that_a_file_lets_go_is_held(tmp_path):
    own = with_actuators(tmp_path)
    one = '<body><freejoint/><inertial pos="0 0 0" mass="5" diaginertia="1 1 1"/><body '
    text = (
        own.read_text().replace("<body ", one, 1).replace("</worldbody>", "</body></worldbody>", 1)
    )
    own.write_text(text)
    arm = replace(arm_with(true_servos(3)), robot=load_robot(own))
    log = planted(arm.servos, motions=1, seconds=3.0)
    file = export_dynamics(servo_dynamics(arm), "mjcf", tmp_path / "out", nominal=arm.robot).files[
        0
    ]
    tracks = tracks_of(log, arm.scale)
    windows = windows_of(tracks, None)
    begun = (log.q[:1].numpy(), torch.zeros(1, 3).double().numpy())
    q = ServosInMujoco(file, arm.robot).moved(arm.servos, tracks, windows, *begun)
    assert float((q - log.q).abs().max()) < 0.03


def test_an_arm_rests_on_its_plane(tmp_path):
    """As deep as in the simulation of servos; of a copy of a copy, too."""
    servos = true_servos(3)
    free = planted(servos, motions=2, seconds=4.0, seed=5)
    point = torch.tensor([0.3, 0.0, 0.1, 1.0], dtype=torch.float64)
    level = float((link_poses(robot(), free.q)[:, 2] @ point)[:, 2].median())
    servos.plane[:] = torch.tensor([*point[:3], level, 5000.0])
    arm = arm_with(servos)
    log = planted(servos, motions=2, seconds=4.0, seed=5)
    pushed = (log.q - free.q).square().mean().sqrt()
    assert float(pushed) > 0.03
    assert not unsaid_parameters(servos, servos.keeping(SAID))
    tracks = tracks_of(log, arm.scale)
    windows = windows_of(tracks, None)
    begun = (log.q[tracks.first].numpy(), torch.zeros(2, 3).double().numpy())
    for name in ("first", "second"):
        done = export_dynamics(
            servo_dynamics(arm), "mjcf", tmp_path, name, nominal=arm.robot, original=arm.robot
        )
        q = ServosInMujoco(done.files[0], arm.robot).moved(servos, tracks, windows, *begun)
        assert float((q - log.q).square().mean().sqrt() / pushed) < 0.1
        arm = replace(arm, robot=load_robot(done.files[0]))


@pytest.mark.nightly
def test_actuators_of_a_file_are_replaced_where_they_stand(tmp_path):
    own = load_robot(with_actuators(tmp_path))
    servos = true_servos(3, stop_high=(3, 0.25), clip=(1, 90.0), lag=(2, 0.03))
    servos.joint[0, INDEX["offset"]] = -4.0
    arm = replace(arm_with(servos), robot=own)
    log = planted(servos, motions=2, seconds=6.0, seed=3)
    done = correct(own, arm, log, "mjcf", tmp_path / "out")
    model = mujoco.MjModel.from_xml_path(str(done.files[0]))
    names = [model.actuator(k).name for k in range(model.nu)]
    assert names == ["other", "servo_1", "joint_3"]
    found = done.servos.servos
    kp, clip, offset = (found.of(name).numpy() for name in ("kp", "clip", "offset"))
    for k, j in enumerate((1, 0, 2)):
        assert model.actuator_trnid[k, 0] == j
        assert model.actuator_gainprm[k, 0] == pytest.approx(kp[j])
        assert model.actuator_biasprm[k, :2] == pytest.approx([offset[j], -kp[j]])
        assert not model.actuator_ctrllimited[k]
    assert model.actuator_forcelimited.tolist() == [0, 1, 0]
    low, high = model.actuator_forcerange[1]
    assert (high - low) / 2 == pytest.approx(clip[0])
    assert (high + low) / 2 == pytest.approx(offset[0])
    assert model.actuator_dynprm[0, 0] == pytest.approx(float(found.of("lag")[1]))
    # Angles of this file are degrees.
    assert model.joint("joint_3").range[1] == pytest.approx(float(log.q[:, 2].max()))
    # What is held until the next command, half a sample, is part of the servo's delay.
    late = [max(float(x) - 0.01, 0.0) for x in found.of("delay")]
    assert model.actuator_delay == pytest.approx([late[1], late[0], late[2]])


@pytest.mark.slow
def test_what_cannot_be_written(tmp_path):
    arm = arm_with(true_servos(3))
    log = planted(arm.servos, motions=2, seconds=6.0)
    with pytest.raises(TorchidError, match="servos are of another arm"):
        correct(load_robot("kuka_lwr4"), arm, log, "mjcf", tmp_path)
    # Motions that go the other way.
    wild = log.replace(u=-log.u)
    with pytest.raises(TorchidError, match="hardly better than its commands"):
        correct(robot(), arm, log, "mjcf", tmp_path, held_out=wild)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_by_command(tmp_path):
    arm = arm_with(true_servos(3, kd=(2, 25.0)))
    arm.write(tmp_path / "model.yaml")
    log = planted(arm.servos, motions=2, seconds=6.0, seed=3)
    write_log(log, tmp_path / "log.csv")

    def run(*words: object) -> str:
        asked = [*map(str, words), "--out", str(tmp_path / "out")]
        done = CliRunner().invoke(app, asked)
        if done.exit_code:
            return str(done.exception)
        return done.output

    model, file = tmp_path / "model.yaml", tmp_path / "log.csv"
    said = run("export", model, "--to", "mjcf", "--robot", "3r", "--log", file)
    assert "MuJoCo" in said
    assert "kd" in said
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        "3r_corrected.xml", "correction.json"
    ]  # fmt: skip
    for to in ("isaaclab", "mjlab"):
        assert "torque of the servos" in run("export", model, "--to", to, "--name", to)
        drives = ServoArm.read(tmp_path / "out" / f"{to}_servos.yaml").servos
        assert torch.equal(drives.joint, arm.servos.joint)
    plain = run("export", model, "--to", "mjcf", "--name", "plain")
    assert "force of the servos" in plain
    said = run("export", model, "--to", "urdf", "--robot", "3r", "--log", file, "--overwrite")
    assert "servos are written into an MJCF only" in said
    said = run("correct", "3r", file, "--to", "urdf", "--overwrite")
    assert "servos are written into an MJCF only" in said


def rounded(path, digits):
    """A file with numbers of places of fewer digits."""
    root = etree.parse(str(path)).getroot()
    for node in root.iter():
        for key in ("pos", "quat", "xyz", "rpy", "axis"):
            if isinstance(node.tag, str) and node.get(key):
                words = (f"{float(x):.{digits}g}" for x in node.get(key).split())
                node.set(key, " ".join(words))
    out = path.with_stem(f"{path.stem}_{digits}")
    etree.ElementTree(root).write(str(out))
    return out


@pytest.mark.parametrize("digits", [6, 9])
def test_one_arm_in_two_formats_is_one_arm_as_far_as_digits_go(digits, tmp_path):
    """Servos of a maker's URDF go into the maker's MJCF, each rounded in its own way."""
    arm = load_robot("kuka_lwr4").with_parameters(consistent_parameters(7, 1))
    files = []
    for to in ("urdf", "mjcf"):  # links have the frames of the URDF
        done = export_dynamics(arm, to, tmp_path, "arm", nominal=arm, geometry="none")
        files.append(done.files[0])
        arm = load_robot(files[0])
    urdf, mjcf = (load_robot(rounded(path, digits)) for path in files)
    apart = float(urdf.frames_apart(mjcf).max())
    assert 10.0 ** (-digits - 1) < apart < 10.0 ** (2 - digits)
    assert bool(same_places(urdf, mjcf).all())
    require_same_arm(urdf, mjcf, "servos are")
    servos = ServoArm.of(urdf, kp=500.0, damping=30.0, armature=0.3)
    done = export_dynamics(
        servo_dynamics(servos), "mjcf", tmp_path / "out", nominal=urdf, original=mjcf,
        geometry="none",
    )  # fmt: skip
    assert all(c.ok is not False for c in done.comparisons)
    # A link that is elsewhere by more than that is of another arm.
    moved = mjcf.before.clone()
    moved[3, 0, 3] += 10.0 ** (3 - digits)
    other = replace(mjcf, before=moved)
    assert same_places(urdf, other).tolist() == [k != 3 for k in range(7)]
    with pytest.raises(TorchidError, match="of another arm"):
        require_same_arm(urdf, other, "servos are")


def test_a_ratio_is_written_beside_the_files_gain_or_not_at_all(tmp_path):
    servos = true_servos(3)
    arm = replace(arm_with(servos), unanchored=(1,))
    for to in ("mjcf", "urdf", "yaml", "c"):
        with pytest.raises(TorchidError, match="joint 2 is known as a ratio alone") as refused:
            export_dynamics(servo_dynamics(arm), to, tmp_path / "out", nominal=robot())
        assert "a known mass in the hand" in str(refused.value)
    assert not (tmp_path / "out").exists()
    # The motor of joint 1 has no gain; joint 2 has the class's kp.
    own = load_robot(with_actuators(tmp_path))
    text = Path(own.source).read_text().replace('<motor name="other" joint="joint_2"/>', "")
    Path(own.source).write_text(text)
    arm.write(tmp_path / "model.yaml")
    arm = replace(ServoArm.read(tmp_path / "model.yaml"), robot=own)
    assert arm.unanchored == (1,)
    done = export_dynamics(servo_dynamics(arm), "mjcf", tmp_path / "out", nominal=own)
    text = done.files[0].read_text()
    assert f"joint_2: kp: {260 / 998:.3g} x the file's." in text
    assert "joint_1: kp" not in text


def test_a_ratio_that_was_refitted_is_called_one(tmp_path):
    """Where the file has no gain, as a URDF has none."""
    arm = replace(arm_with(true_servos(3)), unanchored=(1,))
    log = planted(arm.servos, motions=2, seconds=6.0, seed=2)
    done = correct(robot(), arm, log, "mjcf", tmp_path)
    assert any("the gain of joint 2 is known as a ratio alone" in words for words in done.warnings)
    text = done.files[0].read_text()
    assert "joint_2: kp: a ratio. Nothing anchors" in text
    assert "holds a load against gravity" in text


@pytest.mark.slow
def test_a_limit_in_another_unit_than_the_logs_is_not_kept(tmp_path):
    """The log's unit of joint 3 is guessed: whether its positions pass the file's limit says
    nothing, nor where they end."""
    servos = true_servos(3)
    arm = replace(arm_with(servos), scale=torch.tensor([1.0, 1.0, 2.0], dtype=torch.float64))
    log = planted(servos, motions=2, seconds=6.0, seed=2)
    other = torch.tensor([1.0, 1.0, 0.5], dtype=torch.float64)
    assert log.u is not None
    limits = torch.stack([log.q.amin(0) - 1.0, log.q.amax(0) + 1.0], 1)
    given = replace(robot(), limits=replace(robot().limits, position=limits))
    done = correct(given, arm, log.replace(q=log.q * other, u=log.u * other), "mjcf", tmp_path)
    assert (
        "joint 3: its unit in the log is guessed, so its limit in '3r' is not kept" in done.warnings
    )
    read = load_robot(done.files[0]).limits.position
    assert read is not None
    assert torch.allclose(read[:2], limits[:2], atol=1e-6)
    assert float(read[2].abs().min()) > 100
