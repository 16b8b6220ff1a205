"""Faults that a search has found, beside what the robot's own parameters say of them."""

import math
from types import SimpleNamespace
from unittest.mock import patch

import pytest

from tests.doctor.synthetic import clean
from torchid.doctor.faults import confirmed, denied_faults
from torchid.doctor.hypothesis import Hypothesis, Judge
from torchid.doctor.moves import Move
from torchid.doctor.repair import Map, shifted
from torchid.doctor.samples import samples


@pytest.mark.parametrize(
    ("denied", "where"),
    [((False, False), "end"), ((False, True), "second"), ((True, False), "first")],
)
def test_sizes_are_of_the_motion_before_what_nobody_confirms(denied, where):
    found = [
        SimpleNamespace(move=SimpleNamespace(kind="position sign", before=before))
        for before in ("first", "second")
    ]
    result = SimpleNamespace(faults=found, final=SimpleNamespace(hypothesis="end"))
    with patch("torchid.doctor.faults._nominal_objects", side_effect=denied):
        assert confirmed(result, denied_faults(None, result)) == where


@pytest.mark.parametrize(("planted", "denied"), [(0.0, True), (math.pi / 2, False)])
def test_a_zero_is_held_against_the_robot_s_own_parameters(planted, denied):
    robot, log = clean("panda", 0, nominal=True)
    offsets = [planted * (k == 3) for k in range(robot.n)]
    rows = samples(shifted(("q",), offsets).apply(log))
    judge, start = Judge(robot, rows), Hypothesis.literal(robot)
    turned = Map.of(robot.n, offsets=[-math.pi / 2 * (k == 3) for k in range(robot.n)])
    found = SimpleNamespace(move=Move("zero", (3,), start, turned))
    assert bool(denied_faults(judge, SimpleNamespace(faults=[found]))) == denied
