"""Fits from normal equations are those of all rows stacked."""

import pytest
import torch

from torchid.design.bodies import Prior, Priors
from torchid.design.gram import Gram, Normal, Subset, inverse_root
from torchid.typing import Tensor

COMMON, OWN, ROWS, PARTS = 3, (2, 4), 120, 3
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
        self.part = (random(ROWS, seed=9) > 0).long() + (random(ROWS, seed=10) > 1).long()
        self.gram = Gram(COMMON, len(OWN), PARTS)
        for j, a in enumerate(self.columns):
            # In pieces, as effects come, and in two goes, as logs do.
            pieces = [a[:COMMON], a[COMMON : COMMON + 1], a[COMMON + 1 :]]
            for rows in (slice(0, 50), slice(50, ROWS)):
                some = [p[:, rows] for p in pieces]
                keep, part = self.keep[j, rows], self.part[rows]
                self.gram.add(j, some, self.y[j, rows], keep, part)

    def stacked(
        self, subset: Subset, parts: tuple[int, ...], weight: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Rows (R, K) and target (R,) of all joints, by hand."""
        chosen = torch.isin(self.part, torch.tensor(parts))
        rows, targets = [], []
        for j, at in enumerate(subset.at):
            here = chosen & self.keep[j]
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


PARTED = [((0, 1, 2), None), ((0, 2), (0, 2)), ((1,), (1,))]


@pytest.mark.parametrize(("parts", "over"), PARTED)
@pytest.mark.parametrize("replaced", [0.0, 2.5])
def test_a_fit_is_that_of_all_rows(
    problem: Problem, parts: tuple[int, ...], over: tuple[int, ...] | None, replaced: float
) -> None:
    chosen = subset(replaced)
    normal = problem.gram.over(over)
    a, y = problem.stacked(chosen, parts, WEIGHT)
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
    found = problem.gram.over([0]).of(chosen).losses(x)
    for j in range(2):
        alone = torch.zeros(2, dtype=torch.float64)
        alone[j] = 1.0
        a, y = problem.stacked(chosen, (0,), alone)
        assert float(found[j]) == pytest.approx(float((y - a @ x).square().sum()))


def test_rows_are_those_that_count(problem: Problem) -> None:
    assert problem.gram.over().rows.tolist() == problem.keep.sum(1).tolist()
    one, rest = problem.gram.over([0]).rows, problem.gram.over([1, 2]).rows
    assert (one + rest).tolist() == problem.keep.sum(1).tolist()
    assert problem.gram.n == 2


def test_a_ridge_is_a_row_more_for_every_coefficient(problem: Problem) -> None:
    ridge = torch.tensor([3.0, 0.0, 50.0, 1e3, 2.0], dtype=torch.float64)
    chosen = subset()
    a, y = problem.stacked(chosen, (0, 1, 2), WEIGHT)
    more = torch.cat([a, ridge.sqrt().diag()]), torch.cat([y, torch.zeros(5, dtype=torch.float64)])
    expected = torch.linalg.lstsq(*more).solution
    found = Prior(ridge).solve_of(problem.gram.over().of(chosen), WEIGHT).x
    assert torch.allclose(found, expected, atol=1e-9)


def zeros_too() -> Subset:
    """With joint 2's column of zeros as a sixth."""
    return Subset(torch.cat([subset().at, torch.tensor([[-1], [6]])], 1))


def test_a_column_of_zeros_has_no_coefficient_and_changes_no_other(problem: Problem) -> None:
    normal = problem.gram.over()
    found = normal.of(zeros_too()).solve(WEIGHT)
    assert float(found.x[5]) == 0.0
    assert float(found.root[5].abs().max()) == 0.0
    assert torch.allclose(found.x[:5], normal.of(subset()).solve(WEIGHT).x, atol=1e-9)


def test_of_equal_columns_nothing_is_told_apart(problem: Problem) -> None:
    """They share what either would have, and nothing becomes large."""
    a = problem.columns[0][:1]
    gram = Gram(0, 1, 1)
    gram.add(0, [a, a], problem.y[0], problem.keep[0], torch.zeros(ROWS, dtype=torch.long))
    found = gram.over().of(Subset(torch.tensor([[0, 1]]))).solve(WEIGHT[:1]).x
    alone = gram.over().of(Subset(torch.tensor([[0]]))).solve(WEIGHT[:1]).x
    assert torch.allclose(found, 0.5 * alone.expand(2), rtol=1e-6)


def test_no_columns_leave_all(problem: Problem) -> None:
    normal: Normal = problem.gram.over()
    nothing = Subset(torch.zeros(2, 0, dtype=torch.long))
    solved = normal.of(nothing).solve(WEIGHT)
    assert len(solved.x) == 0
    kept = (problem.y * problem.keep).square().sum(1)
    assert torch.allclose(normal.of(nothing).losses(solved.x), kept)


def test_several_fits_at_once_are_those_of_each(problem: Problem) -> None:
    normal = problem.gram.over()
    chosen = [subset(1.5), zeros_too(), Subset(subset().at[:, :2])]
    ridges = [torch.full((s.count,), 0.5 + k).double() for k, s in enumerate(chosen)]
    priors = [Prior(ridge, centre=0.1 * ridge) for ridge in ridges]
    together, weight = normal.of_each(chosen), WEIGHT.expand(len(chosen), -1)
    solved = Priors(priors).solve_of(together, weight)
    known, losses = Priors(priors).value(solved.x), together.losses(solved.x)
    for k, (s, prior) in enumerate(zip(chosen, priors, strict=True)):
        own, alone = slice(s.count), prior.solve_of(normal.of(s), WEIGHT)
        assert torch.allclose(solved.x[k, own], alone.x, atol=1e-12)
        spread = solved.root[k, own, own] @ solved.root[k, own, own].T
        assert torch.allclose(spread, alone.root @ alone.root.T, atol=1e-12)
        assert torch.allclose(losses[k], normal.of(s).losses(alone.x))
        assert float(known[k]) == pytest.approx(prior.value(alone.x))
        assert not solved.x[k, s.count :].any()


def test_each_fold_is_judged_by_the_sums_of_the_others(problem: Problem) -> None:
    fitted, judged = problem.gram.folds().of(subset(2.5))
    for k, part in enumerate((1, 2)):
        for found, over in ((judged[k], part), (fitted[k], 3 - part)):
            expected = problem.gram.over([over]).of(subset(2.5))
            assert torch.allclose(found.a, expected.a, atol=1e-12)
            assert torch.allclose(found.b, expected.b, atol=1e-12)
            assert torch.allclose(found.squares, expected.squares)


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
