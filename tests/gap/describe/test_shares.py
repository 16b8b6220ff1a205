"""Shares of causes: Shapley's value by its definition, over all orders; they add up."""

import itertools
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from torchid.gap.describe.shares import Shares, shares_of

N, JOINTS = 40, 3


def explained(torques: Tensor, left: Tensor, fixed: int, first: bool = False) -> Any:
    """An explanation whose parts have one column and coefficient each, what is always fitted
    first."""
    keep = torch.ones(JOINTS, N, dtype=torch.bool)
    keep[:, -5:] = False  # samples that do not count
    parts = tuple(SimpleNamespace(instead=None) for _ in torques)
    solution = SimpleNamespace(parts=parts, torque=lambda k: torques[k])
    problem = SimpleNamespace(
        data=SimpleNamespace(keep=keep),
        given=SimpleNamespace(gap=torques.sum(0) + left),
        fitted_first=first,
    )
    return SimpleNamespace(problem=problem, solution=solution, fixed=fixed)


def by_definition(players: list[Tensor], gap: Tensor) -> Tensor:
    """Mean over all orders of by how much each player lowers the sum of squares; (K, n)."""
    out = torch.zeros(len(players), JOINTS, dtype=torch.float64)
    orders = list(itertools.permutations(range(len(players))))
    for order in orders:
        left = gap.clone()
        for k in order:
            joined = left - players[k]
            out[k] += (left.square() - joined.square()).sum(1)
            left = joined
    return out / len(orders)


@settings(max_examples=25)
@given(st.integers(0, 10_000), st.integers(1, 4), st.integers(0, 2), st.booleans())
def test_shares_are_means_over_all_orders(seed: int, causes: int, fixed: int, first: bool):
    g = torch.Generator().manual_seed(seed)
    torques = torch.randn(fixed + causes, JOINTS, N, generator=g, dtype=torch.float64)
    left = torch.randn(JOINTS, N, generator=g, dtype=torch.float64)
    found = explained(torques, left, fixed, first)
    taken = shares_of(found)

    keep = found.problem.data.keep
    torques, gap = torques * keep, found.problem.given.gap * keep
    refit, players = torques[:fixed].sum(0), list(torques[fixed:])
    if first:
        gap, refit = gap - refit, torch.zeros_like(refit)
    right = by_definition([*players, refit], gap)
    torch.testing.assert_close(taken.falls, right[:-1])
    torch.testing.assert_close(taken.refit, right[-1])
    # By themselves, beside what is always fitted.
    alone = [((gap - refit).square() - (gap - refit - x).square()).sum(1) for x in players]
    torch.testing.assert_close(taken.alone, torch.stack(alone))
    # All parts together are the fall of the error.
    rest = gap - torch.stack(players).sum(0) - refit
    torch.testing.assert_close(taken.whole, (gap.square() - rest.square()).sum(1))


def test_shares_of_a_joint_add_up_to_its_bar():
    falls = torch.tensor([[3.0, 0.0], [-1.0, 0.0]], dtype=torch.float64)
    taken = Shares(falls, falls, torch.tensor([2.0, 0.0], dtype=torch.float64))
    before, after = (torch.tensor(x, dtype=torch.float64) for x in ([5.0, 2.0], [3.0, 2.0]))
    removes = taken.of_bars(before, after)
    # Of two units that the first joint's error falls by: three quarters, minus one, and the refit.
    assert removes[:, 0].tolist() == pytest.approx([1.5, -0.5])
    assert removes[:, 1].tolist() == [0.0, 0.0]
    shares, alone = taken.of_all(closed=0.4)
    assert shares == pytest.approx([0.3, -0.1])
    assert alone == pytest.approx([0.3, -0.1])


def test_an_explanation_without_causes_has_no_shares():
    left = torch.ones(JOINTS, N, dtype=torch.float64)
    taken = shares_of(explained(torch.zeros(0, JOINTS, N).double(), left, 0))
    assert taken.falls.shape == (0, JOINTS)
    assert taken.of_all(0.5) == ([], [])
