"""Servos of arms that MuJoCo simulates at 1 kHz; their commands jump between rows of the log."""

from pathlib import Path

import numpy as np
import pytest

import torchid
from torchid_bench.withheld.plant.case import simulate_case
from torchid_bench.withheld.plant.draw import draw_case

mujoco = pytest.importorskip("mujoco")

STEP, RATE, SECONDS = 1e-3, 50, 14.0


def xml(limit: str = "", gravcomp: float = 0.0) -> str:
    """Two links that swing in one plane, with servos of 20 and 12 N m/rad."""
    carried = f'gravcomp="{gravcomp}"' if gravcomp else ""
    servo = 'kp="{}" kv="{}" ctrlrange="-2 2"'
    return f"""<mujoco><compiler angle="radian"/><worldbody>
      <body name="upper" pos="0 0 1" {carried}>
        <joint name="shoulder" axis="0 1 0" damping=".3" armature=".02" frictionloss=".05"/>
        <inertial pos="0 0 -.12" mass=".8" diaginertia=".005 .005 .001"/>
        <body name="lower" pos="0 0 -.25" {carried}>
          <joint name="elbow" axis="0 1 0" damping=".15" armature=".01" frictionloss=".03"/>
          <inertial pos="0 0 -.1" mass=".4" diaginertia=".002 .002 .0005"/>
        </body></body></worldbody><actuator>
      <position name="s" joint="shoulder" {servo.format(20, 0.5)} {limit}/>
      <position name="e" joint="elbow" {servo.format(12, 0.3)}/></actuator></mujoco>"""


def logged(text: str, seed: int = 3) -> torchid.Log:
    """Steps at times of no row, and sines: t, u, and q in counts of 8192."""
    model = mujoco.MjModel.from_xml_string(
        text.replace("<worldbody>", f'<option timestep="{STEP}"/><worldbody>')
    )
    data, random = mujoco.MjData(model), np.random.default_rng(seed)
    steps = round(SECONDS / STEP)
    t = STEP * np.arange(steps)
    jumps = np.cumsum(random.uniform(0.5, 1.1, 40))
    held = 0.9 * random.uniform(-1, 1, (41, 2))[np.searchsorted(jumps, t)]
    u = held + 0.15 * np.sin(t[:, None] * np.array([3.1, 4.7]))
    data.qpos[:] = u[0]
    q = np.zeros_like(u)
    for k in range(steps):
        q[k], data.ctrl[:] = data.qpos, u[k]
        mujoco.mj_step(model, data)
    rows = slice(None, None, round(1 / RATE / STEP))
    count = 2 * np.pi / 8192
    return torchid.Log(t[rows], np.round(q[rows] / count) * count, u=u[rows])


def diagnosed(path: Path, file: str, arm: str) -> torchid.Diagnosis:
    path.write_text(file)
    return torchid.diagnose(path, logged(arm))


@pytest.mark.slow
def test_a_limit_that_the_file_does_not_have_is_found(tmp_path):
    found = diagnosed(tmp_path / "arm.xml", xml(), xml('forcerange="-2.4 2.4"'))
    limits = {c.joints: c for c in found.answer.causes if c.effect == "saturation"}
    assert limits[0,].sizes[0].value == pytest.approx(2.4, rel=0.05)
    assert limits[0,].how_sure > 0.8
    assert found.answer.after.value < 0.125 * found.answer.before.value


@pytest.mark.nightly
def test_gravity_that_the_servos_do_not_feel_is_found(tmp_path):
    found = diagnosed(tmp_path / "arm.xml", xml(), xml(gravcomp=1.0))
    assert found.answer.causes[0].effect == "gravity_compensation"
    assert all(c.how_sure < 0.9 for c in found.answer.causes[1:])


@pytest.mark.nightly
def test_of_a_file_that_is_right_nothing_is_named(tmp_path):
    found = diagnosed(tmp_path / "arm.xml", xml(), xml())
    assert not [c for c in found.answer.causes if c.how_sure > 0.9]
    assert found.answer.before.value < 5.0  # 10.6 where commands go along lines between rows


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cause", "joints"), [("load_dependent_stribeck", {2}), ("supply_sag", {0, 1, 2})]
)
def test_what_the_sealed_plant_has_is_named(cause, joints, tmp_path):
    """Its servos share no line with the simulation that the search is made with."""
    case = simulate_case(draw_case(3, 0, effects=[cause], arm="3r", mix="position"))
    (tmp_path / "arm.urdf").write_text(case.urdf)
    x = {k: np.stack([case.columns[f"{k}{j}"] for j in (1, 2, 3)], 1) for k in "qu"}
    log = torchid.Log(case.columns["t"], x["q"], u=x["u"], trajectory=case.columns["traj"])
    found = torchid.diagnose(tmp_path / "arm.urdf", log)
    assert {c.effect for c in found.answer.causes} == {cause}
    assert {j for c in found.answer.causes for j in c.joints} == joints
    (planted,) = case.key["effects"]
    if len(joints) == 1:
        (one,) = found.answer.causes
        sizes = {size.name: size.value for size in one.sizes}
        for name, value in planted["parameters"].items():
            assert sizes[name] == pytest.approx(value, rel=0.1)
