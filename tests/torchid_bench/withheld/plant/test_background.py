"""Torques along recorded motions are those of MuJoCo's forward dynamics, and the background is as
large as it is asked to be, whatever is planted."""

from dataclasses import replace

import numpy as np
import pytest
from lxml import etree
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline

from tests.marks import quick_first
from torchid_bench.withheld.plant.along import (
    STEP,
    paths_of,
    rigid_along,
    slipping,
    together,
    torque_along,
)
from torchid_bench.withheld.plant.arms import arm_named
from torchid_bench.withheld.plant.background import (
    drawn_background,
    imperfect,
    scaled,
    small_things,
)
from torchid_bench.withheld.plant.background_case import of_background
from torchid_bench.withheld.plant.catalogue import drawn_effect, kind_named
from torchid_bench.withheld.plant.draw import MIXES, draw_case
from torchid_bench.withheld.plant.model import compiled, mujoco, plant_of
from torchid_bench.withheld.plant.plan import Live, Plan
from torchid_bench.withheld.plant.recorded import STYLES, recorded
from torchid_bench.withheld.plant.scene import friction_known, nominal_of, scene_along


def scene(arm="3r", style="pick and place", seed=0, seconds=8.0):
    """A short motion of an arm, and the arm without effects."""
    arm, rng = arm_named(arm), np.random.default_rng(seed)
    known = friction_known(arm, np.full(arm.n, 0.01), np.full(arm.n, 0.01))
    nominal = nominal_of(arm, *known)
    motion = recorded(rng, arm, nominal, style, seconds, rng.uniform(-0.3, 0.3, arm.n))
    made = scene_along(nominal, (motion,), (0,), (0.0,), arm, 0.01)
    return made, Plan(plant_of(arm, *known), *known)


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("arm", ["3r", "7r"])
def test_motions_are_smooth_at_rest_at_first_and_within_limits(style, arm):
    made, _ = scene(arm, style, seed=3, seconds=20.0)
    (motion,) = made.shapes
    t = np.arange(0.0, motion.seconds, 1e-3)
    q, dq, ddq = motion.state(t)
    assert np.abs(np.gradient(q, 1e-3, axis=0) - dq).max() < 1e-3
    assert np.abs(np.gradient(dq, 1e-3, axis=0) - ddq).max() < 2e-2
    assert np.abs(dq[0]).max() == np.abs(motion.state(np.array([-1.0]))[1]).max() == 0
    for x, joint in zip(q.T, made.arm.joints, strict=True):
        assert joint.lower <= x.min() <= x.max() <= joint.upper
    for v, joint in zip(dq.T, made.arm.joints, strict=True):
        assert np.abs(v).max() <= joint.velocity
    assert motion.slower(2.0).seconds == 2 * motion.seconds


BODIES = (
    None, "payload", "rotor_inertia", "joint_spring", "base_tilt", "gear_coupling", "fluid_drag",
    "kinematic_error", "encoder_offset", "contact",
)  # fmt: skip
LAWS = ("load_dependent_friction", "coulomb_friction", "cogging", "creep", "random_resistance")


@pytest.mark.parametrize("name", [*BODIES, *LAWS])
def test_forward_dynamics_with_these_torques_make_the_motion(name):
    """MuJoCo steps the arm under the torques along the motion and weak controllers, whose own
    torque is what the two are apart."""
    made, plan = scene(seed=1, seconds=5.0)
    zero = np.zeros(3)
    plan = replace(plan, plant=replace(plan.plant, friction=zero))
    if name:
        effect = drawn_effect(np.random.default_rng(2), name, made.arm)
        effect = replace(effect, draws={**effect.draws, "counterbalance": 0.0})
        kind = kind_named(name)
        plan, _ = kind.plant(made, plan, effect, kind.usual(made, effect))
        couplings = tuple(replace(c, friction=0.0) for c in plan.plant.couplings)
        plan = replace(plan, plant=replace(plan.plant, couplings=couplings, friction=zero))
    (path,) = paths_of(made, np.full((3, 1), 1e-3))
    tau = torque_along(plan, path)
    kp, kd, step = made.kp, made.kd, 2.5e-4
    model, motors = compiled(plan.plant, kp, kd, step)
    data = mujoco().MjData(model)
    fine = np.arange(0.0, path.t[-1], step)
    q, dq, _ = made.shapes[0].state(fine)
    q = q + (0.0 if plan.offset is None else plan.offset)
    command = CubicSpline(path.t, tau)(fine) + kp * q + kd * dq
    live = Live(
        data.qpos, data.qvel, data.qfrc_applied, model.dof_frictionloss, model.dof_damping,
        motors, command, kp, kd, fine, step,
    )  # fmt: skip
    acts = [law(live) for law in plan.laws]
    push = None if plan.push is None else plan.push(fine, 0)
    data.qpos[motors], errors = q[0], []
    for k, u in enumerate(command):
        data.ctrl[:] = u
        own = data.ctrl - kp * data.qpos[motors] - kd * data.qvel[motors]
        errors.append(own - (command[k] - kp * q[k] - kd * dq[k]))
        data.qfrc_applied[:] = 0.0
        for act in acts:
            act(k)
        if push is not None:
            data.xfrc_applied[-1, :3] = push[k]
        mujoco().mj_step(model, data)
    apart = np.sqrt((np.array(errors) ** 2).mean(0))
    # Bristles slip at another step where the steps are others.
    assert (apart < (1e-2 if name in LAWS else 3e-3) * made.torque.max()).all()


def test_motors_give_the_energy_that_the_arm_gains_and_loses():
    made, plan = scene("6r", seed=4)
    (path,) = paths_of(made, np.full((6, 4), 1e-3))
    tau = rigid_along(plan, path)
    model, motors = compiled(plan.plant, np.zeros(6), np.zeros(6), 1e-3)
    model.opt.enableflags |= mujoco().mjtEnableBit.mjENBL_ENERGY
    data, energy = mujoco().MjData(model), []
    for q, dq in zip(path.q, path.dq, strict=True):
        data.qpos[motors], data.qvel[motors] = q, dq
        mujoco().mj_forward(model, data)
        energy.append(data.energy.sum())
    lost = plan.plant.damping * path.dq**2 + plan.plant.friction * path.bent * path.dq
    work = cumulative_trapezoid(((tau * path.dq) - lost).sum(1), dx=STEP, initial=0.0)
    assert np.ptp(energy) > 5.0
    assert np.abs(work - (np.array(energy) - energy[0])).max() < 2e-3 * np.ptp(energy)


def test_elements_bend_slide_and_come_back():
    q = np.concatenate([np.linspace(0, 1, 50), np.linspace(1, 0.99, 5), np.linspace(0.99, 0, 50)])
    bent = slipping(q[:, None], np.array([[0.1, 0.01]]))
    np.testing.assert_allclose(bent[49], [[1, 1]])
    np.testing.assert_allclose(bent[54], [[0.9, 0.0]], atol=1e-9)
    np.testing.assert_allclose(bent[-1], [[-1, -1]])
    # A closed loop takes energy, whatever its size.
    loop = 0.03 * np.sin(np.linspace(0, 4 * np.pi, 4001))
    carried = slipping(loop[:, None], np.array([[0.02, 0.005]])).mean(2)[2000:, 0]
    assert np.sum(carried[1:] * np.diff(loop[2000:])) > 0


@pytest.mark.parametrize("share", [0.07, 0.3])
@pytest.mark.parametrize("arm", ["3r", "6r"])
def test_what_usual_laws_leave_has_the_size_that_is_asked_for(share, arm):
    """By a fit of other columns than the plant's own: it must leave as much within a half."""
    made, plan = scene(arm, seed=5, seconds=25.0)
    plan = replace(plan, plant=imperfect(np.random.default_rng(6), plan.plant))
    small = drawn_background(np.random.default_rng(7), made)
    paths = paths_of(made, small.lengths)
    loads = [rigid_along(plan, path) for path in paths]
    small = scaled(small, plan, made, paths, loads, 100.0, 0.05 * share)
    (path,) = paths_of(made, small.lengths)
    added = small_things(small, plan, path, loads[0], 100.0)
    sign = np.tanh(path.dq / 0.005)
    raw = added + plan.plant.friction * (path.bent - sign)
    y, load, s, v = (together([x], STEP, 10) for x in (raw, loads[0], sign, path.dq))
    slow = together([sign * np.exp(-((path.dq / small.speed) ** 2))], STEP, 10)
    slip = [slipping(path.q, small.presliding[:, None] * x)[..., 0] for x in (0.5, 1.0, 2.0)]
    q, rate = (together([x], STEP, 10) for x in (path.q, np.gradient(loads[0], STEP, axis=0)))
    columns = [np.ones_like(y), s, v, v * np.abs(v), s * np.abs(load), load, slow, rate]
    columns += [together([x], STEP, 10) for x in slip] + [np.sin(q), np.cos(q)]
    columns += [load * wave(small.wave * q) for wave in (np.sin, np.cos)]
    for j in range(made.n):
        rows = np.abs(v[:, j]) > 0.02
        a = np.stack([x[rows, j] for x in columns], 1)
        left = y[rows, j] - a @ np.linalg.lstsq(a, y[rows, j], rcond=None)[0]
        size = np.sqrt((left**2).mean()) / made.torque[j]
        assert 0.5 < size / (0.05 * share) < 1.6


@pytest.fixture(scope="module")
def two():
    """A case of two causes, ideal: with both, with each, with none."""
    spec = draw_case(5, 0, mix="background", background=0.15, arm="3r",
                     effects=("torque_offset", "payload"))  # fmt: skip
    return {k: of_background(spec, only=k, ideal=True) for k in ((0, 1), (0,), (1,), ())}


def test_the_background_is_the_same_whatever_is_planted(two):
    both, first, second, bare = (two[k].logs[0] for k in ((0, 1), (0,), (1,), ()))
    torque = np.array(two[()].key["torque"])
    (joint,) = two[(0,)].key["effects"][0]["joints"]
    for j in (1, 2, 3):
        change = first[f"tau{j}"] - bare[f"tau{j}"]
        assert np.ptp(change) < 1e-9
        assert bool(np.abs(change).max() > 1e-6) == (j == joint)
        rest = both[f"tau{j}"] - first[f"tau{j}"] - second[f"tau{j}"] + bare[f"tau{j}"]
        assert np.abs(rest).max() < 1e-9
        np.testing.assert_array_equal(both[f"q{j}"], bare[f"q{j}"])
    assert abs(first[f"tau{joint}"] - bare[f"tau{joint}"]).max() == pytest.approx(
        0.05 * torque[joint - 1], rel=0.15
    )
    assert [e["size"] for e in two[(0, 1)].key["effects"]] == pytest.approx([0.05, 0.05], rel=0.15)


def test_the_earlier_log_is_of_the_same_arm_on_another_motion_without_its_effects(two):
    whole, bare = two[(0, 1)], two[()]
    assert whole.urdf == bare.urdf
    for name, x in whole.earlier.items():
        np.testing.assert_array_equal(x, bare.earlier[name])
    assert len(whole.earlier["t"]) != len(whole.logs[0]["t"])


@pytest.mark.parametrize(
    "name",
    quick_first(["gear_coupling", "thermal_friction_drift", "asymmetric_friction"], 1),
)
def test_the_earlier_log_has_the_friction_that_the_file_knows(name):
    spec = draw_case(5, 0, mix="background", background=0.15, arm="3r", effects=(name,))
    whole, bare = (of_background(spec, only=k, ideal=True) for k in (None, ()))
    for j in range(3):
        more = []
        for known in ("damping", "friction"):
            with_, without = (
                [float(e.get(known, 0)) for e in etree.fromstring(x.urdf.encode()).iter("dynamics")]
                for x in (whole, bare)
            )
            more.append(with_[j] - without[j])
        change = whole.earlier[f"tau{j + 1}"] - bare.earlier[f"tau{j + 1}"]
        speed = whole.earlier[f"dq{j + 1}"]
        fast = np.abs(speed) > 0.2
        # Late torques, and a gain of some per cent.
        expected = (more[0] * speed + more[1] * np.sign(speed))[fast]
        assert np.abs(change[fast] - expected).max(initial=0.0) <= 0.1 * np.ptp(expected) + 1e-9


def test_a_set_has_its_kinds_its_earlier_logs_and_its_files():
    specs = [draw_case(9, k, mix="background", background=0.3) for k in range(24)]
    kinds = [s.kind for s in specs]
    assert {k: kinds.count(k) for k in set(kinds)} == {
        "none": 4, "single": 12, "several": 4, "outside": 4
    }  # fmt: skip
    assert sum(s.earlier for s in specs) == 12
    assert all(len(s.effects) == {"none": 0, "several": 2}.get(s.kind, 1) for s in specs)
    assert specs == [draw_case(9, k, mix="background", background=0.3) for k in range(24)]


@pytest.mark.slow
@pytest.mark.parametrize("name", MIXES["background"].effects)
def test_every_effect_can_be_planted_at_standard_size(name):
    spec = draw_case(4, 1, mix="background", background=0.07, arm="6r", effects=(name,))
    made = of_background(spec)
    (effect,) = made.key["effects"]
    assert effect["felt_by"]
    assert 0.02 < effect["size"] < 0.08
    assert all(np.isfinite(x).all() for log in made.logs for x in log.values())
