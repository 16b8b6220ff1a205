"""Base parameters: which combinations of parameters the torque depends on (section 2.2).

The regressor of many random states, with the columns of the chosen effects behind it, is reduced
by QR from left to right. A column whose diagonal entry of R vanishes is a combination of those
before it (see `independent_columns`), so their order says which parameters stand for the others:

    report          masses, first moments, inertias: the paper's order, and its tables;
    conditioned     inertias, first moments, masses, then exchanged where that tells more apart.

Masses act through lengths only: with a mass in front, small lengths stand in the denominators of
what is grouped to it (m3 - 10 J2zz), and the columns that are left are nearly parallel. With the
inertias in front, lengths are factors, the groupings those of Gautier and Khalil (IEEE Trans.
Robotics and Automation 6(3), 1990), and nothing depends on the random states. Link frames oblique
to the joint axes need the exchange.

With the independent columns first, [Y1 Y2] = Q [R1 R2] and Y2 = Y1 K with K = R1^-1 R2, so that

    Y pi = Y1 (pi_1 + K pi_2):     base parameters = G pi,   G = [1 K] with columns put back.

This is the robot's structure: it uses random states, not the log. What a log excites is a matter
of the fit (see `least_squares`).
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import compress

import torch

from torchid.dynamics.regressor import regressor
from torchid.effects.base import Effect, Motion
from torchid.effects.registry import nominal_columns
from torchid.errors import IdentificationError
from torchid.robot.inertia import (
    PARAMETERS_PER_LINK,
    InertialParameters,
    paper_order,
    parameter_names,
    parameter_units,
    symmetric,
)
from torchid.robot.model import Basis, JointType, Robot
from torchid.typing import Bool, Float, Int, Tensor


def independent_columns(
    matrix: Float[Tensor, "R C"], tolerance: float
) -> tuple[Bool[Tensor, " C"], Float[Tensor, " C"]]:
    """Columns that are not combinations of independent columns before them.

    Plain QR decides by the diagonal of R, but the entries behind a dependent column cannot be
    trusted: what rounding (or a twist of 1.5708) leaves of that column takes up a direction that a
    later column needs. So the first dependent column is removed and the rest factorised again. A
    column that is itself no more than such a residue must not be scaled up to a column of its own.

    Args:
        matrix: (R, C); columns are scaled to length one here.
        tolerance: distance, relative to a column's length, below which it counts as dependent; and
            length, relative to the longest column, below which it counts as zero.

    Returns:
        mask: (C,) independent columns.
        distance: (C,) relative distance of each column from the span of those kept before it; 0
            for one that counts as zero.
    """
    length = torch.linalg.vector_norm(matrix, dim=0)
    mask = length > tolerance * length.max().clamp(min=1e-300)
    distance = torch.zeros_like(length)
    columns = mask.nonzero().flatten()
    rest = torch.linalg.qr(matrix[:, columns] / length[columns], mode="r").R
    while len(columns):
        diagonal = columns.new_zeros(len(columns), dtype=length.dtype)
        diagonal[: len(rest)] = rest.diagonal().abs()
        bad = (diagonal < tolerance).nonzero().flatten()
        k = int(bad[0]) if len(bad) else len(columns) - 1
        distance[columns[: k + 1]] = diagonal[: k + 1]
        if len(bad):
            mask[columns[k]] = False
        kept_rows = k if len(bad) else k + 1
        columns, rest = columns[k + 1 :], rest[kept_rows:, k + 1 :]
        if len(columns):
            rest = torch.linalg.qr(rest, mode="r").R if len(rest) else rest
    return mask, distance


RANK_TOLERANCE = 1e-4
"""Relative size below which a diagonal entry of R counts as zero. Kept entries are of order 1e-2
and above on the arms tried, dropped ones 1e-15; twists written as 1.5708 for pi/2 make 1e-5."""


@dataclass(frozen=True)
class BaseParameters:
    """The base parameters of a robot with a set of effects.

    Attributes:
        names: (B,) readable sums, e.g. `m3 + m4 - 5 m3c3y`.
        units: (B,).
        parameter_names: (P,) all parameters: the paper's 10 L, then the effects' coefficients.
        independent, dependent: indices into the P parameters.
        grouping: (B, P) matrix G, base = G parameters.
        basis: how the independent ones were chosen.
        rank_gap: (smallest kept, largest dropped) diagonal entry of R, columns scaled to 1.
        n_rigid_parameters: how many of the P parameters belong to the rigid body.
        n_rigid: how many of the base parameters belong to it (effects' own follow).
        warnings: sentences for the user.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    parameter_names: tuple[str, ...]
    independent: tuple[int, ...]
    dependent: tuple[int, ...]
    grouping: Float[Tensor, "B P"]
    basis: Basis
    rank_gap: tuple[float, float]
    n_rigid_parameters: int
    n_rigid: int
    warnings: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.independent)

    def project(self, parameters: Float[Tensor, "*batch P"]) -> Float[Tensor, "*batch B"]:
        """Values of the base parameters for full parameter vectors (..., P)."""
        return parameters @ self.grouping.to(parameters).T

    def absorbed_effects(self) -> list[str]:
        """Effect coefficients that are part of a rigid base parameter, e.g. Ia1 of J1zz + ..."""
        rigid = self.n_rigid_parameters
        return [self.parameter_names[k] for k in self.dependent if k >= rigid]

    @property
    def by_link(self) -> list[int]:
        """Numbers, link by link as regressors have them, of the parameters that stand for the rigid
        base parameters, which are numbered by kind."""
        order = paper_order(self.n_rigid_parameters // PARAMETERS_PER_LINK)
        return order[list(self.independent[: self.n_rigid])].tolist()

    def named(self, mask: Bool[Tensor, " B"]) -> tuple[str, ...]:
        """Names of some."""
        return tuple(compress(self.names, mask.tolist()))

    def mask(self, names: Collection[str]) -> Bool[Tensor, " B"]:
        """Which of them have these names."""
        return torch.tensor([name in names for name in self.names], dtype=torch.bool)

    def is_single(self, position: int) -> bool:
        """Whether base parameter `position` is one parameter, not a sum of several."""
        return int(visible(self.grouping[position]).sum()) == 1


def visible(grouping: Float[Tensor, "*rows P"]) -> Bool[Tensor, "*rows P"]:
    """Which coefficients of a grouping its names show."""
    size = grouping.abs()
    # 1e-4: coefficients of a grouping below this share of its largest are not shown in its name:
    # they come from twists written with a few digits, not from the robot's structure
    return size > 1e-4 * size.amax(-1, keepdim=True)


def base_parameters(
    robot: Robot,
    effects: Sequence[Effect] = (),
    *,
    basis: Basis | None = None,
    seed: int = 0,
    samples: int | None = None,
) -> BaseParameters:
    """The robot's base parameters, by QR of the regressor at random states.

    Args:
        robot: kinematics and gravity; its masses are not used.
        effects: linear effects whose coefficients are identified too, after the rigid body.
        basis: which of them stand for the others; the robot's own choice if None. The torque is
            the same.
        seed: of the random states; the answer does not depend on it.
        samples: number of random states; 60 n + 60 by default, six rows a column.

    Raises:
        IdentificationError: the robot's torque depends on no parameter at all.
    """
    motion = random_states(robot, seed, samples)
    y = stacked_regressor(robot, effects, motion)
    names = parameter_names(robot.n_links) + coefficient_names(effects)
    units = all_units(robot.n_links, robot.joint_types, effects)
    rigid = PARAMETERS_PER_LINK * robot.n_links
    basis = robot.basis if basis is None else basis
    return group_columns(y, names, units, n_rigid_parameters=rigid, basis=basis)


def nominal_values(robot: Robot, base: BaseParameters) -> Float[Tensor, " B"]:
    """Base parameters (B,) of the robot's nominal parameters and effects; an effect that the
    robot's description does not list counts as absent.

    Raises:
        RobotError: the robot has no nominal parameters.
    """
    pairs = nominal_columns(robot)
    own = [value for _, values in pairs for value in values]
    known = dict(zip(coefficient_names([e for e, _ in pairs]), own, strict=True))
    names = base.parameter_names[base.n_rigid_parameters :]
    coefficients = torch.tensor([known.get(name, 0.0) for name in names], dtype=torch.float64)
    rigid = robot.require_parameters("its base parameters").to_paper_order().double()
    return base.project(torch.cat([rigid, coefficients]))


def all_units(links: int, types: Sequence[JointType], effects: Sequence[Effect]) -> list[str]:
    """Units (P,) of all parameters of a robot of so many links with these joints: the links', then
    the effects'."""
    return parameter_units(links) + [
        c.unit_for(types[e.joints[0]] is JointType.PRISMATIC)
        for e in effects
        for c in e.coefficients
    ]


def coefficient_names(effects: Sequence[Effect]) -> list[str]:
    """Names of the coefficients, e.g. `Fv3`; with the effect's where effects of two kinds have the
    same, e.g. `cogging.a_s3`."""
    kinds: dict[str, set[str]] = {}
    for effect in effects:
        for name in effect.coefficient_names():
            kinds.setdefault(name, set()).add(effect.name)
    return [
        name if len(kinds[name]) == 1 else f"{effect.name}.{name}"
        for effect in effects
        for name in effect.coefficient_names()
    ]


def random_states(robot: Robot, seed: int = 0, samples: int | None = None) -> Motion:
    """Random q in +-pi, dq in +-2, ddq in +-5 (m, s): (samples, n) each, on the CPU; with t up to
    10 000 s, and torques of all sizes from 0.1 to 1000 that belong to no model."""
    generator = torch.Generator().manual_seed(seed)
    shape = (samples or 60 * robot.n + 60, robot.n)
    q, dq, ddq = (
        (2 * torch.rand(shape, generator=generator, dtype=torch.float64) - 1) * scale
        for scale in (torch.pi, 2.0, 5.0)
    )
    drawn = torch.rand((*shape, 2), generator=generator, dtype=torch.float64)
    torque = torch.sign(drawn[..., 0] - 0.5) * 10 ** (4 * drawn[..., 1] - 1)
    t = 10 ** (4 * torch.rand(shape[0], generator=generator, dtype=torch.float64))
    return Motion(q, dq, ddq, t=t, torque=torque)


def stacked_regressor(
    robot: Robot, effects: Sequence[Effect], motion: Motion
) -> Float[Tensor, "R P"]:
    """Regressor and effect columns of M states, stacked to (M n, P) (eq. 2.19)."""
    rigid = regressor(robot, *motion.state)
    columns = [effect.torque_columns(motion, robot) for effect in effects]
    return torch.cat([rigid, *columns], -1).flatten(0, 1)


def group_columns(
    y: Float[Tensor, "R P"],
    names: Sequence[str],
    units: Sequence[str],
    *,
    n_rigid_parameters: int,
    basis: Basis = "report",
) -> BaseParameters:
    """Base parameters from a stacked regressor: which columns are independent, and the grouping."""
    order = torch.arange(y.shape[1])
    if basis == "conditioned":
        n = n_rigid_parameters // PARAMETERS_PER_LINK
        masses, moments, inertias, rest = order.tensor_split([n, 4 * n, 10 * n])
        order = torch.cat([inertias, moments, masses, rest])
    kept, diagonal = torch.zeros(len(order), dtype=torch.bool), y.new_zeros(len(order))
    kept[order], diagonal[order] = independent_columns(y[:, order], RANK_TOLERANCE)
    if not bool(kept.any()):
        raise IdentificationError("the torque of this robot depends on no inertial parameter.")
    chosen = kept.clone()
    if basis == "conditioned":
        rigid = slice(n_rigid_parameters)
        chosen[rigid] = _exchanged(y[:, rigid], kept[rigid])
    independent, dependent = chosen.nonzero().flatten(), (~chosen).nonzero().flatten()
    r = torch.linalg.qr(y[:, torch.cat([independent, dependent])], mode="r").R
    b = len(independent)
    k = torch.linalg.solve_triangular(r[:b, :b], r[:b, b:], upper=True)
    # Rounding removed where it is plainly rounding: entries within 1e-9 of 0 or of +-1.
    for value in (0.0, 1.0, -1.0):
        k = torch.where((k - value).abs() < 1e-9, torch.full_like(k, value), k)
    grouping = y.new_zeros(b, y.shape[1])
    grouping[torch.arange(b), independent] = 1.0
    grouping[:, dependent] = k
    # What an exchange does not change: how clear the rank is.
    gap = (float(diagonal[kept].min()), float(diagonal[~kept].max()) if len(dependent) else 0.0)
    warnings: tuple[str, ...] = ()
    # 1e3: ratio of neighbouring singular values that separates a rank from rounding
    if gap[1] > 0 and gap[0] / gap[1] <= 1e3:
        weakest = names[int(torch.where(kept, diagonal, torch.inf).argmin())]
        strongest = names[int(torch.where(kept, -torch.inf, diagonal).argmax())]
        warnings = (
            f"the number of base parameters is not clear-cut: {weakest} was kept with "
            f"{gap[0]:.1e}, {strongest} dropped with {gap[1]:.1e}",
        )
    return BaseParameters(
        names=tuple(
            _sum_name(row, names, int(i)) for row, i in zip(grouping, independent, strict=True)
        ),
        units=tuple(units[i] for i in independent),
        parameter_names=tuple(names),
        independent=tuple(independent.tolist()),
        dependent=tuple(dependent.tolist()),
        grouping=grouping,
        basis=basis,
        rank_gap=gap,
        n_rigid_parameters=n_rigid_parameters,
        n_rigid=int((independent < n_rigid_parameters).sum()),
        warnings=warnings,
    )


def _exchanged(y: Float[Tensor, "R C"], kept: Bool[Tensor, " C"]) -> Bool[Tensor, " C"]:
    """Independent columns (C,) of which none has more than a bounded share in any other column, by
    exchanging those that have (M. Gu, S. Eisenstat, SIAM J. Sci. Comput. 17(4), 1996). Every
    exchange multiplies the volume of the independent columns by that share, so it ends."""
    length = torch.linalg.vector_norm(y, dim=0)
    # Columns that count as zero are rounding, which must not be scaled up.
    seen = length > RANK_TOLERANCE * length.max()
    scaled = torch.where(seen, y / length.clamp(min=1e-300), 0.0)
    factor = torch.linalg.qr(scaled, mode="r").R
    inside, outside = kept.nonzero().flatten(), (~kept).nonzero().flatten()
    b = len(inside)
    while b and len(outside):
        r = torch.linalg.qr(factor[:, torch.cat([inside, outside])], mode="r").R
        share = torch.linalg.solve_triangular(r[:b, :b], r[:b, b:], upper=True).abs()
        # 2.0: share of an independent column in a dependent one, both of length one, above which
        # the two are exchanged. Arms whose link frames have an axis along the joint's stay below
        # 1.5.
        if float(share.max()) <= 2.0:
            break
        i, j = divmod(int(share.argmax()), len(outside))
        inside[i], outside[j] = outside[j].clone(), inside[i].clone()
    out = torch.zeros_like(kept)
    out[inside] = True
    return out


def _sum_name(row: Tensor, names: Sequence[str], lead: int) -> str:
    """`m3 + m4 - 5 m3c3y`, the independent parameter first, then by index."""
    order = [lead] + [k for k in visible(row).nonzero().flatten().tolist() if k != lead]
    text = ""
    for k in order:
        # Upwards from the middle, as rounding alone would decide between 0.0068062 and 0.0068063
        # for the square of 0.0825, and a result is known again by its names.
        value = float(row[k]) * (1 + 1e-9)
        size = "" if (number := f"{abs(value):.5g}") == "1" else f"{number} "
        sign = ("-" if value < 0 else "") if not text else (" - " if value < 0 else " + ")
        text += f"{sign}{size}{names[k]}"
    return text


def non_negative(base: BaseParameters, effects: Sequence[Effect]) -> Bool[Tensor, " B"]:
    """Base parameters (B,) that are one coefficient which physics forbids to be negative."""
    rigid = [False] * base.n_rigid_parameters
    bounded = [*rigid, *(c.non_negative for e in effects for c in e.coefficients)]
    return torch.tensor([bounded[k] and base.is_single(b) for b, k in enumerate(base.independent)])


def physical_signs(base: BaseParameters, effects: tuple[Effect, ...]) -> Int[Tensor, " B"]:
    """(B,) 1 for base parameters that are never negative, -1 for those that are never positive, 0
    where bodies with either sign exist. Entries of the grouping that its names do not show do not
    count.

    A body's mass, first moment h and second moment Sigma = tr(J)/2 E - J make up its pseudo-inertia
    [[Sigma, h], [h', m]], which is positive semidefinite for every body, and can be any such matrix
    (P. Wensing, S. Kim, J.-J. Slotine, IEEE RA-L 3(1), 2018). A sum a m + b'h + sum c_ij J_ij is
    therefore never negative if, and only if, the matrix D of the same sum, <D, pseudo-inertia>, is
    positive semidefinite as well: the cone is its own dual. E.g. J1zz + J2yy + Ia1 is never
    negative, and J2xx - J2yy - J2zz, minus twice the second moment along x, never positive.

    >>> from torchid import load_robot
    >>> from torchid.identification.base_parameters import base_parameters
    >>> base = base_parameters(load_robot("3r"))
    >>> int(physical_signs(base, ())[base.names.index("J3zz")])
    1
    """
    rows = torch.where(visible(base.grouping), base.grouping, 0.0)
    bounded = torch.tensor([c.non_negative for e in effects for c in e.coefficients]).bool()
    never_negative, never_positive = (_dual(s * rows, base, bounded) for s in (1, -1))
    return never_negative.int() - never_positive.int()


def _dual(rows: Float[Tensor, "B P"], base: BaseParameters, bounded: Tensor) -> Tensor:
    """(B,) whether a sum is non-negative for all bodies and coefficients."""
    rigid, rest = rows.tensor_split([base.n_rigid_parameters], 1)
    a, b, c = InertialParameters.from_paper_order(rigid).pi.split([1, 3, 6], -1)
    # J_xx = Sigma_yy + Sigma_zz and J_xy = -Sigma_xy, the latter twice in <D, pseudo-inertia>.
    j = symmetric(c * c.new_tensor([1, 0.5, 0.5, 1, 0.5, 1]))
    trace = j.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    second = trace * torch.eye(3).to(j) - j
    upper = torch.cat([second, b.unsqueeze(-1) / 2], -1)
    lower = torch.cat([b / 2, a], -1).unsqueeze(-2)
    least = torch.linalg.eigvalsh(torch.cat([upper, lower], -2))[..., 0].amin(-1)
    coefficients = torch.where(bounded, rest >= 0, rest == 0).all(-1)
    # 1e-6: rounding, over the row's largest entry
    return (least >= -1e-6 * rows.abs().amax(-1)) & coefficients
