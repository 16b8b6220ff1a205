"""Published friction of servos' gears is what its equations say, also in MuJoCo, and the background
of arms of servos is as large as it is asked to be, whatever is planted."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from tests.torchid_bench.withheld.plant.test_position import RATE, scene
from torchid_bench.withheld.decidable import servo_classes
from torchid_bench.withheld.plant.case import simulate_case
from torchid_bench.withheld.plant.draw import draw_case
from torchid_bench.withheld.plant.plan import EffectSpec
from torchid_bench.withheld.plant.servo import Servos, moved, set_points
from torchid_bench.withheld.plant.servo_background import STANDARD, surroundings
from torchid_bench.withheld.plant.servo_catalogue import SERVO_KINDS
from torchid_bench.withheld.plant.servo_friction import LAWS, Beyond, gears, published, torque_of
from torchid_bench.withheld.plant.servo_scene import standard_effect

__all__ = ["scene"]

BY_HAND = [
    ("m1", 0.5, 2.0, -1.5, 0.09039),
    ("m2", 1.12, 2.0, -1.5, 0.05612 + 0.08186 / np.e),
    ("m3", 0.5, 2.0, -1.5, 0.1022 + 0.0758 * 3.5),
    ("m4", -1.521, 2.0, -1.5, 0.06155 + (0.0239 + 0.2343 * 3.5) / np.e),
    ("m5", 0.7462, 2.0, -1.5, 0.07502 + 0.7696 + (0.02223 + 0.24885 + 0.06024) / np.e),
    # The smaller torque's square, and none where they pull the same way.
    ("m6", 2.575, 2.0, -1.5, 0.623 + (0.1227 + 0.021105 + 0.3754 + 0.0225) / np.e),
    ("m6", 2.575, -2.0, 3.0, 0.623 + (0.1227 + 0.04221 + 0.3754 + 0.027636) / np.e),
    ("m6", 2.575, 2.0, 1.5, 0.623 + (0.1227 + 0.3754 - 0.021105) / np.e),
]


@pytest.mark.parametrize(("law", "dq", "motor", "external", "bound"), BY_HAND)
def test_the_bound_of_dry_friction_is_the_published_law(law, dq, motor, external, bound):
    own = torque_of("mx64", law)
    for times in (1.0, 20.0):
        gear = gears([("mx64", law)], np.array([own * times]))
        torques = (np.array([x * times]) for x in (motor, external))
        assert gear.bound(np.array([dq]), *torques) == pytest.approx(bound * times, rel=1e-9)


def test_the_table_has_six_laws_of_six_servos_and_one_of_another():
    assert Counter(len(laws) for laws in published().values()) == {6: 6, 1: 1}
    stall = {servo: torque_of(servo, "m1") for servo in published()}
    assert 0.1 < stall["xl320"] < stall["xl330"] < stall["mx64"] < stall["mx106"] < 12
    assert 50 < stall["erob80_50"] < stall["erob80_100"] < 100
    # None locks itself: from outside and by the motor it takes less than all of the torque.
    for servo, laws in published().items():
        gear = gears([(servo, law) for law in laws], np.full(len(laws), 100.0))
        held = gear.bound(np.zeros(len(laws)), np.full(len(laws), 50.0), np.full(len(laws), -50.0))
        assert (held > 0).all()
        assert (held < 50.0).all()


@pytest.mark.parametrize("law", LAWS)
def test_a_joint_at_constant_speed_bears_the_law_in_mujoco(scene, law):
    """The first joint turns about the vertical, and bears no load: its motor bears dry friction
    beside what a plain one does."""
    gear = gears([("mx106", law)] * 3, np.full(3, 60.0))
    plain, none, speed = np.full(3, 0.5), np.zeros(3), 0.4
    u = np.zeros((150, 3))
    u[:, 0] = speed * np.arange(150) / RATE

    def torque(share):
        beyond = Beyond(gear, plain, np.array([share, 0.0, 0.0]), np.zeros((3, 5, 3)), none, none)
        values = {**scene.servos.values, "coulomb": plain}
        servos = Servos(values, 1e-6, RATE, beyond=beyond)
        return moved(scene.plan.plant, servos, [u])[0].torque[-50:].mean(0)

    # The torque in a row is that of a command that has just come, half a step ahead of the mean.
    motor = torque(1.0)
    ahead = 0.45 * scene.of("kp") * speed / RATE
    dry = gear.bound(np.array([speed, 0.0, 0.0]), motor - ahead, none)[0]
    assert motor[0] - torque(0.0)[0] == pytest.approx(dry - 0.5, rel=0.02, abs=0.01)


def test_without_a_share_and_cables_servos_are_plain(scene):
    gear = gears([("xl330", "m6")] * 3, np.full(3, 60.0))
    none = np.zeros(3)
    plain = scene.servos.of("coulomb", 3)
    beyond = Beyond(gear, plain, none, np.ones((3, 5, 3)), none, none)
    (there,) = moved(scene.plan.plant, replace(scene.servos, beyond=beyond), scene.commands)
    np.testing.assert_allclose(there.q, scene.base[0].q, atol=1e-9)


def test_commands_come_late_by_at_most_the_jitter():
    u = np.arange(200.0)[:, None]
    exact, _ = set_points(Servos(rate_hz=RATE), u, 10, np.random.default_rng(0))
    x, _ = set_points(
        Servos({"jitter": np.array([0.4])}, rate_hz=RATE), u, 10, np.random.default_rng(0)
    )
    late = (exact - x).reshape(200, 10)
    assert set(np.unique(late)) == {0.0, 1.0}
    assert 1 < late.sum(1)[1:].mean() < 3
    assert late.sum(1).max() == 4


@pytest.mark.parametrize("name", ["saturation", "command_delay", "end_stop", "torque_offset"])
def test_an_effect_is_drawn_at_the_standard_size(scene, name):
    effect = EffectSpec(name, (1,), {"variant": 0.7})
    scale, rms = standard_effect(scene, effect, STANDARD)
    assert 0.6 * STANDARD < rms.max() < 1.6 * STANDARD
    assert rms.argmax() == 1
    assert scale > 0


@pytest.fixture(scope="module")
def around():
    """A 3R of a case without effects."""
    return surroundings(draw_case(5, 1, mix="position_background", arm="3r", background=0.15))


def test_plain_servos_leave_what_is_asked_for_on_every_joint(around):
    assert around.left == pytest.approx(0.15 * STANDARD, rel=0.25)
    assert around.plan.servos.beyond.share.max() <= 1
    masses = zip(around.plan.plant.links, around.scene.plan.plant.links, strict=True)
    off = np.array([abs(a.body.mass / b.body.mass - 1) for a, b in masses])
    assert ((off > 0.029) & (off < 0.101)).all()


@pytest.mark.slow
@pytest.mark.parametrize("effects", [["payload"], ["torque_offset", "dead_zone"], ["cogging"]])
def test_the_background_is_the_same_whatever_is_planted(around, effects):
    spec = draw_case(5, 1, mix="position_background", arm="3r", background=0.15, effects=effects)
    case = simulate_case(spec)
    assert case.key["left"] == around.left.tolist()
    assert {name: case.key["background"][name] for name in around.key} == around.key
    assert [one["name"] for one in case.key["effects"]] == effects
    for one in case.key["effects"]:
        assert one["size"] > 1
    logs = (case.columns, *case.more)
    assert [len(x["t"]) for x in logs] == [len(u) for u in around.scene.commands]
    np.testing.assert_array_equal(logs[0]["u2"], around.scene.commands[0][:, 1])
    # Where it is felt the arm moves otherwise than without it.
    joint = case.key["effects"][0]["felt_by"][0]
    apart = logs[0][f"q{joint}"] - around.moved[0].logged[:, joint - 1]
    assert np.abs(apart).max() > 5e-3


def test_a_set_has_its_kinds():
    specs = [draw_case(3, k, mix="position_background", background=0.3) for k in range(24)]
    assert Counter(s.kind for s in specs) == {"single": 12, "none": 4, "several": 4, "outside": 4}
    assert {s.background for s in specs} == {0.3}
    assert all(len(s.effects) == 2 for s in specs if s.kind == "several")
    assert all(e.name in SERVO_KINDS for s in specs for e in s.effects)


def test_what_is_decidable_shows_over_counts_and_background():
    sizes = [(5.0, 3.0), (1.5, 3.0), (5.0, 0.5)]
    keys = [{"id": "a", "effects": [{"size": s, "over_background": b} for s, b in sizes]}]
    known = servo_classes(keys)["a"]
    assert [c["in_practice"]["class"] == "decidable" for c in known] == [True, False, False]
    assert [c["ideally"]["class"] == "decidable" for c in known] == [True, False, True]
