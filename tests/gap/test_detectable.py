"""What is said to be detectable is detected, and what is not is not."""

import pytest
import torch

from tests.gap.problems import Case, ar_noise, bank, problem, random
from tests.gap.test_select import named
from torchid.effects.friction import TorqueOffset, ViscousFriction
from torchid.gap.detectable import not_testable
from torchid.gap.diagnosis import NotTestable
from torchid.gap.problem import Problem
from torchid.gap.projection import Projector
from torchid.gap.select import Search
from torchid.robot.library import load_robot
from torchid.typing import Tensor

N, ROWS = 3, 1000
ROBOT = load_robot("3r")
QUIET = torch.zeros(N, dtype=torch.float64)
"""A torque of nothing: every effect is as large as it, so that its smallest size is told."""


def only(made: Problem, model: Projector | None = None, torque: Tensor = QUIET) -> NotTestable:
    shown = Projector(made.y) if model is None else model
    (entry,) = not_testable(made, shown, ROBOT, torque, ())
    return entry


@pytest.mark.parametrize("place", [0, 2])
def test_twice_the_smallest_is_found_and_a_tenth_is_not(place):
    """In nine of ten draws of noise, with other candidates beside it."""
    x = 3 * ar_noise(1, 1, ROWS, pole=0.9, seed=1)
    others = tuple(
        named(ar_noise(3, 1, ROWS, pole=0.9, seed=50 + j), j, "cogging", looks=100.0)
        for j in range(N)
    )
    banks = (named(x, place, "viscous_friction"), *others)
    listed = not_testable(
        problem(random(N, ROWS, seed=9), banks),
        Projector(random(N, ROWS, seed=9)),
        ROBOT,
        QUIET,
        (),
    )
    entry = next(e for e in listed if e.effect == "viscous_friction")
    assert entry.joints == (() if place is None else (place,))
    assert entry.unit == ViscousFriction.coefficients[0].unit
    found = {2.0: 0, 0.1: 0}
    for size in found:
        for seed in range(10):
            y = random(N, ROWS, seed=100 + seed)
            y[place] += size * entry.smallest_detectable * x[0, 0]
            names = [t.name for t in Search(problem(y, banks)).run(5)]
            assert set(names) <= {"viscous_friction", "cogging"}
            found[size] += "viscous_friction" in names
    assert found[2.0] >= 9
    assert found[0.1] == 0


def test_smallest_sizes_scale_with_the_column():
    x = random(1, 1, ROWS, seed=1)
    y = random(N, ROWS, seed=2)
    one, ten = (
        only(problem(y, (named(k * x, 1, "viscous_friction"),))).smallest_detectable
        for k in (1.0, 10.0)
    )
    assert one == pytest.approx(10 * ten)


def test_what_the_joint_s_torque_dwarfs_is_not_listed():
    x = random(1, 1, ROWS, seed=1)
    made = problem(random(N, ROWS, seed=2), (named(x, 1, "viscous_friction"),))
    large = torch.tensor([0.0, 1e3, 0.0])
    assert not_testable(made, Projector(made.y), ROBOT, large, ()) == []


def test_what_the_motion_does_not_excite():
    zero = torch.zeros(1, 1, ROWS, dtype=torch.float64)
    entry = only(problem(random(N, ROWS, seed=2), (named(zero, 1, "viscous_friction"),)))
    assert entry.smallest_detectable is None
    assert "excite" in entry.reason


@pytest.mark.parametrize(("outside", "told"), [(0.0, False), (3e-3, True)])
def test_what_the_model_holds(outside, told):
    """Exactly, where no size would be seen; or but for a few thousandths, where a large one would
    be."""
    held = random(1, ROWS, seed=1)
    x = held + outside**0.5 * random(1, ROWS, seed=3)
    made = problem(random(N, ROWS, seed=2), (named(x[None], 1, "viscous_friction"),))
    model = Projector(made.y)
    model.add(held, 1)
    entry = only(made, model)
    assert (entry.smallest_detectable is not None) == told
    assert "combination" in entry.reason
    if told:
        free = only(made).smallest_detectable
        assert entry.smallest_detectable == pytest.approx(free / outside**0.5, rel=0.2)


def test_the_best_shape_counts():
    """One member that the motion excites is enough."""
    columns = torch.cat([torch.zeros(1, 1, ROWS), random(1, 1, ROWS, seed=1)])
    made = problem(random(N, ROWS, seed=2), (bank(columns, 1),))
    assert only(made).smallest_detectable is not None


def test_accepted_effects_are_not_listed():
    x = random(1, 1, ROWS, seed=1)
    y = random(N, ROWS, seed=2)
    y[1] += 2 * x[0, 0]
    made = problem(y, (named(x, 1, "viscous_friction"),))
    found = Search(made).run(3)
    assert len(found) == 1
    assert not_testable(made, Search(made, found).model(), ROBOT, QUIET, found) == []


def test_refitted_parameters_hide_what_trusted_ones_show():
    """On the 3R: the rotor inertia of the first joint is exactly a base parameter."""
    names = ("rotor_inertia", "viscous_friction", "torque_offset")
    shown = {}
    for free in (False, True):
        case = Case([], names, free=free)
        made = problem(case.evaluator.residual(), tuple(case.banks))
        model = Projector(made.y)
        if free:
            from torchid.gap.task import fixed_terms

            for term in fixed_terms(case.evaluator, case.task):
                model.add(term.columns, term.place)
        large = torch.full((N,), 1e6, dtype=torch.float64)
        listed = not_testable(made, model, ROBOT, large, ())
        shown[free] = {(e.effect, *e.joints): e for e in listed}
    assert ("rotor_inertia", 0) not in shown[False]
    assert shown[True]["rotor_inertia", 0].smallest_detectable is None
    assert ("viscous_friction", 0) not in shown[True]
    assert TorqueOffset.name not in {e for e, _ in shown[False]}
