"""The true motion is a formula, the measured torque its exact torque: a true model stays on it."""

import math
from dataclasses import replace
from types import MappingProxyType

import pytest
import torch

from tests.arms import arm
from torchid.design.segments import Segment
from torchid.effects.base import Motion
from torchid.effects.registry import model_torque, nominal_effects
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import JointType, Robot
from torchid.simulation.shooting import starts_of, windows_of
from torchid.simulation.two_models import DIVERGED, errors_after, simulated
from torchid.typing import Tensor

RATE, BAND = 250.0, 40.0


def errors(
    models: list[Robot], runs: list[Segment], horizons: tuple[float, ...], starts: int
) -> list[tuple[int, list[Tensor | None]]]:
    """Of each horizon, from so many starts."""
    windows = windows_of(runs, starts_of(runs, min(horizons), starts, 0), max(horizons))
    positions = [simulated(robot, windows) for robot in models]
    return [errors_after(horizon, positions, windows) for horizon in horizons]


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
    horizons = (0.1, 0.5, 1.0)
    found = errors([slider(wrong), slider(mass)], [run], horizons, 128)
    for horizon, (_, (before, after)) in zip(horizons, found, strict=True):
        expected = force * (1 / mass - 1 / wrong) * horizon**2 / 2
        assert float(before) == pytest.approx(expected, rel=1e-6)
        assert float(after) < 1e-6 * expected


@pytest.fixture(scope="module")
def coulomb() -> tuple[Robot, Robot, Segment]:
    """Without and with Coulomb friction, and a segment of the arm that has it."""
    before = arm("3r")
    after = with_effects(before, "coulomb_friction", {2: {"Fc": 0.2}, 3: {"Fc": 0.1}})
    return before, after, segment(after, 30.0)


@pytest.mark.slow
def test_a_planted_effect_makes_a_better_simulator(coulomb: tuple[Robot, Robot, Segment]) -> None:
    *models, run = coulomb
    found = errors(models, [run], (0.1, 0.5, 2.0), 40)
    # In two seconds the friction left out saturates: the ratio is then of lost arms.
    for (count, (before, after)), most in zip(found, (0.1, 0.1, 0.6), strict=True):
        assert count > 20
        assert float(after.norm()) < most * float(before.norm())
    lost = [float(before[2]) for _, (before, _) in found]
    assert lost == sorted(lost)


@pytest.mark.slow
@pytest.mark.parametrize("scale", [0.02, -1.0, float("inf")])
def test_a_model_that_loses_the_arm_raises_nothing(
    coulomb: tuple[Robot, Robot, Segment], scale: float
) -> None:
    """A model far too light, one whose mass matrix is negative, one without numbers."""
    _, after, run = coulomb
    parameters = after.require_parameters("the test").pi
    wrong = after.with_parameters(InertialParameters(parameters * scale))
    _, (count, (lost, kept)) = errors([wrong, after], [run], (0.1, 0.7), 10)
    assert count > 0
    assert float(lost.max()) <= DIVERGED
    assert float(kept.norm()) < 0.5 * float(lost.norm())


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


def test_a_horizon_that_no_window_has_and_a_model_without_positions() -> None:
    run = [segment(arm("3r"), 1.5)]
    windows = windows_of(run, starts_of(run, 0.1, 8, 0), 2.0)
    positions = [windows.q, None]
    assert errors_after(2.0, positions, windows) == (0, [None, None])
    count, (own, none) = errors_after(0.1, positions, windows)
    assert (count, none) == (8, None)
    assert not bool(own.any())


def test_effects_in_the_sensors_are_undone() -> None:
    true = arm("3r")
    gain = with_effects(true, "torque_gain", {2: {"gain": 0.1}})
    ((_, (before, after)),) = errors([true, gain], [segment(gain, 6.0)], (0.1,), 8)
    assert float(after.norm()) < 0.05 * float(before.norm())
