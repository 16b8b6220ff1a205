"""Planted effects: what each changes in the gap, on the joints where it should."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from tests.torchid_bench.withheld.plant.conftest import SHORT
from torchid.effects.registry import FAMILIES
from torchid_bench.withheld.plant.arms import arm_named
from torchid_bench.withheld.plant.catalogue import FOREIGN, KINDS, LIBRARY, drawn_effect
from torchid_bench.withheld.plant.model import Drive, compiled, plant_of
from torchid_bench.withheld.plant.plan import EffectSpec, Plan
from torchid_bench.withheld.plant.scene import nominal_of, scene_of
from torchid_bench.withheld.plant.simulate import (
    gaps,
    readings,
    simulated,
    size_of,
    sized,
    with_effect,
)

STEP = 5e-4

LOCAL = (
    "viscous_friction",
    "power_law_friction",
    "coulomb_friction",
    "stribeck_friction",
    "load_dependent_friction",
    "torque_offset",
    "asymmetric_friction",
    "torque_gain",
    "torque_crosstalk",
    "joint_spring",
    "rotor_inertia",
    "time_delay",
    "presliding_hysteresis",
    "cogging",
    "thermal_friction_drift",
    "saturation",
    "dropped_samples",
    "uneven_friction",
    "uneven_damping",
    "motor_ripple",
    "random_load",
    "random_resistance",
    "creep",
    "bursts",
)
"""Effects that change their own joint's gap alone."""


def effect(name, joints=(1,), **draws):
    drawn = KINDS[name].draws(np.random.default_rng(4), 3, joints)
    return EffectSpec(name, joints, {**drawn, **draws})


def shown(bench, spec, scale):
    """The plan, its traces and its gaps."""
    scene, base, nominal = bench
    plan, _ = with_effect(scene, base, spec, scale)
    traces = simulated(scene, plan, nominal, STEP)
    return plan, traces, gaps(plan, nominal, traces)


def test_names_and_families_are_torchids():
    """The plant is written on its own: effects that torchid learns later need not be in it."""
    assert set(LIBRARY) <= set(FAMILIES)
    assert all(KINDS[name].family == FAMILIES[name] for name in LIBRARY)
    # The ripple was foreign first; draws of sealed cases do not change with the library.
    assert set(FOREIGN) & set(FAMILIES) == {"motor_ripple"}


@pytest.mark.parametrize(
    ("name", "draws", "column"),
    [
        ("viscous_friction", {}, lambda x: x.dq[:, 1]),
        ("torque_offset", {"direction": -1.0}, lambda x: -np.ones(len(x.t))),
        ("rotor_inertia", {}, lambda x: x.ddq[:, 1]),
        ("torque_gain", {"direction": 1.0}, lambda x: x.tau[:, 1] / 1.5),
        ("power_law_friction", {"exponent": 2.0}, lambda x: x.dq[:, 1] * np.abs(x.dq[:, 1])),
        ("load_dependent_friction", {"deflection": 1e-4}, None),
    ],
)
def test_the_gap_is_the_effects_torque(bench, name, draws, column):
    plan, traces, gap = shown(bench, effect(name, **draws), 0.5)
    reading = readings(plan, traces)[0]
    if column is None:
        gear = reading.tau[:, 1] / (1 + 0.5 * np.sign(reading.dq[:, 1] * reading.tau[:, 1]))
        column = lambda x: np.abs(gear) * np.sign(x.dq[:, 1])  # noqa: E731
    expected = 0.5 * column(reading)[:: round(0.004 / STEP)]
    left = np.abs(gap[0][:, 1] - expected)
    assert np.median(left) < 0.03 * np.abs(expected).max()
    assert np.abs(gap[0][:, [0, 2]]).max() < 0.02 * np.abs(gap[0][:, 1]).max()


@pytest.mark.slow
def test_a_stiff_gear_is_no_effect(bench):
    scene, base, nominal = bench
    light = float(scene.inertia[1, 0])
    drive = Drive(1, 0.2 * light, (2 * np.pi * 60) ** 2 * light, 40.0 * light)
    plan = replace(base, plant=replace(base.plant, drives=(drive,)))
    traces = simulated(scene, plan, nominal, 2.5e-4)
    assert (size_of(scene, plan, nominal, traces) < 0.1).all()
    soft = replace(drive, stiffness=drive.stiffness / 60)
    plan = replace(base, plant=replace(base.plant, drives=(soft,)))
    assert size_of(scene, plan, nominal, simulated(scene, plan, nominal, 2.5e-4))[1] > 0.5


def test_an_elastic_joint_deflects_by_its_torque(bench):
    """The log has the motor: at rest the gap is what gravity changes over the deflection."""
    scene, base, nominal = bench
    scene = replace(scene, shapes=tuple(shape.scaled(0.0) for shape in scene.shapes))
    plan, traces, _ = shown((scene, base, nominal), effect("joint_elasticity"), 2e-3)
    torque = traces[0].truth.tau[-1] - traces[0].friction[-1]
    motor, zero = traces[0].truth.q[-1:], np.zeros((1, 3))
    link = motor - 2e-3 * np.array([[0.0, torque[1], 0.0]])
    held, stiff = (nominal.rigid(q, zero, zero)[0] for q in (link, motor))
    assert np.abs(stiff - held).max() > 0.1
    np.testing.assert_allclose(torque, held, atol=0.01)
    assert plan.plant.drives


def test_a_rotor_takes_no_more_than_its_link_has():
    """Parallel axes share inertia: alone, a link of the 6R may have a tenth of what its joint has
    on the diagonal, and a heavier rotor would leave it less than nothing."""
    arm = arm_named("6r")
    zeros = np.zeros(6)
    nominal = nominal_of(arm, zeros, zeros)
    scene = scene_of(arm, nominal, replace(SHORT, moving=tuple(range(6))), 0.01, 5.0, 0.8)
    base = Plan(plant_of(arm, zeros, zeros), zeros, zeros)
    assert (scene.free_inertia < scene.inertia[:, 0] + 1e-12).all()
    assert scene.free_inertia[2] < 0.3 * scene.inertia[2, 0]
    for joint in range(6):
        plan, _ = with_effect(scene, base, effect("backlash", joints=(joint,)), 1e-3)
        model, _ = compiled(plan.plant, scene.kp, scene.kd, STEP)
        data, full = mujoco.MjData(model), np.empty((7, 7))
        for row in scene.shapes[0].state(np.arange(0, 4, 0.5))[0]:
            data.qpos[[k for k in range(7) if k != joint + 1]] = row
            mujoco.mj_forward(model, data)
            mujoco.mj_fullM(model, data, full)
            assert np.linalg.eigvalsh(full)[0] > 1e-5


def test_an_encoder_offset_deceives_the_controller_too(bench):
    scene, base, nominal = bench
    plan, traces, _ = shown(bench, effect("encoder_offset", direction=1.0), 0.05)
    truth = simulated(scene, base, nominal, STEP)[0].truth
    measured = traces[0].truth
    # What is measured follows the reference as before; the torque is that of q + 0.05.
    assert np.abs(measured.q - truth.q).max() < 0.02
    moved = measured.q + np.array([0.0, 0.05, 0.0])
    there = nominal.rigid(moved, measured.dq, measured.ddq)
    rest = measured.tau - traces[0].friction - base.known_damping * measured.dq
    np.testing.assert_allclose(rest, there, atol=0.01 * np.abs(there).max())
    assert plan.offset is not None


def test_a_reading_clips_and_the_motion_does_not_know(bench):
    scene, _, _ = bench
    plan, traces, _ = shown(bench, effect("saturation"), 0.4)
    limit = 0.6 * scene.peak[1]
    reading = readings(plan, traces)[0]
    assert np.abs(reading.tau[:, 1]).max() <= limit + 1e-9
    assert np.abs(traces[0].truth.tau[:, 1]).max() > 1.2 * limit
    small = np.abs(traces[0].truth.tau[:, 1]) < 0.95 * limit
    np.testing.assert_array_equal(reading.tau[small], traces[0].truth.tau[small])


def test_friction_that_must_resist_is_known(bench):
    """A direction's friction below zero would drive the arm, so the nominal model knows more."""
    scene, base, _ = bench
    for name in ("asymmetric_friction", "uneven_friction", "uneven_damping"):
        plan, parameters = with_effect(scene, base, effect(name), 3.0)
        know = plan.known_damping if name == "uneven_damping" else plan.known_friction
        assert know[1] > 3.0, name
        assert parameters


def test_coupled_motors_add_what_the_other_joint_does(bench):
    """On joint j: Fvm (dq_j + r dq_i); Fvm dq_j is known."""
    _, base, _ = bench
    spec = effect("gear_coupling", joints=(1, 2), ratio=-1.0, coulomb=0.0)
    plan, traces, gap = shown(bench, spec, 0.5)
    dq = traces[0].truth.dq[:: round(0.004 / STEP)]
    for joint, other in ((1, 2), (2, 1)):
        error = gap[0][:, joint] + 0.5 * dq[:, other]
        assert np.median(np.abs(error)) < 0.05 * np.abs(dq[:, other]).max()
    assert plan.known_damping[1] == pytest.approx(base.known_damping[1] + 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("name", list(KINDS))
def test_every_effect_reaches_its_size(bench, name):
    scene, base, nominal = bench
    spec = drawn_effect(np.random.default_rng(1), name, arm_named("3r"), avoid=(0,))
    one = sized(scene, base, nominal, spec, 5.0)
    limited = KINDS[name].largest(scene, spec) <= one.scale * 1.0001
    assert one.size.max() == pytest.approx(5.0, rel=0.2) or (limited and one.size.max() > 0.2)
    assert with_effect(scene, base, spec, one.scale)[1]
    if name in LOCAL:
        joint = spec.joints[0]
        others = np.delete(one.size, joint)
        assert others.max() < 0.1, one.size
