"""Servos of one type: their numbers are one distribution with a spread between units.

Every joint's fit tells its own numbers, some of them hardly: where no load anchors the torques, all
that is known of kp is what else would have to change with it. The numbers of like servos are drawn
together by as much as the joint leaves open (best linear unbiased prediction; the spread between
units by restricted maximum likelihood, see `statistics.random_effects`), and what changes with them
follows by the joint's own covariance.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch

from torchid.position.fit import absolute, from_absolute
from torchid.position.judge import Equations
from torchid.simulation.servo import INDEX, NAMES, PARAMETERS
from torchid.statistics.random_effects import Sessions, means, spreads
from torchid.typing import Bool, Tensor

OF_TYPE = (
    "kp", "kd", "integral", "damping", "armature", "delay", "coulomb", "stiction", "stribeck_speed",
    "motor_share", "acceleration", "speed", "lag", "clip", "dead_zone",
)  # fmt: skip
"""Parameters that a type of servo has; the others are the arm's, or a joint's calibration."""
SHEET_STD = 0.2
"""Standard deviation of a maker's value, as a share of it [1]: supplies, wear, temperature."""
UNIT_STD = 0.05
"""Least standard deviation between units of one type, of a logarithm [1]: tolerances of gears,
magnets and supplies."""


def with_data_sheets(
    known: Equations, sheets: Sequence[Mapping[str, float]], moves: Bool[Tensor, " n"]
) -> Equations:
    """The same beside what makers say: a number that a log leaves open is theirs, and what changes
    with it follows.

    Args:
        known: of the answered model.
        sheets: (n,) values by parameter, in their units; empty of a joint without one.
        moves: joints that do.
    """
    x, covariance = absolute(known.servos), known.covariances()
    for j, sheet in enumerate(sheets):
        names = [n for n, on in zip(known.names, known.mask[j], strict=True) if on and n in sheet]
        if not names or not bool(moves[j]):
            continue
        told, at = ([of.index(n) for n in names] for of in (list(known.names), list(NAMES)))
        said = known.servos.joint[j].clone()
        said[at] = torch.tensor([sheet[n] for n in names], dtype=said.dtype)
        there = absolute(replace(known.servos, joint=said[None]))[0, at]
        logs = [PARAMETERS[k].kind == "log" for k in at]
        std = SHEET_STD * torch.where(torch.tensor(logs), 1.0, there.abs())
        c = covariance[j][:, told]
        gain = torch.linalg.solve(c[told] + std.square().diag(), c.T).T
        step = gain @ (there - x[j, at])
        x[j, [INDEX[name] for name in known.names]] += step * known.mask[j]
        covariance[j] = covariance[j] - gain @ c.T
    servos = replace(known.servos, joint=from_absolute(x))
    return replace(known, servos=servos, given=covariance)


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
