"""How sure an effect of a servo is."""

from dataclasses import replace
from functools import cache

import pytest
import torch

from tests.position.planted import planted, robot, true_servos
from torchid.position.data import prepare
from torchid.position.effects import BY_NAME, CORE
from torchid.position.evidence import Evidence
from torchid.position.judge import equations
from torchid.position.servo_model import Motions
from torchid.simulation.servo_loop import windows_of

ZONE = BY_NAME["dead_zone"]


@cache
def evidence() -> Evidence:
    """Of the true servos of an arm, whose windows need no search."""
    servos = true_servos(3, dead_zone=(2, 0.01))
    data = prepare(robot(), planted(servos, motions=3, seconds=10.0))
    windows, every = windows_of(data.tracks, 2.0), torch.ones(3, dtype=torch.bool)
    free = dict.fromkeys(CORE, every) | {"dead_zone": torch.arange(3) == 1}
    known = equations(data, servos, free, windows)
    return Evidence(Motions(data, windows), known, data.slight, torch.zeros(3).double(), 0.0)


def losses(*sizes: float) -> torch.Tensor:
    """Of windows, alike on all joints: times what calls for no cause."""
    of = evidence()
    rows = of.motions.windows.length * of.motions.windows.weight
    size = torch.tensor(sizes, dtype=torch.float64).expand(len(rows))
    return size[:, None] * rows[:, None] * of.noise.square()


def sure(
    before: float, after: float, joints: int = 1, left: float = 0.0, whole: float = 0.0
) -> float:
    """Joint 2 leaves so many times what calls for no cause, in squares, on motions left out."""
    left_out = left * evidence().noise.square() * (torch.arange(3) == 1)
    of = replace(evidence(), left=left_out, whole=whole)
    return of.sure(ZONE, 1, losses(before), losses(after), 1, joints)


def test_an_effect_that_explains_the_error_is_sure():
    assert sure(100.0, 0.5) > 0.99


@pytest.mark.parametrize("after", [99.0, 100.0])
def test_one_that_explains_nothing_is_not(after):
    assert sure(100.0, after) < 0.05


@pytest.mark.parametrize(("before", "after"), [(0.3, 0.01), (0.1, 0.0)])
def test_what_calls_for_no_cause_gets_none(before, after):
    assert sure(before, after) < 0.5


def test_what_stays_unexplained_elsewhere_bounds_it():
    """On the joint, or on the arm: what does no good on motions left out has no name."""
    found = [sure(100.0, 0.5, left=left) for left in (0.0, 10.0, 60.0, 200.0)]
    assert found == sorted(found, reverse=True)
    assert found[0] > 0.99
    assert found[-1] < 0.5
    assert sure(100.0, 0.5, whole=0.25) < 0.7


def test_a_cause_that_all_joints_share_has_one_price():
    alone, shared = (sure(1.6, 0.9, joints) for joints in (1, 3))
    assert shared > alone


def test_what_one_window_alone_says_is_less_sure_than_what_all_say():
    """The same fall of the loss, of all windows alike or of a single one."""
    of, after = evidence(), losses(1.0)
    every, alone = 6 * after, after.clone()
    alone[3] = after[3] + (every - after).sum(0)
    both = [of.sure(ZONE, 1, before, after, 1) for before in (every, alone)]
    assert both[0] > both[1] + 0.1
    # What acts at an end of the travel is in each log that is drawn.
    stop = BY_NAME["end_stop"]
    of_stop = [of.sure(stop, 1, before, after, 1) for before in (every, alone)]
    assert of_stop[0] == pytest.approx(of_stop[1], abs=1e-3)


def test_numbers_of_a_servo_cost_what_the_log_knows_of_them():
    """More of a log knows them better, and a plane's five numbers cost more than one."""
    of = evidence()
    more = replace(of, known=replace(of.known, gram=100 * of.known.gram))
    assert 0 < of.cost(ZONE, 1, 100.0, 1) < more.cost(ZONE, 1, 100.0, 1)
    plane = BY_NAME["plane_contact"]
    assert of.cost(plane, None, 100.0, 5) == pytest.approx(5 * of.cost(plane, None, 100.0, 1))
