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

from torchid.effects.servo import INDEX, PARAMETERS
from torchid.position.fit import absolute, from_absolute
from torchid.position.judge import Equations
from torchid.statistics.criteria import SHEET_STD, UNIT_STD
from torchid.statistics.random_effects import Sessions, means, spreads
from torchid.typing import Bool, Tensor

OF_TYPE = tuple(p.name for p in PARAMETERS if p.of_type)
"""Parameters that a type of servo has; the others are the arm's, or a joint's calibration."""


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
    at = [INDEX[name] for name in known.names]
    of_makers = torch.full_like(known.servos.joint, torch.nan)
    for j, sheet in enumerate(sheets):
        for name, value in sheet.items():
            of_makers[j, INDEX[name]] = value
    values = absolute(replace(known.servos, joint=of_makers))[:, at]
    x, covariance = absolute(known.servos)[:, at], known.covariances()
    free = known.mask & values.isfinite() & moves[:, None]
    logs = torch.tensor([PARAMETERS[k].kind == "log" for k in at])
    std = SHEET_STD * torch.where(logs, 1.0, values.abs())
    for j in free.any(1).nonzero().flatten().tolist():
        on = free[j]
        x[j], covariance[j] = _beside(x[j], covariance[j], on, values[j, on], std[j, on].square())
    return _with_values(known, x, covariance)


def _beside(
    x: Tensor, covariance: Tensor, on: Tensor, values: Tensor, variances: Tensor
) -> tuple[Tensor, Tensor]:
    """Numbers (K,) of a joint and their covariance beside what else is known of some of them: the
    best linear unbiased prediction."""
    c = covariance[:, on]
    gain = torch.linalg.solve(c[on] + variances.diag(), c.T).T
    return x + gain @ (values - x[on]), covariance - gain @ c.T


def _with_values(known: Equations, x: Tensor, covariance: Tensor) -> Equations:
    """The same with other values (n, K) of what is free, and other covariances."""
    at = [INDEX[name] for name in known.names]
    values = absolute(known.servos)
    values[:, at] = torch.where(known.mask, x, values[:, at])
    return replace(
        known, servos=replace(known.servos, joint=from_absolute(values)), told=covariance
    )


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
        of_kind = torch.tensor([t == kind for t in types]) & moves
        free = known.mask & of_kind[:, None] & torch.tensor([n in OF_TYPE for n in known.names])
        free &= free.sum(0) > 1
        columns = free.any(0).nonzero().flatten()
        if not len(columns):
            continue
        values = torch.where(free, x, torch.nan)[:, columns].T
        variances = covariance.diagonal(dim1=1, dim2=2)[:, columns].T
        sessions = Sessions(values, variances, torch.arange(len(of_kind)))
        between = spreads(sessions)[0]
        centre = means(sessions, between, torch.zeros_like(between))
        least = torch.full_like(between, UNIT_STD)
        least[[k for k, c in enumerate(columns.tolist()) if known.names[c] == "delay"]] = 1e-3
        prior = torch.maximum(between, least).square() + centre.centre_variance
        for j in of_kind.nonzero().flatten().tolist():
            on, here = free[j], free[j, columns]
            x[j], covariance[j] = _beside(x[j], covariance[j], on, centre.centre[here], prior[here])
    return _with_values(known, x, covariance)
