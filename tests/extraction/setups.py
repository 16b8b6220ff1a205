"""Extraction problems of the built-in arms, with their nominal base parameters as the target."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import torch
from torch import Tensor

from tests.arms import arm
from torchid.extraction.problem import Problem, extraction_problem, two_step
from torchid.feasibility.bounds import Bounds, bounds_groups, read_bounds
from torchid.feasibility.conditions import Conditions, conditions
from torchid.feasibility.sets import nominal_set
from torchid.identification.base_parameters import BaseParameters, base_parameters

BUILT_IN = ("3r", "3r_friction", "kuka_lwr4", "kuka_lwr4_friction")
GROUPS = tuple((name, group) for name in BUILT_IN for group in bounds_groups(arm(name)))


@lru_cache
def base_of(name: str) -> BaseParameters:
    return base_parameters(arm(name), nominal_set(arm(name)).effects)


@lru_cache
def problem_of(name: str, group: str = "normal", shapes: bool = False) -> Problem:
    robot, sets, base = arm(name), nominal_set(arm(name)), base_of(name)
    target = two_step(base, sets.effects, base.project(sets.vector[0]))
    asked = conditions(robot, shapes=shapes)
    return extraction_problem(robot, target, read_bounds(robot, group), asked)


def asking(given: Problem, **changes: Tensor) -> Problem:
    """The problem with other conditions."""
    return replace(given, conditions=replace(given.conditions, **changes))


def bounded(given: Problem, change: Callable[[Bounds], Bounds]) -> Problem:
    """The problem with other bounds; a function of them that may change clones in place."""
    b = given.bounds
    copies = {k: v.clone() for k, v in b.coefficients.items()}
    bounds = change(Bounds(b.name, b.mass.clone(), b.com.clone(), b.inertia.clone(), copies))
    return replace(given, bounds=bounds, box=bounds.box(given.target.effects))


def random_vectors(given: Problem, count: int, seed: int = 0) -> Tensor:
    """(count, D) search vectors, uniform within the bounds."""
    g = torch.Generator().manual_seed(seed)
    return given.physical(torch.rand(count, given.size, generator=g, dtype=torch.float64))


def nothing_asked(given: Conditions) -> Conditions:
    """The conditions without boxes of the centres of mass."""
    infinite = torch.tensor([-torch.inf, torch.inf], dtype=torch.float64)
    return replace(given, com_box=infinite.repeat(given.com_box.shape[0], 3, 1))
