"""Bodies that fit best: at the optimum, from wherever the search begins."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from torchid.doctor.cone import Columns, Normal, fit
from torchid.doctor.hypothesis import Hypothesis, Judge, minimum
from torchid.doctor.samples import BLOCKS, samples
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.log.model import Log
from torchid.robot.library import load_robot

SUMS = ("gram", "cross", "square", "count")
ROWS, JOINTS, PARAMETERS, UNKNOWNS = 40, 2, 12, 90


def rows(seed: int) -> tuple[Normal, np.ndarray]:
    """Normal equations of one block of rows, and what may be."""
    draw = np.random.default_rng(seed)
    a = draw.normal(size=(JOINTS, ROWS, PARAMETERS))
    y = draw.normal(size=(JOINTS, ROWS, 1))
    count = np.full((1, JOINTS), ROWS)
    products = (a.transpose(0, 2, 1) @ a)[None], (a.transpose(0, 2, 1) @ y)[None, ..., 0]
    normal = Normal(*products, np.square(y).sum((1, 2))[None], count, y.var((1, 2)))
    return normal, np.abs(draw.normal(size=(PARAMETERS, UNKNOWNS)))


@pytest.mark.parametrize("seed", range(5))
def test_no_unknown_helps_at_the_optimum_wherever_the_search_begins(seed: int) -> None:
    normal, bodies = rows(seed)
    weights = np.ones(JOINTS)
    found = fit(normal, bodies, weights)
    weight = weights / normal.spread
    gram, cross = np.tensordot(weight, normal.gram[0], 1), weight @ normal.cross[0]
    helps = bodies.T @ (cross - gram @ found.x)
    scale = np.abs(bodies.T @ cross).max()
    assert len(found.used)
    assert np.abs(helps[found.used]).max() < 1e-9 * scale
    assert helps.max() < 1e-9 * scale
    others = np.setdiff1d(np.arange(UNKNOWNS), found.used)
    for used in (found.used, others):
        assert np.allclose(fit(normal, bodies, weights, used).x, found.x, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_blocks_and_all_others_together_are_all_rows(seed: int) -> None:
    normal, _ = rows(seed)
    scale = np.arange(1, 6)
    many = replace(normal, **{k: np.multiply.outer(scale, getattr(normal, k)[0]) for k in SUMS})
    parts = many.apart(np.array([3, 1]))
    for k in SUMS:
        sums, own = getattr(many, k), getattr(parts, k)
        assert np.array_equal(own[:2], sums[[3, 1]])
        assert np.allclose(own.sum(0), sums.sum(0))


@pytest.mark.parametrize("seed", range(5))
def test_no_bodies_leave_less_than_what_each_joint_leaves_by_itself(seed: int) -> None:
    normal, bodies = rows(seed)
    # Rows with these products, as the columns of their roots.
    columns = Columns(np.linalg.cholesky(normal.gram[0]).transpose(0, 2, 1))
    bound = columns.least(normal)
    assert (bound <= fit(normal, bodies).variance * (1 + 1e-9)).all()
    # It is what plain least squares leave.
    best = np.linalg.solve(normal.gram[0], normal.cross[0][..., None])[..., 0]
    left = normal.square[0] - (normal.cross[0] * best).sum(-1)
    assert bound == pytest.approx(left / ROWS, rel=1e-6)


def test_a_grid_is_evaluated_only_where_its_lowest_point_may_be() -> None:
    """The bound half a unit below the loss leaves three of nine points."""
    asked = []

    def loss(x: float) -> float:
        asked.append(x)
        return abs(x - 0.2)

    grid = np.arange(-4.0, 5.0).tolist()
    found = minimum(loss, grid, 0.05, lambda x: abs(x - 0.2) - 0.5)
    assert found == minimum(lambda x: abs(x - 0.2), grid, 0.05)
    assert {x for x in asked if x in grid} == {0.0}


@pytest.mark.parametrize("block", range(1, BLOCKS - 1))
def test_a_joint_that_moves_in_one_block_alone_can_be_left_out(block: int) -> None:
    """What is left of its columns is nothing, and no rounding that is scaled to length one."""
    robot = load_robot("3r")
    t = torch.arange(0.0, 16.0, 0.01, dtype=torch.float64)
    inside = (t > 2.0 * block + 0.3) & (t < 2.0 * block + 1.7)
    own = torch.where(inside, torch.sin(torch.pi * (t - 2.0 * block - 0.3) / 1.4) ** 4, 0.0)
    q = torch.stack([torch.sin(1.7 * t), torch.sin(1.1 * t + 1), 0.5 * own], 1)
    (dq,) = torch.gradient(q, spacing=0.01, dim=0)
    (ddq,) = torch.gradient(dq, spacing=0.01, dim=0)
    rows = samples(Log(t, q, tau=inverse_dynamics(robot, q, dq, ddq) + 0.1 * dq.sign()))
    judge = Judge(robot, rows)
    normal = judge.normal(Hypothesis.literal(robot), judge.members)
    apart = normal.apart(np.array([block]))
    for rest in (normal.without(block).gram.sum(0), apart.gram[-1]):
        # Of a last joint's rows that are none, nothing.
        assert not rest[2].any()
    assert np.isfinite(judge.held_out(Hypothesis.literal(robot))[block, 2])
