"""What logs tell of a model's values: information as robust as the spread of blocks says."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import torch

from torchid.design.columns import Columns
from torchid.effects.base import Effect
from torchid.effects.inertia import Payload
from torchid.effects.registry import KINDS, Valued, carrying, nominal_effects
from torchid.identification.base_parameters import BaseParameters
from torchid.identification.least_squares import orthonormal
from torchid.robot.inertia import PARAMETERS_PER_LINK, paper_order
from torchid.robot.knowledge import BETWEEN, NOTHING, Knowledge, coefficient_keys
from torchid.robot.model import Robot
from torchid.statistics.jackknife import fit_statistics
from torchid.statistics.robust import huber_weights
from torchid.typing import Bool, Float, Int, Tensor

CHANGING = ("speed", "sign", "hysteresis")
"""Families of effects that temperature changes."""


def known_names(effect: Effect) -> list[str]:
    """Names by which an effect's coefficients are known."""
    return coefficient_keys(effect.name, effect.coefficient_names())


def between_sessions(robot: Robot, share: float = BETWEEN) -> dict[str, float]:
    """Variances, by name, by which coefficients change between sessions by themselves: as several
    sessions have shown them, or else, of friction, a usual share.

    Args:
        robot: with its effects.
        share: standard deviation as a share of a coefficient [1].
    """
    out: dict[str, float] = {}
    for effect, values in nominal_effects(robot):
        if KINDS[effect.name].family in CHANGING:
            pairs = zip(known_names(effect), values, strict=True)
            out |= {name: (share * value) ** 2 for name, value in pairs}
    seen = {} if robot.knowledge is None else robot.knowledge.between
    return out | {name: std**2 for name, std in seen.items()}


def of_links(root: Float[Tensor, "R C"], base: BaseParameters, n: int) -> Float[Tensor, "R M"]:
    """Rows over base parameters, and coefficients behind them, as rows over n links' parameters and
    the same coefficients: base parameters are G times those of the links."""
    grouping = base.grouping[: base.n_rigid, : base.n_rigid_parameters]
    links = grouping[:, paper_order(n).argsort()]
    return torch.cat([root[:, : base.n_rigid] @ links, root[:, base.n_rigid :]], 1)


def robust_root(
    table: Float[Tensor, "R C"], rest: Float[Tensor, " R"], block: Int[Tensor, " R"]
) -> Float[Tensor, "D C"]:
    """A root of the inverse covariance of a least-squares fit's coefficients, from the spread of
    whole blocks of rows; nothing along directions that the rows do not determine.

    Blocks may spread less along a direction than independent samples would, by chance where there
    are few; then as much is known as from those, and no more.

    Args:
        table, rest: columns and what the fit leaves, each row in units of what an independent
            sample leaves.
        block: of every row.
    """
    # Coordinates in which independent samples have unit covariance. Directions of which little is
    # known stay, for dropped they would take along all that is mixed with them.
    size = table.norm(dim=0)
    scale = torch.where(size > 0, 1 / size, 0.0)
    _, values, axes = torch.linalg.svd(torch.linalg.qr(table * scale, mode="r").R)
    there = values > NOTHING * values[:1]
    into = scale.unsqueeze(1) * axes[there].T / values[there]
    back = values[there].unsqueeze(1) * axes[there] * size
    fitted = fit_statistics(table @ into, rest, block, variance=1.0)
    spread, mixed = torch.linalg.eigh(fitted.widened())
    return (mixed.T @ back) / spread.clamp(min=1.0).sqrt().unsqueeze(1)


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
    effects = [e for e, _ in columns.model.effects if not e.event]
    names = [name for e in effects for name in known_names(e)]
    # One coefficient of two effects of the same name and place cannot be told by its name.
    once = [k for k, name in enumerate(names) if names.count(name) == 1]
    parts = [columns.regressor.flatten(0, 1)[base.by_link]]
    robot = columns.model.robot
    parts += [
        columns.on_all_joints(e) if (link := e.body(robot)) is None else columns.regressor[link]
        for e in effects
    ]
    left = columns.gap * keep
    # Rows in units of what an independent sample leaves; those far out count as their limit.
    unit = (effective / left.square().sum(1).clamp(min=1e-300)).sqrt()
    weight = huber_weights(left) * unit.unsqueeze(1)
    table = torch.cat(parts).mul_(keep * weight).flatten(1).T
    del parts  # which may be as large
    root = robust_root(table, (left * weight).flatten(), block.repeat(n))
    rms = (left.square().sum(1) / keep.sum(1).clamp(min=1)).sqrt()
    known = Knowledge(
        robot.n_links, tuple(names), of_links(root, base, robot.n_links), (source,), rms
    )
    return known.over([names[k] for k in once]) if len(once) < len(names) else known


def fit_root(
    covariance: Float[Tensor, "B B"],
    factor: Float[Tensor, "C C"],
    rows: float,
    correlation: float,
    wide: float,
) -> Float[Tensor, "D B"]:
    """A root of the inverse of an identification's covariance; nothing of what was not estimated.

    Args:
        covariance: (B, B), from the spread of blocks; 0 of what was not estimated.
        factor: (B + 1, B + 1) R of the weighted rows, the target last.
        rows: how many they are.
        correlation: rows that count as one, of the residual.
        wide: Student's quantile over the normal one: of few blocks.
    """
    out = covariance.new_zeros(0, len(covariance))
    free = (covariance.diagonal() > 0).nonzero().flatten()
    if not len(free):
        return out
    root = torch.linalg.qr(factor[:, free], mode="r").R
    # What independent rows would leave of the covariance is their variance there.
    variance = float(factor[-1, -1].square()) / max(rows - len(free), 1.0)
    spread, mixed = torch.linalg.eigh(root @ covariance[free][:, free] @ root.T * wide**2)
    out = covariance.new_zeros(len(free), len(covariance))
    least = variance * max(1.0, correlation)
    out[:, free] = (mixed.T @ root) / spread.clamp(min=max(least, 1e-300)).sqrt().unsqueeze(1)
    return out


def inflation(
    covariance: Float[Tensor, "B B"], factor: Float[Tensor, "C C"]
) -> Float[Tensor, " B"]:
    """Standard deviations of a fit over those of rows with independent errors of unit size; where
    nothing was estimated, the median of the others.

    Args:
        covariance, factor: as for `fit_root`.
    """
    std = covariance.diagonal().clamp(min=0).sqrt()
    free = (std > 0).nonzero().flatten()
    if not len(free):
        return torch.ones_like(std)
    ratio = std[free] / torch.linalg.vector_norm(orthonormal(factor, free), dim=1)
    out = torch.full_like(std, float(ratio.median()))
    out[free] = ratio
    return out


def over_parameters(
    root: Float[Tensor, "D B"], base: BaseParameters, effects: Sequence[Effect], source: str
) -> Knowledge:
    """Knowledge of base parameters, effects among them, as that of links and coefficients."""
    n = base.n_rigid_parameters // PARAMETERS_PER_LINK
    rows = root @ base.grouping
    links = rows[:, : base.n_rigid_parameters][:, paper_order(n).argsort()]
    names = [name for e in effects for name in known_names(e)]
    return Knowledge(
        n, tuple(names), torch.cat([links, rows[:, base.n_rigid_parameters :]], 1), (source,)
    )


def of_base_parameters(
    known: Knowledge, base: BaseParameters, effects: Sequence[Effect]
) -> Float[Tensor, "R B"]:
    """The inverse of `over_parameters`: a root over base parameters."""
    n = base.n_rigid_parameters // PARAMETERS_PER_LINK
    root = known.over([name for e in effects for name in known_names(e)]).root
    # Parameters in the paper's order, of which the independent ones alone change.
    links = root[:, : known.rigid][:, paper_order(n)]
    return torch.cat([links, root[:, known.rigid :]], 1)[:, list(base.independent)]


def known_coefficients(effects: Iterable[Valued]) -> dict[str, float]:
    """Values of effects' coefficients, by the names by which they are known."""
    return {
        name: value
        for effect, values in effects
        for name, value in zip(known_names(effect), values, strict=True)
    }


def whole_arm(robot: Robot) -> Robot:
    """The arm whose links are with the bodies among its effects, of which a log tells no more than
    their sums: another load or link is told beside them."""
    effects = nominal_effects(robot)
    bodies = [(e, v) for e, v in effects if e.inertial]
    if not bodies or robot.parameters is None:
        return robot
    known = robot.knowledge
    for effect, _ in bodies:
        names = known_names(effect)
        link = effect.body(robot)
        if known is not None and link is not None and set(names) <= set(known.coefficients):
            known = known.merged(names, link)
    rest = tuple(e.record(v) for e, v in effects if not e.inertial)
    return replace(carrying(robot, bodies), effects=rest, knowledge=known)


def load_of(robot: Robot) -> tuple[float, ...]:
    """Ten parameters of the load that `whole_arm` puts into the last link; zeros of none."""
    effects = [] if robot.parameters is None else nominal_effects(robot)
    loads = [v for e, v in effects if isinstance(e, Payload)]
    return tuple(map(sum, zip([0.0] * PARAMETERS_PER_LINK, *loads, strict=True)))


def known_later(robot: Robot) -> Knowledge | None:
    """How sure a robot's model is on the day of another session; None where it does not say."""
    if robot.knowledge is None or robot.parameters is None:
        return None
    return robot.knowledge.aged(between_sessions(robot))


def known_before(
    robot: Robot, base: BaseParameters, effects: Sequence[Effect], *, later: bool = True
) -> tuple[Float[Tensor, "R B"], Float[Tensor, " B"]] | None:
    """What is known of a robot's model: a root over base parameters, and their values. None where
    the model does not say how sure it is.

    Args:
        robot: with its knowledge.
        base, effects: which base parameters.
        later: on the day of another session; else on that of the last one.
    """
    robot = whole_arm(robot)
    known = known_later(robot) if later else robot.knowledge
    if known is None or robot.parameters is None:
        return None
    own = known_coefficients(nominal_effects(robot))
    coefficients = [own.get(name, 0.0) for e in effects for name in known_names(e)]
    rigid = robot.parameters.to_paper_order().double()
    expected = base.project(torch.cat([rigid, rigid.new_tensor(coefficients)]))
    return of_base_parameters(known, base, effects), expected


def pooled(
    before: Float[Tensor, "R B"],
    expected: Float[Tensor, " B"],
    now: Float[Tensor, "D B"],
    values: Float[Tensor, " B"],
) -> tuple[Float[Tensor, " B"], Float[Tensor, "B B"], Bool[Tensor, " B"]]:
    """What was known and what a log says together: values, covariance, and which are determined;
    the others are 0.

    Args:
        before: root of what was known.
        expected: the values then.
        now: root of what the log tells.
        values: that it tells.
    """
    rows = torch.cat([before, now])
    right = torch.cat([before @ expected, now @ values])
    size = rows.norm(dim=0)
    scale = torch.where(size > 0, 1 / size, 0.0)
    u, s, v = torch.linalg.svd(rows * scale, full_matrices=False)
    there = s > NOTHING * s[:1]
    inverse = scale.unsqueeze(1) * v[there].T / s[there]
    determined = (v[there].square().sum(0) > 1 - NOTHING) & (size > 0)
    x = inverse @ (u[:, there].T @ right)
    return x * determined, inverse @ inverse.T * determined * determined.unsqueeze(1), determined
