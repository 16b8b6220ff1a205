"""Bodies that are a little wrong are in the standard deviations of what they look like."""

import pytest
import torch

from tests.gap.motions import ROBOT
from tests.gap.problems import explanation_of, measured, search_of, term
from torchid.effects.base import Effect
from torchid.effects.friction import TorqueOffset
from torchid.effects.spring import JointSpring
from torchid.gap.describe.discrepancy import body_errors
from torchid.gap.describe.model import Solution
from torchid.gap.problem import Problem
from torchid.robot.inertia import InertialParameters


def solution_of(effect: Effect, values: list[float], error: float, seed: int) -> Solution:
    """Of an effect on an arm whose links are heavier or lighter than the model's by a share."""
    g = torch.Generator().manual_seed(seed)
    masses = 1 + error * torch.randn(ROBOT.n_links, 1, generator=g, dtype=torch.float64)
    pi = ROBOT.require_parameters("a test").pi * masses
    real = ROBOT.with_parameters(InertialParameters(pi))
    search = search_of(measured([(effect, values)], real=real, noise=0.02), (effect.name,))
    return explanation_of(search, [term(search, effect)]).solution


@pytest.mark.parametrize(
    ("effect", "values"),
    [(TorqueOffset(1), [1.0]), (JointSpring(1, 0.0), [1.0, 2.0])],
    ids=["offset", "spring"],
)
def test_standard_deviations_hold_the_truth_beside_masses_that_are_a_little_off(effect, values):
    """By .4 %: what blocks differ by is a quarter of it."""
    every = [solution_of(effect, values, 0.004, seed) for seed in range(8)]
    truth = torch.tensor(values, dtype=torch.float64)
    off = torch.stack([(s.values[0] - truth) / s.std[0] for s in every])
    rms = off.square().mean(0).sqrt()
    assert float(rms.max()) < 1.7
    assert float(rms.min()) > 0.2


def test_they_grow_with_what_the_bodies_leave(monkeypatch):
    """And values are as they were: errors of bodies explain nothing."""
    right, wrong = (solution_of(TorqueOffset(1), [1.0], error, 0) for error in (0.0, 0.04))
    assert float(wrong.std[0]) > 5 * float(right.std[0])
    monkeypatch.setattr(Problem, "as_cad", False)
    alone = solution_of(TorqueOffset(1), [1.0], 0.04, 0)
    assert float(wrong.std[0]) > 3 * float(alone.std[0])
    assert torch.equal(wrong.values[0], alone.values[0])


def test_a_link_whose_error_is_a_cause_has_no_other_one():
    search = search_of(measured([]), ("torque_offset",))
    columns = search.library.problem.given
    assert len(body_errors(columns, {0, 2})) == 10
    assert len(body_errors(columns, set(range(ROBOT.n_links)))) == 0
