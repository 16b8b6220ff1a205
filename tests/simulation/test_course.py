"""Straight-line steps against steps on tensors, over some hundred of them."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from tests.arms import arm
from tests.marks import quick_first
from tests.simulation.bodies import bare, effect
from tests.trees import random_tree
from torchid.effects.base import JointEffect, ModelEffect
from torchid.effects.registry import KINDS, Valued
from torchid.robot.model import Robot
from torchid.simulation import course as module
from torchid.simulation.closed_loop import plant_of
from torchid.simulation.course import MOST_ALONE, Course, course
from torchid.simulation.integrate import Drive, Plant
from torchid.simulation.loads import adds_torque

STEPS, H = 150, 2e-3
ROBOTS = {
    "3r": lambda: bare("3r"),
    "mixed": lambda: bare("mixed"),
    "kuka_lwr4": lambda: bare("kuka_lwr4"),
    "tree": lambda: random_tree([-1, 0, 1, 0, 3], "RRPRR", 5, {4: 3}),
}


def _friction(robot: Robot, share: float = 1.0) -> list[Valued]:
    """Dry friction that holds the weaker joints at times, on all of them."""
    return [
        e
        for j in range(1, robot.n + 1)
        for e in (
            effect(robot, "coulomb_friction", joint=j, Fc=share * 1.5),
            effect(robot, "viscous_friction", joint=j, Fv=0.4),
        )
    ]


def _steps(plant: Plant, arms: int, seed: int, on_tensors: bool, push: float = 3.0) -> Course:
    """A PD about a wandering feed, within limits that bind."""
    draw = torch.Generator().manual_seed(seed)
    n = plant.robots[0].n

    def normal(*shape: int) -> Tensor:
        return torch.randn(shape, generator=draw, dtype=torch.float64)

    q, dq = 0.3 * normal(arms, n), torch.zeros(arms, n, dtype=torch.float64)
    state = plant.start(q, dq, dq.clone(), torch.zeros(arms, dtype=torch.float64))
    gains = torch.ones(arms, n, dtype=torch.float64)
    limit = torch.full((n,), 25.0, dtype=torch.float64)
    feeds = push * normal(STEPS, arms, n).cumsum(0)
    given = (
        plant,
        state,
        Drive(gains, 2 * gains, limit, 20 * gains),
        feeds,
        torch.full((arms,), 0.1).double(),
    )
    if not on_tensors:
        return course(*given, H, keep="instants")
    task = module._Task(*given, H, False, 1, 0)
    return module._on_tensors(task)


def _apart(a: Course, b: Course) -> float:
    """Of signals, to the largest of each; infinite where arms are not alike alive."""
    assert torch.equal(a.alive, b.alive)
    size = b.signals.abs().amax((1, 2, 3), keepdim=True).clamp(min=1.0)
    return float(((a.signals - b.signals) / size).abs().max())


@pytest.fixture
def without_tensors(monkeypatch: pytest.MonkeyPatch) -> None:
    """No way back to tensors, so that it is code that is compared."""

    def refuse(task: object) -> Course:
        raise AssertionError("steps on tensors")

    monkeypatch.setattr(module, "_on_tensors", refuse)


@pytest.mark.parametrize("name", list(ROBOTS))
def test_an_arm_moves_as_on_tensors(name: str, request: pytest.FixtureRequest) -> None:
    robot = ROBOTS[name]()
    plant = plant_of(robot, [_friction(robot, 4.0)], torch.zeros(1, robot.n, dtype=torch.float64))
    wanted = _steps(plant, 1, 3, on_tensors=True)
    request.getfixturevalue("without_tensors")
    assert _apart(_steps(plant, 1, 3, on_tensors=False), wanted) < 1e-9
    # The test is one of joints that stick, and of drives at their limits.
    assert bool((wanted.signals[1][1:] == 0).any())
    assert bool((wanted.signals[3].abs() == 25.0).any())


def test_arms_that_are_alike_move_together_as_on_tensors(request: pytest.FixtureRequest) -> None:
    robot, arms = bare("mixed"), MOST_ALONE + 4
    plant = plant_of(robot, [_friction(robot)], torch.zeros(1, robot.n, dtype=torch.float64))
    wanted = _steps(plant, arms, 4, on_tensors=True)
    request.getfixturevalue("without_tensors")
    assert _apart(_steps(plant, arms, 4, on_tensors=False), wanted) < 1e-9


def test_arms_with_other_bodies_and_effects_move_as_on_tensors(
    request: pytest.FixtureRequest,
) -> None:
    robot = bare("3r")
    inertia = {"Jxx": 0.02, "Jxy": 0.0, "Jxz": 0.0, "Jyy": 0.02, "Jyz": 0.0, "Jzz": 0.02}
    payload = effect(robot, "payload", m=1.0, mx=0.1, my=0.0, mz=0.05, **inertia)
    lists = [_friction(robot), [payload], [*_friction(robot, 0.5), payload]]
    plant = plant_of(robot, lists, torch.zeros(3, robot.n, dtype=torch.float64))
    wanted = _steps(plant, 3, 5, on_tensors=True)
    request.getfixturevalue("without_tensors")
    assert _apart(_steps(plant, 3, 5, on_tensors=False), wanted) < 1e-9


@pytest.mark.parametrize("name", quick_first(KINDS, 4))
def test_every_effect_has_a_straight_form(name: str, request: pytest.FixtureRequest) -> None:
    robot, kind = replace(arm("3r"), effects=()), KINDS[name]
    if issubclass(kind, JointEffect):
        one = kind.exemplar(1)
    else:
        assert issubclass(kind, ModelEffect)
        one = next(iter(kind.candidates(robot)))
    if not adds_torque(one):
        pytest.skip("changes the bodies or the sensors, not the step")
    plant = plant_of(
        robot,
        [[(one, list(kind.example.values)), *_friction(robot, 0.2)]],
        torch.zeros(1, 3).double(),
    )
    wanted = _steps(plant, 1, 6, on_tensors=True)
    request.getfixturevalue("without_tensors")
    assert _apart(_steps(plant, 1, 6, on_tensors=False), wanted) < 1e-9


@pytest.mark.parametrize("arms", [1, MOST_ALONE + 2])
def test_an_arm_that_diverges_stops_and_no_other(arms: int) -> None:
    robot = bare("3r")
    plant = plant_of(robot, [_friction(robot)], torch.zeros(1, 3, dtype=torch.float64))
    zero = torch.zeros(arms, 3, dtype=torch.float64)
    feeds = torch.zeros(STEPS, arms, 3, dtype=torch.float64)
    feeds[20:, 0] = 1e6
    state = plant.start(zero, zero, zero, zero[:, 0])
    given = plant, state, Drive(zero), feeds, zero[:, 0]
    run = course(*given, H, keep="states")
    wanted = module._on_tensors(module._Task(*given, H, True, 1, 0))
    assert torch.equal(run.alive, wanted.alive)
    assert not bool(run.alive[-1, 0])
    assert bool(run.alive[:, 1:].all())
    alive = wanted.alive[None, :, :, None]
    assert float(((run.signals - wanted.signals) * alive).nan_to_num().abs().max()) < 1e-7


def test_what_differs_from_the_step_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """An effect that reads values behind the recorder's back goes the way of tensors."""
    robot = bare("3r")
    kind = KINDS["viscous_friction"]
    plain = kind.formula

    def formula(motion, *shapes):  # type: ignore[no-untyped-def]
        return plain(motion, *shapes) * (1.0 + max(motion.dq.flatten().tolist()))

    monkeypatch.setattr(kind, "formula", formula)
    plant = plant_of(robot, [_friction(robot)], torch.zeros(1, 3, dtype=torch.float64))
    taken = []
    real = module._on_tensors
    monkeypatch.setattr(module, "_on_tensors", lambda task: taken.append(1) or real(task))
    _steps(plant, 1, 3, on_tensors=False)
    assert taken
