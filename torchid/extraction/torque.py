"""What a loss means in torque: how far sets are from the torque that they should have."""

import torch

from torchid.extraction.problem import Problem
from torchid.feasibility.sets import ParameterSets
from torchid.identification.base_parameters import random_states, stacked_regressor
from torchid.typing import Float

FAR = 0.05
"""Largest such difference of a joint from which a set's torque is said to be another one."""


def torque_error(problem: Problem, sets: ParameterSets) -> Float[torch.Tensor, "K n"]:
    """Root mean square over random states of the difference between each set's torque and that of
    the asked-for base parameters, over the latter's own: (K, n), 0.01 is 1 %.

    Base parameters that the log did not determine, which the loss does not read, do not count.
    """
    base, values = problem.target.base, problem.target.values
    rows = stacked_regressor(problem.robot, problem.target.effects, random_states(problem.robot))
    rows = rows[:, list(base.independent)]
    read = problem.target.weight.abs().sum(0) > 0
    change = (base.project(sets.vector) - values) * read

    def rms(beta: torch.Tensor) -> torch.Tensor:
        return (beta @ rows.T).unflatten(-1, (-1, problem.n)).square().mean(-2).sqrt()

    return rms(change) / rms(values * read).clamp(min=1e-300)
