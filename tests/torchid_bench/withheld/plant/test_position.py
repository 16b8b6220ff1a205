"""Servos in MuJoCo do what their numbers say, and cases of positions are drawn whole."""

from dataclasses import replace

import numpy as np
import pytest

from torchid.errors import TorchidError
from torchid_bench.withheld.plant.arms import arm_named
from torchid_bench.withheld.plant.case import simulate_case
from torchid_bench.withheld.plant.catalogue import OUTSIDE
from torchid_bench.withheld.plant.draw import MIXES, draw_case
from torchid_bench.withheld.plant.model import plant_of
from torchid_bench.withheld.plant.plan import EffectSpec, Plan
from torchid_bench.withheld.plant.servo import NEUTRAL, Servos, moved, set_points
from torchid_bench.withheld.plant.servo_catalogue import SERVO_KINDS, ServoScene
from torchid_bench.withheld.plant.servo_scene import led_motions, motions

RATE = 50.0


@pytest.fixture(scope="module")
def scene() -> ServoScene:
    """The 3R with plain servos, on four seconds of a motion."""
    arm = arm_named("3r")
    kp = np.array([300.0, 800.0, 350.0])
    plant = plant_of(arm, np.zeros(3), np.zeros(3))
    plant = replace(plant, damping=kp / 15, armature=kp / 400)
    servos = Servos({"kp": kp, "coulomb": 0.003 * kp}, rate_hz=RATE)
    t = np.arange(200)[:, None] / RATE
    u = 0.3 + 0.4 * np.sin(np.array([1.8, 2.4, 3.1]) * t) * np.minimum(t, 1)
    plan = Plan(plant, np.zeros(3), np.zeros(3), servos=servos)
    return ServoScene(arm, plan, kp / 300, [u], moved(plant, servos, [u]))


def test_a_command_is_held_until_the_next_and_late(scene):
    u = np.arange(6.0)[:, None]
    servos = Servos({"delay": np.array([0.008]), "scale": np.array([2.0])}, rate_hz=RATE)
    x, _ = set_points(servos, u, 10, np.random.default_rng(0))
    assert (
        x[:, 0].tolist()
        == [0.0] * 14 + [2.0] * 10 + [4.0] * 10 + [6.0] * 10 + [8.0] * 10 + [10.0] * 6
    )


def test_a_profile_keeps_its_limits_and_comes_to_rest():
    u = np.repeat([[0.0], [0.5]], [5, 95], axis=0)
    limits = {"acceleration": np.array([4.0]), "speed": np.array([0.6])}
    x, _ = set_points(Servos(limits, rate_hz=RATE), u, 10, np.random.default_rng(0))
    speed = np.diff(x[:, 0]) / 0.002
    assert np.abs(speed).max() <= 0.6 + 1e-9
    assert np.abs(np.diff(speed)).max() / 0.002 <= 4.0 + 1e-6
    assert x.max() <= 0.5 + 1e-3
    assert x[-1, 0] == pytest.approx(0.5, abs=1e-4)
    # As long as at 0.6 rad/s with both ramps: 0.5/0.6 + 0.6/4 s.
    assert np.argmax(x[:, 0] > 0.499) * 0.002 == pytest.approx(0.1 + 0.5 / 0.6 + 0.15, abs=0.03)


def test_at_rest_the_error_carries_the_load(scene):
    held = np.full((100, 3), 0.7)
    (found,) = moved(scene.plan.plant, replace(scene.servos, values={"kp": scene.of("kp")}), [held])
    assert found.torque[-1] == pytest.approx(found.load[-1], abs=0.02 * np.abs(found.load).max())
    assert np.abs(scene.of("kp") * (0.7 - found.q[-1])) == pytest.approx(
        np.abs(found.load[-1]), abs=1.0
    )


def test_friction_holds_a_joint_for_minutes(scene):
    values = {"kp": scene.of("kp"), "coulomb": 0.05 * scene.of("kp")}
    step = np.repeat([[0.5] * 3, [0.52] * 3], [10, 1500], axis=0)
    (found,) = moved(scene.plan.plant, replace(scene.servos, values=values), [step])
    # A set-point 20 mrad away is within the friction's band of 50: nothing moves.
    assert np.abs(found.q[-1] - found.q[100]).max() < 1e-4


def test_ends_and_floors_are_not_passed(scene):
    u = scene.commands
    end, floor = 0.45, float(np.quantile(scene.base[0].tool, 0.3))
    (stopped,) = moved(replace(scene.plan.plant, stops={1: (-3.0, end)}), scene.servos, u)
    assert scene.base[0].q[:, 1].max() > end + 0.05
    assert stopped.q[:, 1].max() < end + 5e-3
    (touching,) = moved(replace(scene.plan.plant, floor=floor), scene.servos, u)
    assert scene.base[0].tool.min() < floor - 5e-3
    assert touching.tool.min() > floor - 3e-3


@pytest.mark.parametrize("name", SERVO_KINDS)
def test_every_effect_changes_the_motion_of_its_joint_most(scene, name):
    kind = SERVO_KINDS[name]
    place = () if kind.place in ("arm", "all") else (1,)
    effect = EffectSpec(name, place, {"variant": 0.7})
    plan, numbers = kind.plant(scene, scene.plan, effect, 1.0)
    assert numbers
    assert set(plan.servos.values) <= set(NEUTRAL)
    (found,) = led_motions(scene, plan)
    change = np.sqrt(((found.logged - scene.base[0].logged) ** 2).mean(0))
    if name != "dropped_commands":  # of which four seconds may see none that matters
        assert change.max() > 2e-4
    if place and not plan.plant.drives:  # what lies behind a spring moves the whole arm
        assert change.argmax() == 1


def test_kinds_and_effects_take_turns():
    mix = MIXES["position"]
    specs = [draw_case(7, k, mix="position") for k in range(60)]
    assert sorted(s.kind for s in specs[20:40]) == sorted(mix.block)
    singles = [s.effects[0].name for s in specs if s.kind == "single"]
    assert set(singles[: len(mix.library)]) == set(mix.library)
    foreign = [s.effects[0].name for s in specs if s.kind == "outside"]
    assert all(SERVO_KINDS[name].family == OUTSIDE for name in foreign)
    assert {s.arm for s in specs} == {"3r", "6r", "7r"}
    assert [draw_case(7, k, mix="position") for k in range(60)] == specs
    with pytest.raises(TorchidError, match="no effect 'rust'"):
        draw_case(7, 0, effects=["rust"], mix="position")


def test_motions_stay_within_limits():
    arm = arm_named("7r")
    limit = np.array([joint.upper for joint in arm.joints])
    drawn = motions(arm, RATE, np.random.default_rng(3))
    assert len(drawn) == 7
    assert all((np.abs(u) <= limit).all() for u in drawn)


@pytest.mark.usefixtures("types_unchecked")
def test_a_case_has_commands_positions_in_counts_and_a_key():
    case = simulate_case(draw_case(3, 0, effects=["command_delay"], arm="3r", mix="position"))
    assert list(case.columns) == ["t", "u1", "u2", "u3", "q1", "q2", "q3", "traj"]
    count = 2 * np.pi / case.key["counts"]
    steps = case.columns["q2"] / count
    assert steps == pytest.approx(np.round(steps), abs=1e-6)
    (effect,) = case.key["effects"]
    assert (effect["name"], effect["family"]) == ("command_delay", "command")
    assert effect["parameters"]["delay"] > 1 / case.key["rate_hz"]
    assert effect["size"] > 0
