"""Fits from normal equations are those of all rows stacked."""

import pytest
import torch

from torchid.design.bodies import Prior
from torchid.design.gram import Gram, Normal, Subset, inverse_root
from torchid.typing import Tensor

COMMON, OWN, ROWS = 3, (2, 4), 120
WEIGHT = torch.tensor([0.5, 4.0], dtype=torch.float64)


def random(*shape: int, seed: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


class Problem:
    """Columns, targets and rows that count, kept as they are."""

    def __init__(self) -> None:
        self.columns = [random(COMMON + k, ROWS, seed=j) for j, k in enumerate(OWN)]
        self.columns[1][-1] = 0.0  # the last column of joint 2 is nowhere
        self.y = random(2, ROWS, seed=7)
        self.keep = random(2, ROWS, seed=8) > -1
        self.gram = Gram(COMMON, len(OWN))
        for j, a in enumerate(self.columns):
            # In pieces, as effects come, and in two goes, as logs do.
            pieces = [a[:COMMON], a[COMMON : COMMON + 1], a[COMMON + 1 :]]
            for rows in (slice(0, 50), slice(50, ROWS)):
                some = [p[:, rows] for p in pieces]
                self.gram.add(j, some, self.y[j, rows], self.keep[j, rows])

    def stacked(self, subset: Subset, weight: Tensor) -> tuple[Tensor, Tensor]:
        """Rows (R, K) and target (R,) of all joints, by hand."""
        rows, targets = [], []
        for j, at in enumerate(subset.at):
            here = self.keep[j]
            every = torch.cat([self.columns[j], self.y[j : j + 1]])[:, here]
            rows.append(weight[j].sqrt() * (every[at] * (at >= 0).unsqueeze(1)).T)
            target = every[-1].clone()
            for joint, own, values in subset.instead:
                if joint == j:
                    target += values @ every[own]
            targets.append(weight[j].sqrt() * target)
        return torch.cat(rows), torch.cat(targets)


@pytest.fixture(scope="module")
def problem() -> Problem:
    return Problem()


def subset(replaced: float = 0.0) -> Subset:
    """Two common columns, one of joint 1, two of joint 2; `replaced`: so much of joint 2's second
    own column is a part of the target."""
    at = torch.tensor([[0, 2, 4, -1, -1], [0, 2, -1, 3, 5]])
    return Subset(at, ((1, torch.tensor([COMMON + 1]), torch.tensor([replaced]).double()),))


@pytest.mark.parametrize("replaced", [0.0, 2.5])
def test_a_fit_is_that_of_all_rows(problem: Problem, replaced: float) -> None:
    chosen = subset(replaced)
    normal = problem.gram.normal
    a, y = problem.stacked(chosen, WEIGHT)
    expected = torch.linalg.lstsq(a, y).solution
    solved = normal.of(chosen).solve(WEIGHT)
    assert torch.allclose(solved.x, expected, atol=1e-9)
    inverse = torch.linalg.inv(a.T @ a)
    assert torch.allclose(solved.root @ solved.root.T, inverse, atol=1e-9)
    losses = normal.of(chosen).losses(solved.x)
    assert float(WEIGHT @ losses) == pytest.approx(float((y - a @ expected).square().sum()))
    matrix, right = normal.of(chosen).weighted(WEIGHT)
    assert torch.allclose(matrix, a.T @ a)
    assert torch.allclose(right, a.T @ y)


def test_losses_are_those_of_each_joint_whatever_the_coefficients(problem: Problem) -> None:
    chosen, x = subset(1.5), random(5, seed=11)
    found = problem.gram.normal.of(chosen).losses(x)
    for j in range(2):
        alone = torch.zeros(2, dtype=torch.float64)
        alone[j] = 1.0
        a, y = problem.stacked(chosen, alone)
        assert float(found[j]) == pytest.approx(float((y - a @ x).square().sum()))


def test_rows_are_those_that_count(problem: Problem) -> None:
    assert problem.gram.normal.rows.tolist() == problem.keep.sum(1).tolist()
    assert problem.gram.n == 2


def test_a_ridge_is_a_row_more_for_every_coefficient(problem: Problem) -> None:
    ridge = torch.tensor([3.0, 0.0, 50.0, 1e3, 2.0], dtype=torch.float64)
    chosen = subset()
    a, y = problem.stacked(chosen, WEIGHT)
    more = torch.cat([a, ridge.sqrt().diag()]), torch.cat([y, torch.zeros(5, dtype=torch.float64)])
    expected = torch.linalg.lstsq(*more).solution
    found = Prior(ridge).solve_of(problem.gram.normal.of(chosen), WEIGHT).x
    assert torch.allclose(found, expected, atol=1e-9)


def zeros_too() -> Subset:
    """With joint 2's column of zeros as a sixth."""
    return Subset(torch.cat([subset().at, torch.tensor([[-1], [6]])], 1))


def test_a_column_of_zeros_has_no_coefficient_and_changes_no_other(problem: Problem) -> None:
    normal = problem.gram.normal
    found = normal.of(zeros_too()).solve(WEIGHT)
    assert float(found.x[5]) == 0.0
    assert float(found.root[5].abs().max()) == 0.0
    assert torch.allclose(found.x[:5], normal.of(subset()).solve(WEIGHT).x, atol=1e-9)


def test_of_equal_columns_nothing_is_told_apart(problem: Problem) -> None:
    """They share what either would have, and nothing becomes large."""
    a = problem.columns[0][:1]
    gram = Gram(0, 1)
    gram.add(0, [a, a], problem.y[0], problem.keep[0])
    found = gram.normal.of(Subset(torch.tensor([[0, 1]]))).solve(WEIGHT[:1]).x
    alone = gram.normal.of(Subset(torch.tensor([[0]]))).solve(WEIGHT[:1]).x
    assert torch.allclose(found, 0.5 * alone.expand(2), rtol=1e-6)


def test_no_columns_leave_all(problem: Problem) -> None:
    normal: Normal = problem.gram.normal
    nothing = Subset(torch.zeros(2, 0, dtype=torch.long))
    solved = normal.of(nothing).solve(WEIGHT)
    assert len(solved.x) == 0
    kept = (problem.y * problem.keep).square().sum(1)
    assert torch.allclose(normal.of(nothing).losses(solved.x), kept)


@pytest.mark.parametrize("close", [1e-1, 1e-3, 1e-5])
def test_a_root_is_that_of_eigenvectors_however_close_columns_are(close: float) -> None:
    """Of the closest two the difference is not determined: neither factor nor trace may say so."""
    a = random(3, 200, seed=12)
    a[2] = a[1] + close * a[2]
    matrix = a @ a.T
    size = matrix.diagonal().sqrt()
    values, vectors = torch.linalg.eigh(matrix / size / size.unsqueeze(1))
    kept = values > 1e-7 * values[-1]
    assert int(kept.sum()) == (2 if close < 1e-4 else 3)
    root = vectors[:, kept] / values[kept].sqrt() / size.unsqueeze(1)
    found = inverse_root(matrix)
    assert torch.allclose(found @ found.T, root @ root.T, rtol=1e-6)
