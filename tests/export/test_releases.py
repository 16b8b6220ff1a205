"""Fields that some releases of MuJoCo have: each is run where the installed one has it, and is left
out, and said, where not."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from tests.position.planted import robot, true_servos
from torchid.effects.hysteresis import PreslidingHysteresis
from torchid.effects.motion import Motion
from torchid.effects.periodic import Cogging
from torchid.effects.servo import INDEX
from torchid.export import releases
from torchid.export.export import export_dynamics
from torchid.export.releases import FIELDS, has_field
from torchid.export.results import servo_dynamics
from torchid.export.servo_mjcf import ServosInMujoco, said_in_mjcf, unsaid_parameters
from torchid.position.model import ServoArm

SLIDE = """<mujoco><option gravity="0 0 0"/><worldbody><body>
<joint name="j" type="slide" axis="1 0 0" {joint}/><geom size=".1" mass="1"/></body></worldbody>
<actuator>{actuator}</actuator></mujoco>"""


def needs(name):
    """A mark of tests that only some releases can run."""
    why = f"MuJoCo {mujoco.__version__} has no {FIELDS[name].field}"
    return pytest.mark.skipif(not has_field(name), reason=why)


def written(folder, **own):
    arm = ServoArm(robot(), true_servos(3, **own), torch.ones(3, dtype=torch.float64))
    arm.servos.joint[:, INDEX["delay"]] = 0.0
    return export_dynamics(servo_dynamics(arm), "mjcf", folder, nominal=robot()), arm.servos


@needs("pid")
@pytest.mark.parametrize("scale", [1.0, 0.8])
def test_a_limit_of_speed_is_that_of_the_set_point(scale, tmp_path):
    """The set point of a joint that hangs back by its damping alone goes at that speed."""
    own = {"speed": (2, 1.5), "scale": (2, scale), "lag": (3, 0.05)}
    done, servos = written(tmp_path, **own)
    assert not unsaid_parameters(servos, said_in_mjcf(servos, set_points=True))
    model = mujoco.MjModel.from_xml_path(str(done.files[0]))
    data, k = mujoco.MjData(model), model.actuator("joint_2").id
    data.ctrl[k] = 3.0
    for _ in range(100):
        mujoco.mj_step(model, data)
    gone = scale * data.act[model.actuator_actadr[k]]
    assert gone == pytest.approx(1.5 * 100 * model.opt.timestep, rel=1e-6)
    # At rest by their equation, whatever the scale; `check_servos` has compared others.
    engine = ServosInMujoco(done.files[0], robot())
    zero = np.zeros((1, 3))
    kp, offset = (float(servos.of(name)[1]) for name in ("kp", "offset"))
    assert engine.force(zero + 0.1, zero, zero)[0, 1] == pytest.approx(0.1 * scale * kp + offset)


@needs("pid")
def test_integral_action_is_summed_up_to_the_clip(tmp_path):
    """A constant error for a second makes ki of torque a radian, and no more than the clip."""
    own = {"integral": (2, 100.0), "clip": (2, 30.0), "scale": (2, 0.8)}
    done, servos = written(tmp_path, **own)
    model = mujoco.MjModel.from_xml_path(str(done.files[0]))
    model.dof_armature[:] = 1e9
    data, k = mujoco.MjData(model), model.actuator("joint_2").id
    error, held = 0.05, []
    data.ctrl[k] = error / 0.8
    for _ in range(4000):
        mujoco.mj_step(model, data)
        held.append(data.qfrc_actuator[1])
    kp, offset = (float(servos.of(name)[1]) for name in ("kp", "offset"))
    early = np.arange(200)
    summed = 100.0 * error * model.opt.timestep * early
    assert held[:200] == pytest.approx(offset + kp * error + summed, abs=0.05)
    assert held[-1] == pytest.approx(offset + 30.0, rel=1e-9)
    place = model.actuator_actadr[k] + model.actuator_actnum[k] - 1
    assert 100.0 * 0.8 * data.act[place] == pytest.approx(30.0, rel=1e-3)


@needs("pid")
def test_integral_action_behind_a_set_point(tmp_path):
    """It sums the error that is left to the set point."""
    own = {"integral": (2, 100.0), "acceleration": (2, 40.0), "lag": (2, 0.05)}
    done, servos = written(tmp_path, **own)
    assert not unsaid_parameters(servos, said_in_mjcf(servos, set_points=True))
    model = mujoco.MjModel.from_xml_path(str(done.files[0]))
    data = mujoco.MjData(model)
    data.ctrl[1] = 0.1
    for _ in range(5000):
        mujoco.mj_step(model, data)
    assert data.qpos[1] == pytest.approx(0.1, abs=2e-3)


@needs("springyield")
def test_springyield_is_a_loop():
    """What docs say of it: at 0 the torque is that of the yield, by where the joint comes from."""
    text = SLIDE.format(joint='stiffness="3.5" springyield="0.01"', actuator="")
    model = mujoco.MjModel.from_xml_string(text)
    data, at_zero = mujoco.MjData(model), []
    for q in [*np.linspace(0, 0.1, 50), *np.linspace(0.1, -0.1, 101), *np.linspace(-0.1, 0, 51)]:
        data.qpos[0], data.qvel[0] = q, 0.0
        mujoco.mj_step(model, data)
        if abs(q) < 1e-9:
            data.qpos[0] = q
            mujoco.mj_forward(model, data)
            at_zero.append(float(data.qfrc_spring[0]))
    assert at_zero == pytest.approx([0.0, 0.035, -0.035], rel=0.05, abs=1e-3)


@needs("dcmotor")
def test_a_passive_motor_is_presliding_hysteresis_and_cogging():
    """To and fro, of any amplitude: the torques of both effects, to rounding, and no control."""
    friction, ripple = PreslidingHysteresis(0, 0.05), Cogging(0, 12.3)
    f, a, c, dt = 0.4, 0.3, -0.2, 0.002
    turn = np.arctan2(c, a)
    motor = (
        "<dcmotor joint='j' input='none' resistance='1' motorconst='0' "
        f"lugre='{f / 0.05} 0 {f} {f} 1' cogging='{-np.hypot(a, c)} 12.3 {turn}'/>"
    )
    model = mujoco.MjModel.from_xml_string(SLIDE.format(joint="", actuator=motor))
    assert model.nu == 0
    model.opt.timestep, model.dof_armature[0] = dt, 1e9
    data, said = mujoco.MjData(model), []
    t = dt * np.arange(2000)
    q = (0.15 * np.sin(3 * t) + 0.02 * np.sin(17 * t))[:, None]
    dq = np.diff(q, axis=0, append=q[-1:]) / dt
    for place, speed in zip(q, dq, strict=True):
        data.qpos[:], data.qvel[:] = place, speed
        mujoco.mj_forward(model, data)
        said.append(float(data.qfrc_actuator[0]))
        mujoco.mj_step(model, data)
    state = [torch.from_numpy(x).double() for x in (q, dq, np.zeros_like(q))]
    motion = Motion(*state, t=torch.from_numpy(t))
    expected = f * friction.columns(motion)[..., 0] + ripple.columns(motion) @ torch.tensor(
        [a, c], dtype=torch.float64
    )
    assert -np.array(said) == pytest.approx(expected.flatten().numpy(), abs=1e-9)
    assert np.ptp(said) > 0.8


def test_what_a_release_lacks_is_left_out_and_said(tmp_path, monkeypatch):
    """The older form: an actuator of kp and the others alone."""
    monkeypatch.setitem(
        FIELDS, "pid", releases.Field("x", "`<pid>`", "y", actuator="<none joint='j'/>")
    )
    has_field.cache_clear()
    try:
        assert not has_field("pid")
        done, servos = written(tmp_path, speed=(2, 1.5), integral=(3, 10.0))
        lost = unsaid_parameters(servos, said_in_mjcf(servos, set_points=True))
        assert lost == {"integral": (2,), "speed": (1,)}
        said = f"MuJoCo {mujoco.__version__} has no `<pid>`, so integral and speed of servos"
        assert any(said in w for w in done.warnings)
        text = done.files[0].read_text()
        assert said in text
        assert "pid" not in text.partition("<actuator>")[2]
    finally:
        has_field.cache_clear()


def test_the_table_of_the_docs_is_what_the_releases_say():
    """Its words, and the column of the installed release where it has one."""
    page = (Path(__file__).parents[2] / "docs" / "export.md").read_text()
    first, _, *lines = (
        page[page.index("| what is found | field") :].partition("\n\n")[0].splitlines()
    )
    heads = [cell.strip() for cell in first.split("|")[1:-1]]
    rows = {line.split(" | ")[0].removeprefix("| "): line for line in lines}
    assert list(rows) == [field.found for field in FIELDS.values()]
    for name, field in FIELDS.items():
        cells = [cell.strip() for cell in rows[field.found].split("|")[1:-1]]
        assert (cells[1], cells[-1]) == (field.field, field.without)
        if mujoco.__version__ in heads:
            assert cells[heads.index(mujoco.__version__)] == ("yes" if has_field(name) else "no")
