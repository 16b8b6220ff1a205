"""A log as triangular factors: all that least squares needs of it, in a few hundred kilobytes.

Torque row i of a robot has columns A_i of its own and torque b_i (see `identification.rows`). Of
each block of neighbouring rows the factor R with R'R = [A_i b_i]'[A_i b_i] is kept, joint by joint
and without weights: joints are weighed when a fit is made, with what all logs say of their noise.
Factors of logs put on top of each other and reduced again are the factor of all their rows, so
sessions, units and the type are fitted without the logs; and blocks, being independent of each
other as rows are not, tell how far the answer can be trusted.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any, TypeVar

import torch

from torchid.design.motion import measurements
from torchid.fleet.model import FleetModel
from torchid.identification.base_parameters import nominal_values, physical_signs
from torchid.identification.least_squares import (
    block_factors,
    combined_factor,
    contaminated_columns,
    orthonormal,
    solve,
    stacked_factor,
    undetermined_columns,
)
from torchid.identification.logs import prepared
from torchid.identification.rows import Layout, RowSource
from torchid.log.model import Log
from torchid.statistics.autocorrelation import correlation_instants
from torchid.statistics.blocks import MOST_BLOCKS as MOST_BLOCKS_OF_A_FIT
from torchid.statistics.blocks import block_length, block_numbers
from torchid.statistics.criteria import EXPLAINED, ODD_SIZE
from torchid.statistics.jackknife import jackknife
from torchid.typing import Bool, Float, Int, Tensor

STRETCH = 600.0
"""Length of what is taken from a long log at a time, as a trajectory of its own [s]."""

MOST_BLOCKS = 30
"""Blocks kept of a stretch: with ten more than twenty, Student's quantile is within 2 % of the
normal one's, and a log of a minute is two megabytes."""


FAR_FROM_PHYSICAL = 5.0
"""Standard deviations beyond which a value that no body has is worth a word: at less, what the
model lacks is reason enough."""


_T = TypeVar("_T")


@dataclass(frozen=True, eq=False)
class Factors:
    """Triangular factors of K blocks of rows.

    Attributes:
        blocks: per joint (K, c + 1, c + 1), unweighted, the torque behind the joint's c columns.
        rows: (K, n) rows that they hold.
    """

    blocks: tuple[Float[Tensor, "K _ _"], ...]
    rows: Int[Tensor, "K n"]

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled without the zeros below the diagonals, which are half of it."""
        upper = [r[:, *torch.triu_indices(*r.shape[1:])] for r in self.blocks]
        return _unpacked, (upper, [r.shape for r in self.blocks], self.rows)

    @property
    def whole(self) -> "Factors":
        """All rows as one block."""
        total = self.rows.sum(0, keepdim=True)
        return Factors(tuple(stacked_factor([*r]).unsqueeze(0) for r in self.blocks), total)

    def fewer(self, most: int) -> "Factors":
        """No more than `most` blocks, neighbours put together."""
        count = len(self.rows)
        if count <= most:
            return self
        groups = (torch.arange(count) * most // count).unique_consecutive(return_counts=True)[1]
        parts = [r.split(groups.tolist()) for r in self.blocks]
        blocks = [torch.stack([stacked_factor([*p]) for p in own]) for own in parts]
        rows = torch.stack([own.sum(0) for own in self.rows.split(groups.tolist())])
        return Factors(tuple(blocks), rows)

    def beside(self, other: "Factors") -> "Factors":
        """The blocks of both."""
        pairs = zip(self.blocks, other.blocks, strict=True)
        blocks = tuple(torch.cat(pair) for pair in pairs)
        return Factors(blocks, torch.cat([self.rows, other.rows]))


def _unpacked(upper: Sequence[Tensor], shapes: Sequence[torch.Size], rows: Tensor) -> Factors:
    """Factors from the upper triangles (K, c (c + 1) / 2) of their blocks, and these shapes."""
    blocks = [torch.zeros(shape, dtype=torch.float64) for shape in shapes]
    for block, packed in zip(blocks, upper, strict=True):
        block[:, *torch.triu_indices(*block.shape[1:])] = packed
    return Factors(tuple(blocks), rows)


def tree(parts: Iterable[_T], combine: Callable[[_T, _T], _T]) -> _T:
    """All parts combined in pairs, and the pairs in pairs: an order that their number alone
    decides, whoever made the parts and when. Of N parts no more than log2 N are held."""
    held: list[tuple[int, _T]] = []
    for part in parts:
        held.append((1, part))
        while len(held) > 1 and held[-1][0] == held[-2][0]:
            (_, b), (size, a) = held.pop(), held.pop()
            held.append((2 * size, combine(a, b)))
    while len(held) > 1:
        (_, b), (size, a) = held.pop(), held.pop()
        held.append((size, combine(a, b)))
    return held[0][1]


def combined(a: Factors, b: Factors) -> Factors:
    """Two factors of one block each as one."""
    pairs = zip(a.blocks, b.blocks, strict=True)
    blocks = tuple(stacked_factor([x[0], y[0]]).unsqueeze(0) for x, y in pairs)
    return Factors(blocks, a.rows + b.rows)


@dataclass(frozen=True, eq=False)
class Solved:
    """Weighted least squares on factors, columns in the layout's order.

    Attributes:
        x: (B,) coefficients; 0 where undetermined.
        held: (B,) undetermined by these rows.
        noise: (n,) standard deviation of each joint's residual [N m; N]; nan without rows.
        factor: (B + 1, B + 1) R of the weighted rows.
    """

    x: Float[Tensor, " B"]
    held: Bool[Tensor, " B"]
    noise: Float[Tensor, " n"]
    factor: Float[Tensor, "C C"]


@dataclass(frozen=True, eq=False)
class Reduced:
    """A log as the factors of its normal equations.

    Attributes:
        factors: of its blocks.
        fit: of all its rows.
        left: (n,) what bodies leave of each joint's torque in the worst stretch, as a share of its
            spread.
        seconds: of motion that they hold.
        correlation: integrated autocorrelation time of the residual, the longest [s].
        warnings: sentences for the user.
    """

    factors: Factors
    fit: Solved
    left: Float[Tensor, " n"]
    seconds: float
    correlation: float
    warnings: tuple[str, ...]


def reduce_log(model: FleetModel, stretches: Iterator[Log]) -> Reduced:
    """The factors of a log that comes in stretches, each of which is reduced on its own; memory
    does not grow with the log.

    Raises:
        LogError: a log that cannot be used with this robot.
    """
    found, fits, left = list[Factors](), list[Solved](), list[Tensor]()
    seconds, slowest, warnings = 0.0, 0.0, dict[str, None]()
    for stretch in stretches:
        even, noticed = prepared(with_gain(stretch, model), model.robot)
        speed = torch.full((model.robot.n,), model.settings.reversal, dtype=torch.float64)
        measured = measurements(even, model.settings.cutoff, speed)
        source = RowSource(measured, model.layout, moving_only=model.settings.rows == "moving")
        factors, fit, share, correlation = _blocks(source, model.layout)
        found.append(factors)
        fits.append(fit)
        left.append(share)
        seconds += sum(m.samples / m.rate for m in measured)
        slowest = max(slowest, correlation * max(source.interval))
        said = (*noticed, *(w for m in measured for w in m.warnings))
        warnings |= dict.fromkeys(said)
    every = reduce(Factors.beside, found)
    whole = fits[0] if len(fits) == 1 else solved(every, model.layout)
    return Reduced(every, whole, torch.stack(left).amax(0), seconds, slowest, tuple(warnings))


def bodies_explain(model: FleetModel, reduced: Reduced) -> bool:
    """Whether a log's own fit leaves no fault to look for that would stop it: bodies explain the
    torque of all joints, the coefficients have signs that bodies have, or the robot's file, and
    together they are about as heavy as the nominal ones. A torque of another sign, order, time or
    unit fails one of these.
    """
    layout, fit, robot = model.layout, reduced.fit, model.robot
    # Half of what the doctor takes for explained: up to that a fault is a doubt, worth its word.
    if robot.parameters is None or bool((reduced.left > EXPLAINED / 2).any()):
        return False
    order, free = list(layout.order), (~fit.held).nonzero().flatten()
    nominal = nominal_values(robot, layout.base)[order]
    signs = physical_signs(layout.base, layout.effects)[order]
    signs = torch.where(signs * nominal < 0, 0, signs)[free]  # published friction may be negative
    std = torch.linalg.vector_norm(orthonormal(fit.factor, free), dim=1)
    if bool((signs * fit.x[free] < -FAR_FROM_PHYSICAL * std).any()):
        return False
    bodies = torch.tensor(order) < layout.base.n_rigid
    both = torch.stack([fit.x, nominal], 1) * bodies[:, None]
    size, usual = torch.linalg.vector_norm(fit.factor[:, :-1] @ both, dim=0).tolist()
    return usual / ODD_SIZE < size < usual * ODD_SIZE


def with_gain(log: Log, model: FleetModel) -> Log:
    """A log of currents with the torques that the gains make of them, where they are given."""
    if model.gain is None or log.current is None:
        return log
    return log.with_torque(model.gain)


def _blocks(source: RowSource, layout: Layout) -> tuple[Factors, Solved, Tensor, float]:
    """Factors of blocks as long as the residual asks for, the fit of all rows, (n,) its residual as
    a share of the torque's spread, and its correlation time [instants]."""
    pieces = list(source)
    augmented = [torch.cat(parts) for parts in zip(*(p.augmented for p in pieces), strict=True)]
    keep = torch.cat([p.keep for p in pieces])
    # What rows leave beside their own fit tells how long they remember.
    bounds = [slice(a, b) for a, b in zip(source.boundaries, source.boundaries[1:], strict=False)]
    least = -(-source.instants // MOST_BLOCKS)
    blocks = _reduced(augmented, keep, block_numbers(bounds, least))
    fit = solved(blocks, layout)
    parts = zip(augmented, layout.columns, strict=True)
    residual = torch.stack([a[:, -1] - a[:, :-1] @ fit.x[list(c)] for a, c in parts], -1) * keep
    torque = [a[k, -1] for a, k in zip(augmented, keep.T, strict=True)]
    spread = torch.stack([(t - t.mean()).norm() for t in torque])
    left = torch.linalg.vector_norm(residual, dim=0) / spread.clamp(min=1e-100)
    correlation = correlation_instants(residual, bounds)
    if (length := block_length(source.instants, correlation)) > least:
        blocks = _reduced(augmented, keep, block_numbers(bounds, length))
    return blocks, fit, left, correlation


def _reduced(
    augmented: Sequence[Float[Tensor, "I _"]], keep: Bool[Tensor, "I n"], block: Int[Tensor, " I"]
) -> Factors:
    """Factors of the kept rows of each block."""
    count = int(block.max()) + 1
    rows = torch.stack([torch.bincount(block[k], minlength=count) for k in keep.T], -1)
    out = []
    for own, kept, held in zip(augmented, keep.T, rows.T, strict=True):
        out.append(block_factors(own[kept].split(held.tolist())))
    return Factors(tuple(out), rows)


def solved(factors: Factors, layout: Layout) -> Solved:
    """All rows fitted, each joint's weighing by the inverse of what it leaves."""
    one = factors if len(factors.rows) == 1 else factors.whole
    r = [block[0] for block in one.blocks]
    none = torch.zeros(layout.size, dtype=torch.bool)
    held = undetermined_columns(combined_factor(r, layout.columns, layout.size), none)
    count = one.rows[0].to(torch.float64)
    weight = torch.ones(len(r), dtype=torch.float64)
    # 4: times that the weights of the joints are found again
    for _ in range(4):
        scaled = [w * f for w, f in zip(weight.tolist(), r, strict=True)]
        factor = combined_factor(scaled, layout.columns, layout.size)
        x, _ = solve(factor, none, held)
        pairs = zip(r, layout.columns, strict=True)
        left = [torch.linalg.vector_norm(f[:, :-1] @ x[list(c)] - f[:, -1]) for f, c in pairs]
        # A joint's share of the coefficients is what its columns share with all rows'.
        spare = (count - _spent(r, weight, factor, held, layout)).clamp(min=1.0)
        noise = torch.stack(left) / spare.sqrt()
        known = noise[count > 0]
        # 1e-6: noise of a joint as a share of the noisiest one's below which it gains no more
        # weight
        least = 1e-6 * float(known.max()) if len(known) else 0.0
        weight = torch.where(count > 0, 1 / noise.clamp(min=max(least, 1e-300)), 0.0)
    return Solved(x, held, torch.where(count > 0, noise, torch.nan), factor)


def _spent(
    r: Sequence[Tensor], weight: Tensor, factor: Tensor, held: Tensor, layout: Layout
) -> Float[Tensor, " n"]:
    """Degrees of freedom that the fit takes from each joint: the trace of its rows' part of the hat
    matrix."""
    free = (~held).nonzero().flatten()
    inverse = orthonormal(factor, free)
    spent = []
    for w, f, c in zip(weight.tolist(), r, layout.columns, strict=True):
        wide = f.new_zeros(len(f), layout.size)
        wide[:, list(c)] = w * f[:, :-1]
        spent.append((wide[:, free] @ inverse).square().sum())
    return torch.stack(spent)


@dataclass(frozen=True, eq=False)
class Estimate:
    """Base parameters of a session (or of more), in the order of `base.names`.

    Attributes:
        values: (B,); nan where these rows do not determine a parameter, or only in a sum.
        covariance: (B, B) by the block jackknife; 0 where a value is nan.
        freedom: (B,) degrees of freedom of the variances.
        noise: (n,) what each joint leaves [N m; N].
        blocks: number of blocks.
    """

    values: Float[Tensor, " B"]
    covariance: Float[Tensor, "B B"]
    freedom: Float[Tensor, " B"]
    noise: Float[Tensor, " n"]
    blocks: int

    @property
    def std(self) -> Float[Tensor, " B"]:
        """Standard deviations; nan where there is no value."""
        return torch.where(
            self.values.isnan(), torch.nan, self.covariance.diagonal().clamp(min=0).sqrt()
        )


def estimate(factors: Factors, model: FleetModel) -> Estimate:
    """The fit of all blocks, with covariances that hold for autocorrelated residuals."""
    layout = model.layout
    factors = factors.fewer(MOST_BLOCKS_OF_A_FIT)
    found = solved(factors, layout)
    free = (~found.held).nonzero().flatten()
    # Coordinates in which the fitted columns are orthonormal: no digits are lost to squares.
    inverse = orthonormal(found.factor, free)
    count = len(factors.rows)
    hessians = torch.zeros(count, len(free), len(free), dtype=torch.float64)
    gradients = torch.zeros(count, len(free), dtype=torch.float64)
    for r, c, noise in zip(factors.blocks, layout.columns, found.noise.tolist(), strict=True):
        if noise != noise:
            continue
        wide = r.new_zeros(*r.shape[:2], layout.size)
        wide[:, :, list(c)] = r[:, :, :-1] / noise
        left = r[:, :, -1] / noise - wide @ found.x
        z = wide[:, :, free] @ inverse
        hessians += z.transpose(1, 2) @ z
        gradients += (z.transpose(1, 2) @ left.unsqueeze(-1)).squeeze(-1)
    spread = jackknife(hessians, gradients, variance=1.0, combinations=inverse)
    # Estimates of sums with undetermined parameters are none of the parameter.
    estimated = ~(found.held | contaminated_columns(found.factor[:, :-1], found.held))
    covariance = torch.zeros(layout.size, layout.size, dtype=torch.float64)
    covariance[free.unsqueeze(-1), free] = spread.covariance
    covariance = covariance * estimated * estimated.unsqueeze(-1)
    freedom = torch.ones(layout.size, dtype=torch.float64)
    freedom[free] = spread.freedom
    order = layout.back
    return Estimate(
        torch.where(estimated, found.x, torch.nan)[order],
        covariance[order][:, order],
        freedom[order],
        found.noise,
        spread.blocks,
    )


def in_stretches(log: Log, seconds: float = STRETCH) -> Iterator[Log]:
    """Trajectories of a log, long ones in parts of about equal length."""
    for part in log.trajectories():
        count = max(1, round(part.duration[0] / seconds))
        length = -(-part.samples // count)
        for k in range(count):
            rows = part.select(slice(k * length, (k + 1) * length))
            yield rows if count == 1 else replace(rows, names=(f"{part.names[0]} part {k + 1}",))
