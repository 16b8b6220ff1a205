"""What logs tell of a model's values: information as robust as the spread of blocks says."""

import torch

from torchid.design.columns import Columns
from torchid.design.gram import inverse_root
from torchid.effects.base import Effect
from torchid.effects.registry import KINDS, nominal_effects
from torchid.identification.base_parameters import BaseParameters
from torchid.robot.inertia import PARAMETERS_PER_LINK, paper_order
from torchid.robot.knowledge import Knowledge, coefficient_keys
from torchid.robot.model import Robot
from torchid.statistics.jackknife import fit_statistics
from torchid.statistics.proportion import HALF_95
from torchid.statistics.robust import huber_weights
from torchid.typing import Bool, Float, Int, Tensor

BETWEEN = 0.1
"""Standard deviation of friction from one session of an arm to the next, as a share of it, where no
sessions tell it [1]: with the temperature of the grease viscous friction changes by 2 to 10 % a
day (docs/fleet.md), by more from a cold start."""

CHANGING = ("speed", "sign", "hysteresis")
"""Families of effects that temperature changes."""


def known_names(effect: Effect) -> list[str]:
    """Names by which an effect's coefficients are known."""
    return coefficient_keys(effect.name, effect.coefficient_names())


def between_sessions(robot: Robot, share: float = BETWEEN) -> dict[str, float]:
    """Variances, by name, by which coefficients of friction change between sessions by themselves.

    Args:
        robot: with its effects.
        share: standard deviation as a share of a coefficient [1].
    """
    out: dict[str, float] = {}
    for effect, values in nominal_effects(robot):
        if KINDS[effect.name].family in CHANGING:
            pairs = zip(known_names(effect), values, strict=True)
            out |= {name: (share * value) ** 2 for name, value in pairs}
    return out


def rigid_information(
    information: Float[Tensor, "M M"], base: BaseParameters, n: int
) -> Float[Tensor, "_ _"]:
    """Information of base parameters, and coefficients behind them, as that of n links' parameters
    and the same coefficients: base parameters are G times those of the links."""
    grouping = base.grouping[: base.n_rigid, : base.n_rigid_parameters]
    links = grouping[:, paper_order(n).argsort()]
    rest = len(information) - base.n_rigid
    whole = torch.block_diag(links, torch.eye(rest, dtype=torch.float64))
    return whole.T @ information @ whole


def robust_information(
    table: Float[Tensor, "R C"], rest: Float[Tensor, " R"], block: Int[Tensor, " R"]
) -> Float[Tensor, "C C"]:
    """Inverse covariance of a least-squares fit's coefficients, from the spread of whole blocks of
    rows; none along directions that the rows do not determine.

    Blocks may spread less along a direction than independent samples would, by chance where there
    are few; then as much is known as from those, and no more.

    Args:
        table, rest: columns and what the fit leaves, each row in units of what an independent
            sample leaves.
        block: of every row.
    """
    gram = table.T @ table
    root = inverse_root(gram)  # coordinates in which independent samples have unit covariance
    found = fit_statistics(table @ root, rest, block, variance=1.0)
    wide = torch.where(found.by_one_block, 1.0, found.quantile() / HALF_95)
    spread, axes = torch.linalg.eigh(found.covariance * wide * wide.unsqueeze(1))
    back = gram @ root @ axes
    return (back / spread.clamp(min=1.0)) @ back.T


def learned(
    columns: Columns,
    keep: Bool[Tensor, "n N"],
    block: Int[Tensor, " N"],
    effective: Float[Tensor, " n"],
    base: BaseParameters,
    source: str,
) -> Knowledge:
    """What a log tells of a model that was fitted to it: of base parameters and all coefficients of
    its effects together, whether they were fitted or given.

    Args:
        columns: at the fitted model.
        keep: samples that count.
        block: (N,) block of every sample.
        effective: (n,) independent samples.
        base: rigid base parameters of the robot.
        source: of the log, in words.
    """
    n = columns.n
    order = paper_order(base.n_rigid_parameters // PARAMETERS_PER_LINK)
    independent = order[list(base.independent[: base.n_rigid])]
    effects = [e for e, _ in columns.model.effects if not (e.event or e.inertial)]
    names = [name for e in effects for name in known_names(e)]
    # One coefficient of two effects of the same name and place cannot be told by its name.
    once = [k for k, name in enumerate(names) if names.count(name) == 1]
    parts = [columns.regressor.flatten(0, 1)[independent]]
    parts += [columns.on_all_joints(e) for e in effects]
    a = torch.cat(parts) * keep
    left = columns.gap * keep
    # Rows in units of what an independent sample leaves; those far out count as their limit.
    unit = (effective / left.square().sum(1).clamp(min=1e-300)).sqrt()
    weight = huber_weights(left) * unit.unsqueeze(1)
    table = (a * weight).flatten(1).T
    information = robust_information(table, (left * weight).flatten(), block.repeat(n))
    whole = rigid_information(information, base, n)
    known = Knowledge(n, tuple(names), whole, (source,))
    return known.over([names[k] for k in once]) if len(once) < len(names) else known
