"""A payload's ten parameters from the logs without and with it: models, estimator, consistency.

A payload moves with the last link, so it adds its ten parameters theta to that link's, and the
rigid base parameters beta become beta + G theta, G being the last link's columns of the grouping
matrix (Gaz and De Luca, IROS 2017). Both logs are one regression: rows of the first of beta and its
effects' coefficients, rows of the second of beta + G theta and coefficients of its own. What a weak
motion leaves open of beta so stays open in theta, where a difference of two sets of base parameters
would take for known what one of the fits had set to zero.

The estimate is least squares on both fits' whitened rows, its covariance P C P' with the block-
robust covariance C of the rows' values and the estimator P. Weighting by C's own inverse would be
far too sure of itself: a jackknife of some thirty blocks holds next to nothing of the inverse of a
43 x 43 matrix (on the 7R with one trajectory, 71 % of the nominal 95 % intervals held the truth).
Directions that one block nearly alone determines are left out: nothing tells how sure they are.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import torch
from scipy.optimize import least_squares
from torch.autograd.functional import jacobian

from torchid.design.bodies import Bodies, nearest_to, triangle
from torchid.identification.base_parameters import BaseParameters
from torchid.identification.result import Identification
from torchid.identification.rows import layout
from torchid.robot.inertia import (
    PARAMETERS_PER_LINK,
    InertialParameters,
    move,
    paper_order,
    pseudo_inertia_basis,
)
from torchid.robot.model import Robot
from torchid.typing import Bool, Float, Tensor

Model = Literal["general", "symmetric", "point_mass"]

_VANISHES = 1e-9
"""Relative size below which a change along a direction, or a variance, counts as none."""


_NUISANCE = 1e-12, 1e-6
"""Noise a combination of base parameters and effects may hide without being taken out of the rows,
and the relative sizes between which that decides."""


_INSIDE, _AT_NO_DISTANCE, _SURE = 1e-8, 1e-7, 1e6
"""Of the nearest consistent body: its least eigenvalue; what directions that are at no distance
count beside it, so that they do not run away; and what those without a variance do."""


@dataclass(frozen=True)
class Evidence:
    """What a log, or a model that knows how sure it is, says of base parameters: rows with errors.

    Attributes:
        rows: (T, B) of unit weight.
        values: (T,) of the rows times the base parameters.
        covariance: (T, T) of the values, from the spread of blocks.
        freedom: degrees of freedom (Q,) of the variances of linear maps (Q, T) of the values.
        held: (B,) coefficients that the fit held at zero.
    """

    rows: Float[Tensor, "T B"]
    values: Float[Tensor, " T"]
    covariance: Float[Tensor, "T T"]
    freedom: Callable[[Tensor], Tensor]
    held: Bool[Tensor, " B"]


def known_rows(
    rows: Float[Tensor, "T B"], values: Float[Tensor, " T"], degrees: float = math.inf
) -> Evidence:
    """Evidence whose errors are independent and of unit size."""

    def freedom(maps: Tensor) -> Tensor:
        return maps.new_full((len(maps),), degrees)

    held = torch.zeros(rows.shape[1], dtype=torch.bool)
    return Evidence(rows, values, torch.eye(len(rows)).to(rows), freedom, held)


def evidence_of(result: Identification) -> tuple[Evidence, ...]:
    """What an identification's own log says, whatever was known before: what many blocks say, and
    apart from it what one block says nearly alone, as if its errors were as large as its torque.

    All columns take part, those too that the fit held at zero or could not tell from others: what
    the rows say is of all of them together.
    """
    order = layout(result.robot, result.base, result.effects).back
    uncertainty, r = result.uncertainty, result.factor
    covariance = uncertainty.covariance[order][:, order]
    undetermined = result.base.mask(result.undetermined)
    free = covariance.diagonal() > 0
    held = ~(free | undetermined)
    own, triangle = torch.linalg.qr(r[:, :-1][:, free])
    if uncertainty.shares is None:
        known = known_rows(
            own.T @ r[:, :-1], own.T @ r[:, -1], float(max(1, uncertainty.blocks - 1))
        )
        spread = triangle @ covariance[free][:, free] @ triangle.T
        return (replace(known, covariance=spread, held=held),)
    # The blocks have the free columns in the layout's order.
    place = order[free].argsort().argsort()
    shares, into = uncertainty.shares, triangle @ uncertainty.shares.back[place]
    # 0.9: share of a direction's information that makes one block's word for it doubtful
    lone = into @ shares.alone(0.9)
    turned = torch.linalg.qr(torch.cat([lone, torch.eye(len(into)).to(into)], 1)).Q
    doubtful, sure = turned.split([lone.shape[1], len(into) - lone.shape[1]], 1)
    steps = shares.steps[:, place] @ triangle.T @ sure
    rows = r.T @ own
    many = Evidence(
        (rows @ sure)[:-1].T, (rows @ sure)[-1], steps.T @ steps,
        lambda maps: shares.freedom(maps @ sure.T @ into), held,
    )  # fmt: skip
    few = (rows @ doubtful).T
    size = few[:, -1].square().mean().sqrt().nan_to_num().clamp(min=1e-300)
    return many, replace(known_rows(few[:, :-1] / size, few[:, -1] / size), held=held)


@dataclass(frozen=True)
class Joint:
    """Both logs as one regression for the payload alone, and what linear maps of them are worth.

    Attributes:
        empty, loaded: evidence without and with the payload; none of the first where the arm is
            exactly known, the others then being of the change.
        design: (T, 10) rows of all for the payload, what else they depend on taken out.
        rest: (T, T) the projection that takes it out.
        scale: (10,) size of the payload's columns before.
    """

    empty: tuple[Evidence, ...]
    loaded: tuple[Evidence, ...]
    design: Float[Tensor, "T 10"]
    rest: Float[Tensor, "T T"]
    scale: Float[Tensor, "10"]

    @property
    def values(self) -> Float[Tensor, " T"]:
        """Values of all parts, without and with the payload."""
        return torch.cat([part.values for part in (*self.empty, *self.loaded)])

    def spread(self, maps: Float[Tensor, "Q T"]) -> tuple[Tensor, Tensor]:
        """Covariance (Q, Q) of linear maps of the values, and its degrees of freedom (Q,)."""
        parts = (*self.empty, *self.loaded)
        covariance, uncertain = maps.new_zeros(len(maps), len(maps)), maps.new_zeros(len(maps))
        for part, own in zip(parts, maps.split([len(p.rows) for p in parts], 1), strict=True):
            added = own @ part.covariance @ own.T
            covariance = covariance + added
            uncertain = uncertain + added.diagonal().square() / part.freedom(own)
        freedom = covariance.diagonal().square() / uncertain.clamp(min=1e-300)
        return covariance, freedom.clamp(min=1.0)


def joint_regression(
    base: BaseParameters,
    columns: Float[Tensor, "B 10"],
    empty: tuple[Evidence, ...],
    loaded: tuple[Evidence, ...],
) -> Joint:
    """Rows of both logs, with base parameters and effects taken out."""
    parts, rigid = (*empty, *loaded), base.n_rigid
    after = torch.cat([part.rows for part in loaded])
    before = torch.cat([after[:0], *(part.rows for part in empty)])
    payload = torch.cat([0 * before @ columns, after @ columns])
    # Each log has coefficients of its own.
    table = torch.block_diag(before[:, rigid:], after[:, rigid:])
    if empty:
        table = torch.cat([torch.cat([before, after])[:, :rigid], table], 1)
    size = table.norm(dim=0)
    taken, sizes, _ = torch.linalg.svd(table[:, size > 0] / size[size > 0], full_matrices=False)
    # A combination whose torque would be lost in the noise, if it were as large as all there is,
    # takes no row along.
    values = torch.cat([part.values for part in parts])
    noise = torch.cat([part.covariance.diagonal() for part in parts]).mean().sqrt()
    # 1e-3: share of the noise that what is left out may make
    lost = float((1e-3 * noise / values.norm().clamp(min=1e-300)).clamp(*_NUISANCE))
    taken = taken[:, sizes > lost * sizes[:1]]
    rest = torch.eye(len(payload)).to(payload) - taken @ taken.T
    return Joint(empty, loaded, rest @ payload, rest, payload.norm(dim=0))


@dataclass(frozen=True)
class Fitted:
    """A payload in the last link's frame, and how it came from the logs.

    Attributes:
        free: (F,) the model's own parameters.
        estimator: (F, T) how they depend on the rows' values, to first order.
        joint: the regression.
        to_parameters: from (F,) to the ten parameters in the last link's frame.
        null: (F, D) directions of `free` that the rows say nothing about.
        wider: by which variances are larger than the rows' errors say.
        gain_std: how well the scale of all torque is known, as a share of it.
    """

    free: Float[Tensor, " F"]
    estimator: Float[Tensor, "F T"]
    joint: Joint
    to_parameters: Callable[[Tensor], Tensor]
    null: Float[Tensor, "F D"]
    wider: float = 1.0
    gain_std: float = 0.0

    def of(
        self, function: Callable[[Tensor], Tensor]
    ) -> tuple[Tensor, Tensor, Tensor, Bool[Tensor, " Q"]]:
        """Value (Q,), covariance (Q, Q; delta method), its degrees of freedom (Q,) and
        determinedness of a function of the ten parameters in the last link's frame."""

        def composed(free: Tensor) -> Tensor:
            return function(self.to_parameters(free))

        slope = jacobian(composed, self.free)
        moved = (slope @ self.null).abs()
        size = slope.abs() @ self.null.abs()
        determined = (moved <= _VANISHES * size.clamp(min=1e-300)).all(-1)
        covariance, freedom = self.joint.spread(slope @ self.estimator)
        # With another scale of the torque all ten have it.
        ten = self.to_parameters(self.free)
        scaled = self.gain_std * (jacobian(function, ten) @ ten)
        covariance = self.wider * covariance + scaled.unsqueeze(1) * scaled
        return composed(self.free), covariance, freedom, determined


def last_link_columns(robot: Robot, base: BaseParameters) -> Float[Tensor, "B 10"]:
    """The last link's columns of the grouping matrix, in torchid's order of the ten."""
    order = paper_order(robot.n_links).argsort()
    return base.grouping[:, order[-PARAMETERS_PER_LINK:]]


def fit_payload(model: Model, robot: Robot, joint: Joint) -> Fitted:
    """Least squares for the model's parameters, with the directions left undetermined set aside."""
    # From the model's parameters to the ten, and where to linearise.
    to_parameters: Callable[[Tensor], Tensor] = torch.clone
    free = joint.design.new_zeros(4 if model == "symmetric" else PARAMETERS_PER_LINK)
    if model == "symmetric":
        to_parameters = partial(_symmetric, robot)
    elif model == "point_mass":
        to_parameters = _point_mass
        free = _point_mass_solution(*_estimator(joint, torch.eye(10).to(free)), joint)
    estimator, null = _estimator(joint, jacobian(to_parameters, free))
    if model != "point_mass":
        free = estimator @ joint.values
    return Fitted(free, estimator, joint, to_parameters, null)


def changes_beside(
    fitted: Fitted, columns: Float[Tensor, "B 10"]
) -> tuple[Tensor, Tensor, Tensor, Bool[Tensor, " B"]]:
    """How base parameters and coefficients differ between the logs beside what the payload makes
    of them: differences (B,), standard deviations, degrees of freedom, and which both logs tell."""
    joint, maps, known = fitted.joint, [], []
    for parts in (joint.empty, joint.loaded):
        held = torch.stack([part.held for part in parts or joint.loaded]).any(0)
        rows = torch.cat([columns.T[:0], *(part.rows for part in parts)]) * ~held
        size = rows.norm(dim=0)
        scale = torch.where(size > 0, 1 / size, 0.0)
        inverse = scale.unsqueeze(1) * torch.linalg.pinv(rows * scale, rtol=1e-8)
        resolved = (inverse @ rows) * scale / scale.unsqueeze(1).clamp(min=1e-300)
        apart = (resolved - torch.eye(len(scale))).abs().amax(1)
        maps.append(inverse)
        # 1e-6: share of others, in units of the columns, below which rows tell a parameter by
        # itself
        known.append((apart < 1e-6) & (size > 0) & ~held)
    slope = jacobian(fitted.to_parameters, fitted.free)
    both = torch.cat([-maps[0], maps[1]], 1)
    change = both @ joint.values - columns @ fitted.to_parameters(fitted.free)
    covariance, freedom = joint.spread(both - columns @ slope @ fitted.estimator)
    return change, covariance.diagonal().clamp(min=0).sqrt(), freedom, known[0] & known[1]


def _estimator(joint: Joint, slope: Float[Tensor, "10 F"]) -> tuple[Tensor, Tensor]:
    """The linear estimator (F, T), least squares and of least norm where the rows leave a choice;
    and the directions (F, D) they leave undetermined. A direction counts by its share of what the
    payload's columns were before all else was taken out."""
    norm = (joint.scale.unsqueeze(1) * slope).norm(dim=0)
    scale = torch.where(norm > 0, 1 / norm, 1.0)
    design = joint.design @ slope * scale
    left, sizes, directions = torch.linalg.svd(design, full_matrices=True)
    # 1e-7: relative size below which the rows do not feel a direction of the payload
    rank = int((sizes > 1e-7).sum())
    basis = scale.unsqueeze(-1) * directions[:rank].T
    estimator = (basis / sizes[:rank]) @ left[:, :rank].T @ joint.rest
    return estimator, scale.unsqueeze(-1) * directions[rank:].T


def _symmetric(robot: Robot, free: Tensor) -> Tensor:
    """Symmetric about the tool's z axis: m, m cz, J across and J along the axis, tool frame."""
    m, h, across, along = free.unbind()
    none = torch.zeros_like(m)
    tool = torch.stack([m, none, none, h, across, none, none, across, none, along])
    return move(tool, robot.tool.to(free))


def _point_mass(free: Tensor) -> Tensor:
    """Mass and position in the last link's frame: all inertia is that of the offset."""
    mass, place = free[:1], free[1:].unsqueeze(0)
    return InertialParameters.from_com(mass, place, free.new_zeros(1, 6)).pi[0]


def _point_mass_solution(
    estimator: Float[Tensor, "10 T"], null: Float[Tensor, "10 D"], joint: Joint
) -> Tensor:
    """Nonlinear least squares from the general payload's mass and centre of mass. A mass that the
    rows do not tell begins at 1 kg, a moment away from zero: without a mass no place matters."""
    general = estimator @ joint.values
    mass = float(general[0])
    place = general[1:4] / mass if mass > 0 else torch.zeros_like(general[1:4])
    open_ = null.abs().sum(1) > _VANISHES * null.abs().sum().clamp(min=1e-300)
    if bool(open_[0]):
        # 0.1: how far from the origin the search for a point of unknown mass begins [m]
        mass, place = 1.0, general[1:4] + 0.1 * open_[1:4]
    # A square factor has the same sums of squares, and no fewer rows than parameters.
    table = torch.cat([joint.design, (joint.rest @ joint.values).unsqueeze(1)], 1)
    r = torch.linalg.qr(torch.cat([table, table.new_zeros(11, 11)]), mode="r").R

    def residual(x: object) -> object:
        return (r[:, :-1] @ _point_mass(torch.as_tensor(x)) - r[:, -1]).numpy()

    def slope(x: object) -> object:
        return (r[:, :-1] @ jacobian(_point_mass, torch.as_tensor(x))).numpy()

    start = torch.cat([general.new_tensor([mass]), place.clamp(-1, 1)]).numpy()
    best = least_squares(residual, start, slope, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return torch.from_numpy(best.x)


def nearest_consistent(
    parameters: Float[Tensor, "10"], covariance: Float[Tensor, "10 10"], null: Float[Tensor, "10 D"]
) -> tuple[Float[Tensor, "10"], float, int]:
    """The physically consistent payload nearest in the metric of the covariance.

    Consistent bodies are those of positive definite pseudo-inertia P, which is linear in the ten
    parameters (Wensing et al. 2018), so the problem is a conic program. The body found is strictly
    inside, its squared distance within about 1e-6 of the least.

    Args:
        parameters: the estimate, in any frame.
        covariance: theirs.
        null: directions that are not determined: free to move along, at no distance.

    Returns:
        The parameters (10,), the squared distance, and in how many directions it was measured.
    """
    # Combinations of the parameters that do not feel `null`, of unit covariance (R, 10).
    std = covariance.diagonal().clamp(min=0).sqrt()
    scale = torch.where(std > 0, std, torch.ones_like(std))
    directions = torch.linalg.svd(null / scale.unsqueeze(-1), full_matrices=True).U
    seen = directions[:, null.shape[1] :].T / scale
    sizes, vectors = torch.linalg.eigh(seen @ covariance @ seen.T)
    kept = sizes > _VANISHES * sizes.max().clamp(min=1e-300)
    whiten = (vectors[:, kept] / sizes[kept].sqrt()).T @ seen
    # Bodies are corrected within the cone as a diagnosis does, in units of order one.
    unit = pseudo_inertia_basis().to(parameters)
    size = torch.einsum("k,kab->ab", parameters, unit).diagonal().abs().sqrt()
    size = size.clamp(min=1e-2 * float(size.max())).clamp(min=1e-9)
    entries = unit / size / size.unsqueeze(-1)
    least = _INSIDE * torch.diag(size.square()).flatten() @ torch.linalg.pinv(unit.flatten(1))
    triangles = torch.from_numpy(triangle(entries.numpy()))
    # Coordinates in which the distance, and what a direction at none does to a body, are one.
    certain = seen.mT @ vectors[:, ~kept] / scale.unsqueeze(-1) ** -2
    others = torch.cat([certain, null], 1)
    others = others / (triangles.T @ others).norm(dim=0).clamp(min=1e-300)
    basis = torch.cat([torch.linalg.pinv(whiten), others], 1)
    metric = torch.ones(len(basis), dtype=basis.dtype)
    metric[len(whiten) :] = _SURE
    metric[len(basis) - null.shape[1] :] = _AT_NO_DISTANCE
    at, start = torch.arange(len(basis)), torch.linalg.solve(basis, parameters - least)
    parts = (start, 0 * start, torch.zeros_like(basis), basis.T @ triangles)
    body = Bodies(at.unsqueeze(0), *(x.unsqueeze(0) for x in parts))
    change = torch.zeros_like(parameters)
    if float(torch.linalg.eigvalsh(torch.einsum("k,kab->ab", parameters, entries))[0]) < _INSIDE:
        change = basis @ torch.from_numpy(
            nearest_to(body, torch.diag(metric).numpy(), 0 * start.numpy())
        )
    return parameters + change, float((whiten @ change).square().sum()), len(whiten)
