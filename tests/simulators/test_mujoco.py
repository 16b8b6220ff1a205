"""Effects at run time: MuJoCo's torque with them is torchid's, and so is the motion."""

import copy
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from tests.arms import arm
from tests.marks import quick_first
from torchid.effects.base import Effect, Motion
from torchid.effects.coupling import GearCoupling
from torchid.effects.friction import TorqueOffset
from torchid.effects.friction_laws import (
    AsymmetricFriction,
    LoadDependentFriction,
    PowerLawFriction,
    StribeckFriction,
)
from torchid.effects.hysteresis import PreslidingHysteresis
from torchid.effects.periodic import MotorRipple
from torchid.effects.registry import model_torque, nominal_effects
from torchid.effects.spring import JointSpring
from torchid.errors import TorchidError
from torchid.export.dynamics import records
from torchid.export.export import export_dynamics
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.simulation.open_loop import rollout
from torchid.simulators.mujoco import Effects

FIELDS = tuple(
    {"effect": kind, "joint": j, name: value}
    for j in (1, 2, 3)
    for kind, name, value in (
        ("viscous_friction", "Fv", 0.4 * j),
        ("coulomb_friction", "Fc", 0.5),
        ("rotor_inertia", "Ia", 0.1),
    )
)
BESIDE: dict[str, tuple[Effect, list[float]]] = {
    "stribeck": (StribeckFriction(0, vs=0.3), [0.8]),
    "load": (LoadDependentFriction(1), [0.08]),
    "power": (PowerLawFriction(2, a=1.6), [0.7]),
    "damping": (PowerLawFriction(1, a=3.0), [0.3]),
    "asymmetric": (AsymmetricFriction(1), [0.2, 0.1]),
    "offset": (TorqueOffset(1), [0.4]),
    "spring": (JointSpring(2, curvature=-1.0), [2.0, -0.5]),
    "ripple": (MotorRipple(0), [0.1, 0.05]),
    "coupling": (GearCoupling(2, 1), [0.1, 0.05, 0.1]),
    "presliding": (PreslidingHysteresis(2, length=0.1), [0.6]),
}


def in_mujoco(robot: Robot, folder: Path, count: int = 1):  # type: ignore[no-untyped-def]
    """The robot read from its file, and simulations of it with its effects."""
    done = export_dynamics(robot, "mjcf", folder, nominal=arm("3r"), geometry="none")
    read = load_robot(done.files[0])
    model = mujoco.MjModel.from_xml_path(str(done.files[0]))
    model.opt.timestep = 1e-3
    models = [copy.copy(model) for _ in range(count)]
    return read, Effects(read, [(m, mujoco.MjData(m)) for m in models])


def robot_with(*names: str) -> Robot:
    return replace(arm("3r"), effects=(*FIELDS, *records([BESIDE[name] for name in names])))


@pytest.mark.parametrize("name", [n for n in BESIDE if n != "presliding"])
def test_torque_is_torchids(name, tmp_path):
    """At random states: mj_inverse of what MuJoCo is left with, and the effects' loads."""
    robot, effects = in_mujoco(robot_with(name), tmp_path)
    assert not effects.ignored
    ((model, data),) = effects.simulations
    g = torch.Generator().manual_seed(0)
    q, dq, ddq = 2 * torch.rand(3, 40, 3, generator=g, dtype=torch.float64) - 1
    motion = Motion(q, dq, 3 * ddq, t=torch.arange(40).double())
    expected = model_torque(robot, nominal_effects(robot), motion)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    model.dof_damping[:] = 0
    for k in range(40):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], dq[k], motion.ddq[k]
        mujoco.mj_inverse(model, data)
        loads = effects.loads(motion.part(slice(k, k + 1)))
        resisting = loads.smooth + loads.dry * torch.sign(dq[k]) + motion.ddq[k] @ effects.across
        found = torch.from_numpy(data.qfrc_inverse.copy()) + resisting[0]
        assert float((found - expected[k]).abs().max()) < 1e-9 * float(expected.abs().max())


def test_transmitted_torque_is_that_of_mujocos_mass_matrix(tmp_path):
    """With friction at work and a force from outside, of several arms in other states."""
    _, effects = in_mujoco(robot_with("load", "coupling"), tmp_path, count=3)
    for k, (_, data) in enumerate(effects.simulations):
        data.qpos[:], data.qvel[:] = 0.3 * k, [0.5 - 0.4 * k, 0.1, -0.2]
        data.xfrc_applied[-1, :3] = [3.0 * k, -1.0, 2.0]
    effects.restart()
    effects.step(torch.tensor([[5.0, -3.0, 1.0]]).double().expand(3, 3))
    ddq = effects.motion().ddq
    assert float(ddq.abs().min()) > 0
    found = effects._transmitted(ddq) - ddq @ effects.across
    for k, (model, data) in enumerate(effects.simulations):
        expected = np.empty(model.nv)
        mujoco.mj_mulM(model, data, expected, data.qacc)
        expected += data.qfrc_bias
        assert np.abs(found[k].numpy() - expected).max() < 1e-7 * np.abs(expected).max()


@pytest.mark.parametrize(
    "names",
    quick_first(
        [("power", "spring", "ripple", "coupling"), (), ("stribeck", "load"), ("presliding",)], 1
    ),
)
def test_motion_is_that_of_torchids_simulation(names, tmp_path):
    """The same torque from the same states, two integrators: the difference falls with the step."""
    robot, effects = in_mujoco(robot_with(*names), tmp_path, count=2)
    t = torch.arange(0, 0.4, 0.002).double()
    way = torch.tensor([1.0, -0.7, 0.5]).double()
    tau = (8 * torch.sin(6 * t)[:, None] * way).expand(2, -1, -1).clone()
    tau[1] *= -0.6
    q0 = torch.tensor([[0.3, -0.4, 0.6], [0.0, 0.5, -0.3]]).double()
    dq0 = torch.zeros_like(q0) + 0.2
    run = rollout(replace(robot, effects=()), nominal_effects(robot), q0, dq0, tau, 0.002)
    for k, (_, data) in enumerate(effects.simulations):
        data.qpos[:], data.qvel[:] = q0[k], dq0[k]
    effects.restart()
    for k in range(len(t) - 1):
        for share in (0.25, 0.75):
            effects.step(torch.lerp(tau[:, k], tau[:, k + 1], share))
    found = effects.motion().q
    moved = (run.q[:, -1] - q0).abs().amax()
    assert bool(run.q.isfinite().all())
    assert float((found - run.q[:, -1]).abs().max()) < 0.02 * float(moved)


def test_gains_of_the_log_are_undone(tmp_path):
    """A torque in the log's units acts as what it is."""
    gains = [{"effect": "torque_gain", "joint": j, "gain": 0.1 * j} for j in (1, 2, 3)]
    robot = replace(arm("3r"), effects=(*FIELDS, *gains))
    _, effects = in_mujoco(robot, tmp_path)
    torque = torch.tensor([[1.1, 2.4, 3.9]]).double()
    torch.testing.assert_close(
        effects.true_torque(torque), torch.tensor([[1.0, 2.0, 3.0]]).double()
    )
    assert not effects.ignored


def test_what_is_ignored_is_named(tmp_path):
    offset = {"effect": "encoder_offset", "joint": 1, "offset": 0.01}
    robot = replace(arm("3r"), effects=(*FIELDS, offset))
    assert in_mujoco(robot, tmp_path)[1].ignored == ("encoder_offset",)


def test_wrong_models_are_refused(tmp_path):
    robot, effects = in_mujoco(robot_with("stribeck"), tmp_path)
    ((model, data),) = effects.simulations
    with pytest.raises(TorchidError, match=r"copy\.copy"):
        Effects(robot, [(model, data), (model, mujoco.MjData(model))])
    with pytest.raises(TorchidError, match="not all of the robot's joints"):
        Effects(replace(robot, joint_names=("a", "b", "c")), [(model, data)])


def test_stiff_friction_stays_stable(tmp_path):
    """A slope of 200 N m s/rad on a light wrist, at a step for which an explicit one explodes."""
    effects_of = (
        {"effect": "stribeck_friction", "joint": 3, "Fs": 1.0, "vs": 0.02},
        {"effect": "power_law_friction", "joint": 3, "F2": 200.0, "a": 1.05},
    )
    _, effects = in_mujoco(replace(arm("3r"), effects=effects_of), tmp_path)
    ((model, data),) = effects.simulations
    model.opt.timestep = 5e-3
    data.qvel[:] = [0.0, 0.0, 3.0]
    speeds = []
    for _ in range(200):
        effects.step(torch.zeros(1, 3).double())
        speeds.append(float(np.abs(data.qvel[2])))
    assert np.isfinite(data.qpos).all()
    assert max(speeds[5:]) < 3.0


TWO_MASSES = """<mujoco>
  <option timestep="{h}" gravity="0 0 -9.81"/>
  <worldbody>
    <body>
      <joint name="link" type="hinge" axis="0 1 0" damping="0.2"/>
      <inertial mass="2" pos="0.3 0 0" diaginertia="0.02 0.02 0.02"/>
    </body>
    <body>
      <joint name="motor" type="hinge" axis="0 1 0" armature="0.4"/>
      <inertial mass="1e-9" pos="0 0 0" diaginertia="1e-12 1e-12 1e-12"/>
    </body>
  </worldbody>
</mujoco>"""
STIFFNESS, DAMPING, PLAY = 800.0, 1.5, 4e-3


def pendulum(effects: list[dict[str, object]], h: float, tmp_path: Path) -> Effects:
    """The link of `two_masses`, its motor being a state."""
    text = TWO_MASSES.format(h=h)
    cut = text[: text.index('    <body>\n      <joint name="motor"')] + "  </worldbody>\n</mujoco>"
    file = tmp_path / "pendulum.xml"
    file.write_text(cut)
    robot = load_robot(file)
    motor = {"effect": "rotor_inertia", "joint": 1, "Ia": 0.4}
    robot = replace(robot, effects=(*robot.effects, motor, *effects))
    model = mujoco.MjModel.from_xml_path(str(file))
    return Effects(robot, [(model, mujoco.MjData(model))])


@pytest.mark.nightly
@pytest.mark.parametrize("play", [0.0, PLAY])
def test_a_gear_is_two_masses(play, tmp_path):
    """Link and motor as in a model that has both, with an error that falls with the step."""
    link_inertia = 0.02 + 2 * 0.3**2
    elastic = {"effect": "joint_elasticity", "joint": 1, "compliance": 1 / STIFFNESS,
               "damping": DAMPING}  # fmt: skip
    effects_of: list[dict[str, object]] = [elastic]
    if play:
        hertz = np.sqrt(STIFFNESS / link_inertia) / (2 * np.pi)
        ratio = DAMPING / (2 * np.sqrt(STIFFNESS * link_inertia))
        effects_of = [
            {"effect": "backlash", "joint": 1, "width": play, "contact": hertz, "ratio": ratio}
        ]
    t = np.arange(1, 41) * 0.01
    expected, errors = None, []
    for h in (1e-3, 2.5e-4):
        effects = pendulum(effects_of, h, tmp_path)
        assert not effects.ignored
        ((_, data),) = effects.simulations
        if expected is None:
            start = float(effects.sensed().q - data.qpos[0])
            expected = two_masses(start, play, t)
        found = []
        for now in t:
            while data.time < now - h / 2:
                effects.step(torch.tensor([[8 * np.sin(9 * data.time)]]))
            found.append([data.qpos[0], float(effects.sensed().q)])
        errors.append(np.abs(np.array(found) - expected).max())
    size = np.abs(expected).max()
    assert errors[0] < 0.02 * size
    assert errors[1] < 0.45 * errors[0]


def two_masses(start: float, play: float, t: np.ndarray) -> np.ndarray:
    """Angles (T, 2) of link and motor at these instants, from an MJCF that has both, the gear's
    torque applied explicitly at a tiny step; the motor begins so far ahead of the link."""
    model = mujoco.MjModel.from_xml_string(TWO_MASSES.format(h=1e-5))
    data = mujoco.MjData(model)
    data.qpos[1] = start
    out = []
    for now in t:
        while data.time < now - 5e-6:
            twist, rate = data.qpos[1] - data.qpos[0], data.qvel[1] - data.qvel[0]
            push = STIFFNESS * np.sign(twist) * max(0.0, abs(twist) - play / 2) + DAMPING * rate
            data.qfrc_applied[:] = push, 8 * np.sin(9 * data.time) - push
            mujoco.mj_step(model, data)
        out.append(data.qpos.copy())
    return np.array(out)


def test_the_motor_is_ahead_by_the_compliance(tmp_path):
    """In slow motion, as torchid's own effect measures it, and on a gear whose resonance (5 kHz) is
    far beyond the step."""
    compliance = 1e-6
    elastic = {"effect": "joint_elasticity", "joint": 1, "compliance": compliance}
    effects = pendulum([elastic], 2e-3, tmp_path)
    ((_, data),) = effects.simulations
    for _ in range(2000):
        effects.step(torch.tensor([[-60.0 * data.qpos[0] - 10.0 * data.qvel[0]]]))
    held = 2 * 9.81 * 0.3 * np.cos(data.qpos[0])
    assert abs(data.qvel[0]) < 1e-6
    ahead = float(effects.sensed().q) - data.qpos[0]
    # A positive angle lowers the link, so its weight pulls it ahead of the motor.
    assert ahead == pytest.approx(-compliance * held, rel=1e-3)


def test_sensors_are_late(tmp_path):
    """Delays of whole steps are exact, of parts of a step between the two."""
    late = (
        {"effect": "time_delay", "joint": 1, "delay": 0.004},
        {"effect": "time_delay", "joint": 2, "delay": 0.0025},
        {"effect": "filter_lag", "lag": 0.003},
    )
    _, effects = in_mujoco(replace(arm("3r"), effects=(*FIELDS, *late)), tmp_path)
    assert not effects.ignored
    g = torch.Generator().manual_seed(2)
    torques = torch.randn(20, 1, 3, generator=g, dtype=torch.float64)
    speeds = []
    for torque in torques:
        effects.step(torque)
        speeds.append(effects.motion().dq)
    seen = effects.sensed()
    # At 20 ms the torque of the step that ended then is the last.
    torch.testing.assert_close(seen.torque[:, 0], torques[-5, :, 0], atol=1e-9, rtol=0)
    between = (torques[-4, :, 1] + torques[-3, :, 1]) / 2
    torch.testing.assert_close(seen.torque[:, 1], between, atol=1e-9, rtol=0)
    torch.testing.assert_close(seen.torque[:, 2], torques[-1, :, 2], atol=0, rtol=0)
    torch.testing.assert_close(seen.dq, speeds[-4], atol=1e-9, rtol=0)


def test_explicit_integrators_are_refused(tmp_path):
    robot, effects = in_mujoco(robot_with("stribeck"), tmp_path)
    ((model, data),) = effects.simulations
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    with pytest.raises(TorchidError, match="RK4"):
        Effects(robot, [(model, data)])
