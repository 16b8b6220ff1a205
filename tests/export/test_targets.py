"""Exports run in the packages that they are for, each in an environment of its own, and move as
MuJoCo here with the same file, and with what torchid adds at run time."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.arms import arm
from tests.export.targets import python_of
from tests.simulators.test_mujoco import BESIDE
from torchid.export.dynamics import Dynamics, records
from torchid.export.export import export_dynamics
from torchid.export.results import robot_dynamics, servo_dynamics
from torchid.position.model import ServoArm
from torchid.robot.model import Robot
from torchid.simulation.replay import replayed
from torchid.simulation.servo_loop import Tracks, windows_of
from torchid.simulators.actuator import EffectTorque
from torchid.simulators.servo import ServoTorque
from torchid_bench.benchmarks.targets.motion import Played
from torchid_bench.benchmarks.targets.play import play

pytestmark = pytest.mark.slow

DT, STEPS, CONTROLS = 0.02, 4, 25
FIELDS = (
    ("viscous_friction", "Fv", 8.0),
    ("coulomb_friction", "Fc", 3.0),
    ("rotor_inertia", "Ia", 2.0),
)
SERVOS = {"kp": 900.0, "kd": 30.0, "delay": 0.012, "clip": 200.0, "offset": 1.0, "lag": 0.03}
JOINTS = {"damping": 20.0, "coulomb": 2.0, "armature": 1.0}


def with_effects(name: str) -> Robot:
    """An arm with friction, and with effects that no file has a field for."""
    robot = arm(name)
    fields = tuple(
        {"effect": kind, "joint": j + 1, key: value}
        for j in range(robot.n)
        for kind, key, value in FIELDS
    )
    return replace(robot, effects=(*fields, *records([BESIDE["load"], BESIDE["stribeck"]])))


def with_servos(name: str, **more: float) -> ServoArm:
    """An arm with servos."""
    return ServoArm.of(arm(name), **{**SERVOS, **JOINTS, **more})


def prepared(what: Dynamics, folder: Path, *to: str) -> Played:
    """The exports of an arm in a folder, and a motion: two windows of half a second."""
    robot = what.robot
    for one in to:
        export_dynamics(what, one, folder, "arm", nominal=robot, geometry="none")  # type: ignore[arg-type]
    draw = np.random.default_rng(0)
    q, dq = draw.uniform(-0.5, 0.5, (2, 2, robot.n))
    wave = np.sin(2 * np.pi * DT * np.arange(CONTROLS)[:, None] * draw.uniform(0.5, 2, robot.n))
    size = 0.3 if what.arm is not None else 20.0
    control = size * wave + (q[:, None] if what.arm is not None else 0.0)
    kind = "torque" if what.arm is None else "position"
    motion = Played(kind, control + np.zeros((2, 1, 1)), q, dq, DT, STEPS, robot.joint_names)
    motion.write(folder)
    return motion


@pytest.mark.parametrize("kind", ["effects", "servos"])
def test_mjlab_moves_as_mujoco_does(kind: str, tmp_path: Path) -> None:
    python_of("mjlab")
    what = (
        robot_dynamics(with_effects("ur10e"))
        if kind == "effects"
        else servo_dynamics(with_servos("3r", stiction=3.0, motor_share=0.1))
    )
    motion = prepared(what, tmp_path, "mjcf", "mjlab")
    expected, found = play("mujoco", tmp_path), play("mjlab", tmp_path)
    np.testing.assert_allclose(found, expected, atol=1e-3)  # float32
    (tmp_path / f"arm_{kind}.yaml").unlink()
    without = play("mujoco", tmp_path)
    assert np.abs(without - expected).max() > 5e-3, "the effects at run time are not felt"
    assert np.abs(expected - motion.q[:, None]).max() > 0.05


def test_newton_moves_as_mujoco_does(tmp_path: Path) -> None:
    """By torques, with the fields of the MJCF."""
    python_of("newton")
    motion = prepared(robot_dynamics(with_effects("ur10e")), tmp_path, "mjcf")
    expected, found = play("mujoco", tmp_path), play("newton", tmp_path)
    np.testing.assert_allclose(found, expected, atol=1e-3)  # float32
    assert np.abs(expected - motion.q[:, None]).max() > 0.05


def test_newton_follows_commands_as_mujoco_does(tmp_path: Path) -> None:
    """By the file's actuators, with Newton's own integrator; its reader passes over `delay`."""
    python_of("newton")
    motion = prepared(servo_dynamics(with_servos("3r", delay=0.0)), tmp_path, "mjcf")
    file = tmp_path / "arm.xml"
    file.write_text(file.read_text().replace("<option ", '<option integrator="implicitfast" ', 1))
    expected, found = play("mujoco", tmp_path), play("newton", tmp_path)
    np.testing.assert_allclose(found, expected, atol=1e-5)  # float32
    assert np.abs(expected - motion.q[:, None]).max() > 0.05


@pytest.mark.parametrize("kind", ["effects", "servos"])
def test_isaac_lab_gives_the_efforts(kind: str, tmp_path: Path) -> None:
    """Along states that are given: no physics of Isaac Sim runs here."""
    python_of("isaaclab")
    robot, servos = with_effects("3r"), with_servos("3r", stiction=3.0)
    what = robot_dynamics(robot) if kind == "effects" else servo_dynamics(servos)
    motion = prepared(what, tmp_path, "isaaclab")
    draw = np.random.default_rng(1)
    q, dq = draw.uniform(-0.5, 0.5, (2, 2, CONTROLS, robot.n))
    replace(motion, q=q, dq=dq, dt=motion.step, steps=1).write(tmp_path)
    found = play("isaaclab", tmp_path)
    control, q, dq = (torch.tensor(x, dtype=torch.float32) for x in (motion.control, q, dq))
    step, expected = motion.step, []
    effects = EffectTorque(robot, environments=2)
    drives = ServoTorque(servos.robot, servos.servos, None, 2, dt=step)
    for k in range(CONTROLS):
        now = control[:, k], q[:, k], dq[:, k]
        resisted = now[0] - effects.torque(*now[1:], step, now[0])
        expected.append(drives.torque(*now) if kind == "servos" else resisted)
    np.testing.assert_allclose(found, torch.stack(expected, 1), atol=1e-3)


FADES = {"stiction": 8.0, "stribeck_speed": 0.4, "stribeck_exponent": 1.5}
FRICTION = {
    "m1": {}, "m2": FADES, "m3": {"load_share": 0.1, "motor_share": 0.1},
    "m4": {**FADES, "stiction_share": 0.2, "load_share": 0.1, "motor_share": 0.1},
    "m5": {**FADES, "stiction_share": 0.2, "load_share": 0.2, "motor_share": 0.05},
}  # fmt: skip


@pytest.mark.parametrize("model", FRICTION)
def test_bam_moves_as_the_simulation_of_servos_does(model: str, tmp_path: Path) -> None:
    """Its own controller in MuJoCo, which knows the torques of the step before."""
    python_of("bam")
    plain = ServoArm.of(arm("3r"), kp=900.0, damping_share=0.4, **JOINTS)
    own = ServoArm.of(arm("3r"), kp=900.0, damping_share=0.4, **JOINTS, **FRICTION[model])
    motion = prepared(servo_dynamics(own), tmp_path, "mjcf", "bam")
    motion = replace(motion, steps=40, dq=0 * motion.dq)
    motion.write(tmp_path)
    found = play("bam", tmp_path)
    windows, controls, n = found.shape
    # A command is held until the next one.
    u = torch.from_numpy(motion.control.repeat(motion.steps, 1)).flatten(0, 1)
    first = torch.arange(windows) * controls * motion.steps
    tracks = Tracks(u, first, first + controls * motion.steps - 1, motion.step)
    start = torch.from_numpy(motion.q), torch.from_numpy(motion.dq)

    def simulated(servos: ServoArm) -> np.ndarray:
        q = replayed(servos.robot, servos.servos, tracks, windows_of(tracks, None), *start)
        return q.view(windows, -1, n)[:, :: motion.steps].numpy()

    apart = np.abs(found - simulated(own)).max()
    assert apart < 1e-3
    assert model == "m1" or np.abs(found - simulated(plain)).max() > 5e-3
