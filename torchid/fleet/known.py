"""A fleet's type, or one of its units, as a robot whose model says how sure it is."""

from dataclasses import replace

import torch

from torchid.errors import TorchidError
from torchid.export.dynamics import of_base
from torchid.fleet.identify import Fleet
from torchid.identification.knowledge import known_names, over_parameters
from torchid.identification.values import BaseValues
from torchid.robot.model import Robot


def known_model(fleet: Fleet, unit: str | None = None) -> Robot:
    """The robot that a fleet's units are, or one unit: what it is known to be before its next log.

    The values are the type's means, known as well as its units are alike; or a unit's own, drawn
    towards these by as much as its sessions leave open. How much coefficients of effects change
    from day to day is that of the units' sessions. Parameters count as independent of each other.

    Args:
        fleet: from `fleet_identify`.
        unit: which; the type if None.

    Raises:
        TorchidError: no such unit, or a type of which one unit alone is known.
    """
    found, base = fleet.pooled, fleet.base
    daily = found.daily.nan_to_num(0.0)
    names = [u.unit for u in fleet.units]
    if unit is None:
        if len(names) < 2:
            raise TorchidError(
                "the spread of a type is not known from one unit.",
                got=names[0],
                expected="logs of several units, or `unit=...`",
            )
        what = f"{len(names)} units"
        values = found.mean
        variance = found.std.square() + found.between.square()
    elif unit in names:
        k = names.index(unit)
        what, values, variance = unit, found.shrunk[:, k], found.shrunk_std[:, k].square()
    else:
        raise TorchidError("there is no such unit.", got=unit, available=names)
    # Changes from day to day: of effects kept by name, of links a part of what is not known.
    effects = fleet.model.layout.effects
    coefficients = [name for e in effects for name in known_names(e)]
    rigid, between = base.n_rigid_parameters, dict[str, float]()
    for b, k in enumerate(base.independent):
        if k < rigid:
            variance[b] += daily[b] ** 2
        elif float(daily[b]) > 0:
            between[coefficients[k - rigid]] = float(daily[b])
    there = variance.isfinite() & (variance > 0) & values.isfinite()
    root = torch.diag(variance.clamp(min=1e-300).rsqrt())[there]
    known = over_parameters(root, base, effects, f"{fleet.model.robot.name}: {what}")
    sessions = sum(len(u.sessions) for u in fleet.units if unit in (None, u.unit))
    sources = (f"{what} in {sessions} session{'s' * (sessions > 1)}",)
    left = fleet.one_fit.noise.nan_to_num(0.0)
    sure = replace(known, sources=sources, left=left, between=between)
    own = BaseValues(
        base,
        effects,
        torch.where(there, values, 0.0),
        there,
        torch.diag(torch.where(there, variance, 0.0)),
        None,
        sure,
    )
    return of_base(fleet.model.robot, own).robot
