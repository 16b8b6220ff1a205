"""Servos of one type: their numbers are one distribution with a spread between units.

Every joint's fit tells its own numbers, some of them hardly: where no load anchors the torques, all
that is known of kp is what else would have to change with it. The numbers of like servos are drawn
together by as much as the joint leaves open (best linear unbiased prediction; the spread between
units by restricted maximum likelihood, see `statistics.random_effects`), and what changes with them
follows by the joint's own covariance.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch

from torchid.position.fit import absolute, from_absolute
from torchid.position.judge import Equations
from torchid.simulation.servo import INDEX
from torchid.statistics.random_effects import Sessions, means, spreads
from torchid.typing import Bool, Tensor

OF_TYPE = (
    "kp", "kd", "integral", "damping", "armature", "delay", "coulomb", "stiction", "stribeck_speed",
    "motor_share", "acceleration", "speed", "lag", "clip", "dead_zone",
)  # fmt: skip
"""Parameters that a type of servo has; the others are the arm's, or a joint's calibration."""
UNIT_STD = 0.05
"""Least standard deviation between units of one type, of a logarithm [1]: tolerances of gears,
magnets and supplies."""


def pooled(known: Equations, types: Sequence[str], moves: Bool[Tensor, " n"]) -> Equations:
    """The same where joints of one type have been drawn together: servos, and covariances.

    Args:
        known: of the answered model.
        types: (n,) of the joints' servos; an empty name is a type of its own.
        moves: joints that do.
    """
    at = [INDEX[name] for name in known.names]
    x, covariance = absolute(known.servos)[:, at], known.covariances()
    for kind in set(types) - {""}:
        own = torch.tensor([t == kind for t in types]) & moves
        free = known.mask & own[:, None] & torch.tensor([n in OF_TYPE for n in known.names])
        free &= free.sum(0) > 1
        columns = free.any(0).nonzero().flatten()
        if not len(columns):
            continue
        values = torch.where(free, x, torch.nan)[:, columns].T
        variances = covariance.diagonal(dim1=1, dim2=2)[:, columns].T
        sessions = Sessions(values, variances, torch.arange(len(own)))
        between = spreads(sessions)[0]
        centre = means(sessions, between, torch.zeros_like(between))
        least = torch.full_like(between, UNIT_STD)
        least[[k for k, c in enumerate(columns.tolist()) if known.names[c] == "delay"]] = 1e-3
        prior = torch.maximum(between, least).square() + centre.centre_variance
        for j in own.nonzero().flatten().tolist():
            on = free[j, columns]
            told = columns[on]
            c = covariance[j][:, told]
            gain = torch.linalg.solve(c[told] + prior[on].diag(), c.T).T
            x[j] += gain @ (centre.centre[on] - x[j, told])
            covariance[j] = covariance[j] - gain @ c.T
    values = absolute(known.servos)
    values[:, at] = torch.where(known.mask, x, values[:, at])
    servos = replace(known.servos, joint=from_absolute(values))
    return replace(known, servos=servos, given=covariance)
