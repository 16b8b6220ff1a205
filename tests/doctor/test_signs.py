"""Axes turned around: what the robot's geometry hides, and the groups that are named together."""

import pytest
import torch

from tests.doctor.synthetic import clean
from torchid.doctor.examine import examine
from torchid.doctor.moves import alternatives, invisible_groups, least_groups
from torchid.robot.library import load_robot


def groups(name):
    robot = load_robot(name)
    return invisible_groups(robot, tuple(robot.gravity.tolist()))


def turned(log, joints):
    sign = torch.ones(log.n, dtype=torch.float64)
    sign[list(joints)] = -1.0
    return log.replace(q=log.q * sign, dq=log.dq * sign, tau=log.tau * sign)


@pytest.mark.parametrize(
    ("name", "least"),
    [("3r", [{0}]), ("panda", [{0, 2, 4, 6}]), ("kuka_lwr4", [{1, 3, 5}, {0, 2, 4, 6}])],
)
def test_groups_that_mirrored_bodies_explain(name, least):
    assert least_groups(groups(name)) == [frozenset(g) for g in least]


def test_they_are_a_group():
    every = {frozenset(), *groups("kuka_lwr4")}
    assert {a ^ b for a in every for b in every} == every


def test_the_smallest_of_equal_groups_is_first_and_free_axes_are_left():
    assert alternatives(frozenset({1, 3}), groups("panda")) == [
        frozenset({1, 3}), frozenset({0, 1, 2, 3, 4, 6}),
    ]  # fmt: skip
    assert alternatives(frozenset({0, 1}), groups("3r")) == [frozenset({1})]


@pytest.mark.nightly
def test_equal_groups_are_named_and_none_is_applied():
    robot, log = clean("panda", 0)
    result = examine(robot, turned(log, (1, 3)), first=True)
    (found,) = result.undecided
    assert [c.name for c in found.choices] == ["joint sign 2,4", "joint sign 1,2,3,4,5,7"]
    assert not any(r for r in result.repairs if "q2" in str(r))
    chosen = examine(robot, turned(log, (1, 3)), ["joint sign 2,4"], first=True)
    assert torch.equal(chosen.mended().q, log.q)
    assert torch.equal(chosen.mended().tau, log.tau)


@pytest.mark.slow
def test_a_group_without_an_equal_one_is_mended():
    robot, log = clean("ur10e", 0)
    result = examine(robot, turned(log, (1, 4)), first=True)
    assert result.undecided == ()
    assert torch.equal(result.mended().q, log.q)
