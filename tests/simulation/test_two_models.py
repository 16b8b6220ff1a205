"""The true motion is a formula, the measured torque its exact torque: a true model stays on it."""

import json
import math
from dataclasses import replace
from types import MappingProxyType

import pytest
import torch

from tests.arms import arm
from torchid.design.segments import Segment
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Motion
from torchid.effects.registry import model_torque, nominal_effects
from torchid.results.record import as_plain
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import JointType, Robot
from torchid.simulation.shooting import starts_of
from torchid.simulation.two_models import CONTROLLER, DIVERGED, SHOWN_S
from torchid.simulation.two_models import rollouts as simulated

RATE, BAND = 250.0, 40.0
FIELDS = {"rms_before", "rms_after", "joint_ratio", "joint_ratio_ci95", "ratio", "ratio_ci95"}


def rollouts(*arguments, **settings):  # type: ignore[no-untyped-def]
    """As the JSON has them."""
    return as_plain(simulated(*arguments, **settings)[0])


def motion(n: int, seconds: float, seed: int = 0) -> Motion:
    """Three sines a joint, below 1 Hz, with their derivatives."""
    g = torch.Generator().manual_seed(seed)
    t = torch.arange(round(seconds * RATE), dtype=torch.float64) / RATE
    frequency = 2 * math.pi * (0.1 + 0.5 * torch.rand(3, n, generator=g, dtype=torch.float64))
    size = 0.2 + 0.3 * torch.rand(3, n, generator=g, dtype=torch.float64)
    angle = t[:, None, None] * frequency + 6 * torch.rand(3, n, generator=g, dtype=torch.float64)
    q = (size * angle.sin()).sum(1)
    dq = (size * frequency * angle.cos()).sum(1)
    ddq = -(size * frequency.square() * angle.sin()).sum(1)
    return Motion(q, dq, ddq, torch.sign(dq), t)


def segment(robot: Robot, seconds: float = 20.0, seed: int = 0) -> Segment:
    moved = motion(robot.n, seconds, seed)
    return Segment(
        name=f"p{seed}",
        rate=RATE,
        band=BAND,
        motion=moved,
        tau=model_torque(robot, nominal_effects(robot), moved),
        own_velocity=False,
    )


def with_effects(robot: Robot, name: str, values: dict[int, dict[str, float]]) -> Robot:
    records = [{"effect": name, "joint": j, **v} for j, v in values.items()]
    return replace(robot, effects=tuple(MappingProxyType(r) for r in records))


def slider(mass: float) -> Robot:
    """One mass on a horizontal rail."""
    eye = torch.eye(4, dtype=torch.float64)
    pi = torch.tensor([[mass, 0, 0, 0, 0.1, 0, 0, 0.1, 0, 0.1]], dtype=torch.float64)
    return Robot(
        name="slider",
        joint_names=("x",),
        link_names=("mass",),
        joint_types=(JointType.PRISMATIC,),
        before=eye[None],
        after=eye[None],
        gravity=torch.zeros(3, dtype=torch.float64),
        tool=eye,
        parameters=InertialParameters(pi),
    )


def test_error_of_a_wrong_mass_is_that_of_the_closed_form() -> None:
    """Under a constant force F the models part by F (1/m - 1/m') h^2 / 2."""
    force, mass, wrong = 3.0, 2.0, 2.5
    t = torch.arange(round(10 * RATE), dtype=torch.float64)[:, None] / RATE
    acceleration = torch.full_like(t, force / mass)
    moved = Motion(t.square() * force / mass / 2, t * force / mass, acceleration, None, t[:, 0])
    run = Segment("p", RATE, BAND, moved, torch.full_like(t, force), False)
    result = rollouts(slider(wrong), slider(mass), [run], horizons=(0.1, 0.5, 1.0))
    for row in result["horizons"]:
        expected = force * (1 / mass - 1 / wrong) * row["horizon_s"] ** 2 / 2
        assert row["rms_before"][0] == pytest.approx(expected, rel=1e-6)
        assert row["rms_after"][0] < 1e-6 * expected


@pytest.fixture(scope="module")
def coulomb() -> tuple[Robot, Robot, Segment]:
    """Without and with Coulomb friction, and a segment of the arm that has it."""
    before = arm("3r")
    after = with_effects(before, "coulomb_friction", {2: {"Fc": 0.2}, 3: {"Fc": 0.1}})
    return before, after, segment(after, 30.0)


@pytest.mark.nightly
def test_a_planted_effect_makes_rollouts_better(coulomb: tuple[Robot, Robot, Segment]) -> None:
    before, after, run = coulomb
    result = rollouts(before, after, [run], max_starts=40)
    assert result["torque"]["ratio"] < 1e-9
    for row in result["horizons"]:
        # In two seconds the friction left out saturates: the ratio is then of lost arms.
        most = 0.1 if row["horizon_s"] < 1 else 0.6
        low, high = row["ratio_ci95"]
        assert low <= row["ratio"] <= high < most
        assert row["rms_after"][2] < most * row["rms_before"][2]
        assert row["diverged_after"] <= row["diverged_before"]
    assert result["sentences"] == []
    errors = [row["rms_before"][2] for row in result["horizons"]]
    assert errors == sorted(errors)


def test_equal_models_have_the_ratio_one(coulomb: tuple[Robot, Robot, Segment]) -> None:
    _, after, run = coulomb
    other = with_effects(after, "viscous_friction", {1: {"Fv": 1.0}})
    for row in rollouts(other, other, [run], max_starts=20, horizons=(0.1, 0.5))["horizons"]:
        assert row["ratio"] == 1
        assert row["ratio_ci95"] == [1, 1]
        assert row["joint_ratio"] == [1, 1, 1]
        assert row["rms_before"] == row["rms_after"]


def test_the_result_is_json_and_a_function_of_the_seed(
    coulomb: tuple[Robot, Robot, Segment],
) -> None:
    one, same, other = (
        json.dumps(rollouts(*coulomb[:2], [coulomb[2]], (0.1,), seed, 10), allow_nan=False)
        for seed in (0, 0, 1)
    )
    assert one == same != other


@pytest.mark.nightly
@pytest.mark.parametrize("scale", [0.02, -1.0, float("inf")])
def test_divergence_is_counted_and_nothing_is_raised(
    coulomb: tuple[Robot, Robot, Segment], scale: float
) -> None:
    """A model far too light, one whose mass matrix is negative, one without numbers."""
    _, after, run = coulomb
    parameters = after.require_parameters("the test").pi
    wrong = after.with_parameters(InertialParameters(parameters * scale))
    result = rollouts(wrong, after, [run], (0.1, 0.7), max_starts=10)
    row = result["horizons"][-1]
    assert row["diverged_before"] > 0.9
    assert row["diverged_after"] < 0.2
    assert max(row["rms_before"]) <= DIVERGED
    assert row["ratio"] < 0.5
    json.dumps(result, allow_nan=False)
    backwards = rollouts(after, wrong, [run], (0.1, 0.7), max_starts=10)
    assert any("lose the arm" in sentence for sentence in backwards["sentences"])


def test_torque_and_rollout_that_disagree_are_named() -> None:
    """A correction that mends a heavy joint's torque and spoils a light one's."""
    true = arm("kuka_lwr4")
    heavy = with_effects(true, "torque_offset", {1: {"F0": 4.0}})
    light = with_effects(true, "torque_offset", {7: {"F0": 0.4}})
    result = rollouts(heavy, light, [segment(true)], (0.1,), max_starts=30)
    assert result["torque"]["ratio"] == pytest.approx(0.1)
    assert result["horizons"][0]["ratio"] > 1
    assert any("disagree" in sentence for sentence in result["sentences"])


def test_starts_are_spread_and_leave_the_edges_out() -> None:
    robot = arm("3r")
    runs = [segment(robot, seconds, seed) for seed, seconds in enumerate((12.0, 0.2, 4.0))]
    starts = starts_of(runs, 0.5, 60, seed=3)
    edge = 4 * RATE / BAND
    assert set(starts.passage.tolist()) == {0, 2}
    for k, run in enumerate(runs):
        first = starts.first[starts.passage == k].sort().values
        if len(first):
            assert first[0] >= edge
            assert (first + 0.5 * RATE + edge <= run.length).all()
            assert first.diff().max() < 2.1 * (16 * RATE / 60)
    assert (starts.length >= 0.5 * RATE - 1).all()


def test_horizons_that_do_not_fit_are_said() -> None:
    robot = arm("3r")
    result = rollouts(robot, robot, [segment(robot, 1.5)], max_starts=8)
    fits = {row["horizon_s"]: row["starts"] for row in result["horizons"]}
    assert fits[0.1] == 8
    assert fits[2.0] == 0
    last = result["horizons"][-1]
    assert all(last[name] is None for name in FIELDS)
    assert any("2 s" in sentence for sentence in result["sentences"])
    none = rollouts(robot, robot, [segment(robot, 0.2)])
    assert (none["starts"], none["horizons"]) == (0, [])
    assert none["sentences"]


def test_joints_of_both_kinds_go_into_one_ratio() -> None:
    true = arm("mixed")
    before = with_effects(true, "torque_offset", {6: {"F0": 1.0}})
    after = with_effects(true, "torque_offset", {6: {"F0": 0.5}})
    run = segment(true)
    assert torch.allclose(run.tau, inverse_dynamics(true, *run.motion.state))
    row = rollouts(before, after, [run], (0.1,), max_starts=20)["horizons"][0]
    # In a short time errors are proportional to the torque that is wrong.
    assert row["joint_ratio"] == pytest.approx([0.5] * 6, rel=0.1)
    assert min(row["joint_ratio"]) <= row["ratio"] <= max(row["joint_ratio"])


def test_effects_in_the_sensors_are_undone_or_named() -> None:
    true = arm("3r")
    gain = with_effects(true, "torque_gain", {2: {"gain": 0.1}})
    result = rollouts(true, gain, [segment(gain, 6.0)], (0.1,), max_starts=8)
    assert result["horizons"][0]["ratio"] < 0.05
    assert result["ignored_effects"] == []
    late = with_effects(true, "time_delay", {2: {"delay": 5e-3}})
    result = rollouts(true, late, [segment(late, 6.0)], (0.1,), max_starts=8)
    assert result["ignored_effects"] == ["time_delay"]
    assert any("without time delay" in sentence for sentence in result["sentences"])


def test_motion_that_is_shown_is_held_to_the_arm_and_errs_by_what_the_controller_makes_up() -> None:
    """A true model stays on the arm; a constant torque that is missing moves its joint by as much
    as makes the controller's springs hold it."""
    true = arm("3r")
    heavy = with_effects(true, "torque_offset", {1: {"F0": 2.0}})
    run = segment(true)
    (shown,) = simulated(heavy, true, [run], (0.1,), max_starts=5)[1]
    assert len(shown.t) == round(SHOWN_S * RATE) + 1
    assert bool(shown.t.diff().gt(0).all())
    assert torch.allclose(shown.after, shown.measured, atol=1e-3)
    stiffness, _ = CONTROLLER.gains(true, shown.measured)
    off = (shown.before - shown.measured)[:, 0]
    assert float(off[0]) == pytest.approx(0.0, abs=1e-12)
    # After some periods of the controller.
    assert float(off[200:].mean()) == pytest.approx(-2.0 / float(stiffness[0]), rel=0.2)


def test_a_short_motion_is_shown_whole() -> None:
    true = arm("3r")
    short = segment(true, 2.0)
    (shown,) = simulated(true, true, [short], (0.1,), max_starts=5)[1]
    assert len(shown.t) < short.length
    assert bool(shown.before.isfinite().all())
