"""Columns that are sums or differences of two joints'."""

from dataclasses import replace

import pytest
import torch

from tests.doctor.synthetic import clean
from torchid.doctor.examine import examine
from torchid.doctor.moves import parallel_pairs
from torchid.doctor.repair import MOTION, TORQUE, Map, MappedColumns
from torchid.robot.library import load_robot


@pytest.mark.parametrize(
    ("name", "pairs"),
    [("3r", {(1, 2)}), ("ur10e", {(1, 2), (1, 3), (2, 3)}), ("panda", set())],
)
def test_axes_that_are_parallel_in_every_posture(name, pairs):
    assert set(parallel_pairs(load_robot(name))) == pairs | {(k, j) for j, k in pairs}


def test_axes_with_another_one_between_them_are_not():
    """Joints 2 and 4 of this arm are parallel at zero alone."""
    assert (1, 3) not in parallel_pairs(load_robot("kuka_lwr4"))


@pytest.mark.parametrize(
    "sums",
    [
        {MOTION: (2, 1, 1.0)},
        {MOTION: (1, 2, -1.0)},
        {TORQUE: (2, 1, 1.0)},
        {TORQUE: (1, 2, -1.0)},
        # The angle to the ground, and the torques of the motors that turn by it.
        {MOTION: (2, 1, 1.0), TORQUE: (1, 2, -1.0)},
    ],
    ids=str,
)
def test_a_coupling_is_found_and_mended(sums):
    robot, log = clean("3r", 0)
    seen = log
    for signals, one in sums.items():
        seen = MappedColumns(signals, replace(Map.of(3), coupled=(one,))).apply(seen)
    result = examine(robot, seen, first=True)
    (check,) = (c for c in result.checks if c.name == "coupling of joints")
    assert check.verdict == "wrong"
    mended = result.mended()
    torch.testing.assert_close(mended.q, log.q)
    torch.testing.assert_close(mended.tau, log.tau)
