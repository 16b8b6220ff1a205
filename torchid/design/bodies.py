"""Least squares of which some coefficients are corrections of bodies' inertial parameters.

    x'Hx - 2 b'x + sum_k x_k^2 / sigma_k^2 + sum_bodies tr((R^-1 P(x))^2) / sigma^2,  P(p + x) >= 0

P is a body's pseudo-inertia [[S, m c], [m c', m]], linear in its ten parameters, and positive
definite of bodies alone. The metric is that of Lee, Wensing and Park (2020) at a reference R: the
squared relative change of a body, which depends on no frame. What least squares leave a body is the
solution; else a conic program is solved (Clarabel, Goulart and Chen 2024).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import clarabel  # type: ignore[import-untyped]
import numpy as np
import torch
from scipy import sparse

from torchid.design.gram import Equations, Solved, inverse_root
from torchid.errors import TorchidError
from torchid.robot.inertia import PARAMETERS_PER_LINK, InertialParameters, pseudo_inertia_basis
from torchid.typing import Float, Int, Tensor

INSIDE = 1e-3
"""Share of a small body that every body holds at least: none is flat or without mass."""

WIDTH = 0.03
"""Radius that a link's mass is spread over at least, where a change of it is measured [m]."""


@dataclass(frozen=True, eq=False)
class Bodies:
    """Bodies whose parameters are corrected by coefficients.

    Attributes:
        at: (B, 10) which coefficients correct each.
        base: (B, 10) parameters without a correction, and more where they are not quite known.
        least: (B, 10) of the body that each of them holds.
        metric: (B, 10, 10) squares of a correction, in units of what is known beforehand.
        triangles: (B, 10, 10) what each parameter adds to the triangle of the pseudo-inertia in
            units of the small body, see `_triangles`.
    """

    at: Int[Tensor, "B 10"]
    base: Float[Tensor, "B 10"]
    least: Float[Tensor, "B 10"]
    metric: Float[Tensor, "B 10 10"]
    triangles: Float[Tensor, "B 10 10"]

    def shifted(self, by: int) -> "Bodies":
        """The same of coefficients that stand so many places further."""
        return replace(self, at=self.at + by)

    def are(self, x: Float[Tensor, " K"]) -> bool:
        """Whether coefficients leave all of them bodies."""
        rest = (self.base - self.least + x[self.at]) @ pseudo_inertia_basis().flatten(1)
        return not bool(torch.linalg.cholesky_ex(rest.view(-1, 4, 4))[1].any())

    def squares(self, count: int) -> Float[Tensor, "K K"]:
        """The metric of so many coefficients."""
        out = torch.zeros(count * count, dtype=torch.float64)
        where = self.at.unsqueeze(2) * count + self.at.unsqueeze(1)
        return out.index_add_(0, where.flatten(), self.metric.flatten()).view(count, count)


@cache
def _settings() -> clarabel.DefaultSettings:
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    return settings


def triangle(matrices: np.ndarray) -> np.ndarray:
    """Triangles (..., k (k+1) / 2) of symmetric matrices (..., k, k), as Clarabel takes them: by
    columns, off-diagonal entries times the root of two."""
    j, i = np.tril_indices(matrices.shape[-1])
    return np.ascontiguousarray(matrices[..., i, j]) * np.where(i == j, 1.0, np.sqrt(2.0))


def _triangles(small: Float[Tensor, "B 10"]) -> Float[Tensor, "B 10 10"]:
    """What each parameter of bodies adds to the triangle of their pseudo-inertia, in units of these
    small bodies'."""
    root = torch.linalg.cholesky(InertialParameters(small).pseudo_inertia)
    inner = torch.linalg.inv(root).unsqueeze(1)
    return torch.from_numpy(triangle((inner @ pseudo_inertia_basis() @ inner.mT).numpy()))


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of K coefficients before the data are seen.

    Attributes:
        ridge: (K,) inverse variances; zero where nothing is known.
        bodies: those that coefficients correct; None without any.
        centre: (K,) where they are expected; at zero if None.
        known: (F, F) inverse covariance of the first F coefficients, beside all that; none if None.
    """

    ridge: Float[Tensor, " K"]
    bodies: Bodies | None = None
    centre: Float[Tensor, " K"] | None = None
    known: Float[Tensor, "F F"] | None = None

    @cached_property
    def squares(self) -> Float[Tensor, "K K"]:
        """Inverse covariance of the coefficients."""
        out = torch.diag(self.ridge)
        if self.known is not None:
            out[: len(self.known), : len(self.known)] += self.known
        return out if self.bodies is None else out + self.bodies.squares(len(out))

    @property
    def unknown(self) -> "Prior":
        """The same, as if the model did not know how sure it is."""
        return replace(self, known=None)

    @cached_property
    def pull(self) -> Float[Tensor, " K"]:
        """Towards where they are expected."""
        zero = torch.zeros_like(self.ridge)
        return zero if self.centre is None else self.squares @ self.centre

    def value(self, x: Float[Tensor, " K"]) -> float:
        """Of coefficients, in squares of standard deviations; more than of zeros. Zeros far from
        where they are expected make it negative."""
        return float(x @ self.squares @ x - 2 * x @ self.pull)

    def solve(self, matrix: Float[Tensor, "K K"], right: Float[Tensor, " K"]) -> Solved:
        """The minimum beside normal equations; the root is that of free coefficients.

        Raises:
            TorchidError: the conic program has no solution.
        """
        matrix, right = matrix + self.squares, right + self.pull
        root = inverse_root(matrix, known=self.squares)
        x = root @ (root.T @ right)
        if self.bodies is not None and not self.bodies.are(x):
            x = self.beside_bodies(matrix, right)
        return Solved(x, root)

    def beside_bodies(
        self, matrix: Float[Tensor, "K K"], right: Float[Tensor, " K"]
    ) -> Float[Tensor, " K"]:
        """The minimum (K,) among coefficients that leave bodies, beside normal equations that hold
        all that is known.

        Raises:
            TorchidError: the conic program has no solution.
        """
        # Beside the bodies' own coefficients all others follow.
        assert self.bodies is not None
        own = self.bodies.at.unique()
        rest = torch.ones(len(right), dtype=torch.bool)
        rest[own] = False
        inner, across = inverse_root(matrix[rest][:, rest]), matrix[rest][:, own]
        held = inner.T @ across
        alone = matrix[own][:, own] - held.T @ held
        pull = right[own] - held.T @ (inner.T @ right[rest])
        bodies = replace(self.bodies, at=torch.searchsorted(own, self.bodies.at))
        x = torch.zeros_like(right)
        x[own] = nearest_to(bodies, alone, pull)
        x[rest] = inner @ (inner.T @ (right[rest] - across @ x[own]))
        return x

    def solve_of(self, equations: Equations, weight: Float[Tensor, " n"]) -> Solved:
        """The minimum of joints' normal equations with these weights (n,)."""
        return self.solve(*equations.weighted(weight))


class Priors:
    """Those of several least squares of K coefficients at most, solved at once.

    Args:
        each: B of them; the smaller ones have zeros for the coefficients that they lack.
    """

    def __init__(self, each: Sequence[Prior]):
        self.each = tuple(each)
        count = max(len(p.ridge) for p in each)
        self.squares = torch.zeros(len(each), count, count, dtype=torch.float64)
        self.pull = torch.zeros(len(each), count, dtype=torch.float64)
        for k, p in enumerate(each):
            own = len(p.ridge)
            self.squares[k, :own, :own] = p.squares
            self.pull[k, :own] = p.pull

    def value(self, x: Float[Tensor, "B K"]) -> Float[Tensor, " B"]:
        """As `Prior.value`."""
        held = (self.squares @ x.unsqueeze(-1)).squeeze(-1)
        return (x * (held - 2 * self.pull)).sum(-1)

    def leave_bodies(self, x: Float[Tensor, "B K"]) -> list[bool]:
        """Whether each one's coefficients leave bodies, where it corrects any."""
        return [
            p.bodies is None or p.bodies.are(own[: len(p.ridge)])
            for p, own in zip(self.each, x, strict=True)
        ]

    def solve_of(
        self, equations: Equations, weight: Float[Tensor, "B *batch n"], *, conic: bool = True
    ) -> Solved:
        """The minima of joints' normal equations (B, *batch, ...) with these weights.

        Args:
            equations, weight: of every least squares.
            conic: whether bodies must stay bodies; without, minima are no larger.
        """
        matrix, right = equations.weighted(weight)
        more = (1,) * (right.dim() - 2)
        squares = self.squares.view(len(self.each), *more, *self.squares.shape[1:])
        matrix, right = matrix + squares, right + self.pull.view(len(self.each), *more, -1)
        root = inverse_root(matrix, known=squares)
        x = (root @ (root.mT @ right.unsqueeze(-1))).squeeze(-1)
        for k, p in enumerate(self.each):
            if conic and p.bodies is not None:
                own = len(p.ridge)
                some = (matrix[k, ..., :own, :own], right[k, ..., :own], x[k, ..., :own])
                for m, b, y in zip(
                    some[0].reshape(-1, own, own), some[1].reshape(-1, own),
                    some[2].view(-1, own), strict=True,
                ):  # fmt: skip
                    if not p.bodies.are(y):
                        y.copy_(p.beside_bodies(m, b))
        return Solved(x, root)


def nearest_to(
    bodies: Bodies, matrix: Float[Tensor, "K K"], right: Float[Tensor, " K"]
) -> Float[Tensor, " K"]:
    """The minimum over coefficients that all belong to bodies, among those that leave them so."""
    # Columns of length one, and every body in units of the small one that it holds.
    size = matrix.diagonal().clamp(min=1e-12 * float(matrix.diagonal().max())).sqrt().numpy()
    count, own = bodies.at.shape[0], len(size)
    base = (bodies.base - bodies.least).unsqueeze(1) @ bodies.triangles
    columns = np.zeros((own, count, 10))
    columns[bodies.at.numpy(), np.arange(count)[:, None]] = bodies.triangles.numpy()
    solver = clarabel.DefaultSolver(
        _sparse(np.triu(2 * matrix.numpy() / size / size[:, None]).T),
        -2 * right.numpy() / size,
        _sparse(columns.reshape(own, -1) / -size[:, None]),
        base.flatten().numpy(),
        [clarabel.PSDTriangleConeT(4)] * count,
        _settings(),
    )
    found = solver.solve()
    x = np.array(found.x)
    if "Solved" not in str(found.status) and not np.isfinite(x).all():
        raise TorchidError("no bodies were found that fit.", got=str(found.status))
    return torch.from_numpy(x / size)


def _sparse(columns: np.ndarray) -> sparse.csc_matrix:
    """A matrix from its columns (K, rows): scipy's own way, from a dense matrix, takes as long as
    Clarabel needs for the program."""
    where = columns != 0
    ends = np.zeros(len(columns) + 1, dtype=np.int32)
    np.cumsum(where.sum(1), out=ends[1:])
    rows = where.nonzero()[1].astype(np.int32)
    return sparse.csc_matrix((columns[where], rows, ends), shape=columns.shape[::-1])


def links_near(
    pi: Float[Tensor, "n 10"], usual: Float[Tensor, "n 10"], deviation: float
) -> "tuple[Bodies, ...] | None":
    """Links that are bodies and stay bodies, near to what they were; None where one is none before.

    Args:
        pi: parameters as they were.
        usual: a small body of each link's own size, beside which a change counts: placeholders in
            a file are no knowledge.
        deviation: standard deviation of a relative change.
    """
    p = InertialParameters(pi).pseudo_inertia
    lowest = torch.linalg.eigvalsh(p)[:, 0]
    if bool((lowest < -1e-6 * p.diagonal(dim1=1, dim2=2).sum(1)).any()):
        return None
    reference = InertialParameters(pi + usual).pseudo_inertia
    inner = torch.linalg.inv(reference).unsqueeze(1) @ pseudo_inertia_basis()
    metric = torch.einsum("kaij,kbji->kab", inner, inner) / deviation**2
    at = torch.arange(PARAMETERS_PER_LINK).unsqueeze(0)
    each = (pi, INSIDE * usual, metric, _triangles(usual))
    parts = zip(*(x.split(1) for x in each), strict=True)
    return tuple(Bodies(at, *own) for own in parts)


def some_body(usual: Float[Tensor, " 10"]) -> Bodies:
    """A body of which nothing is known but that it is one, up to a small one: so well at most is
    known what it is fixed to."""
    least = INSIDE * usual.unsqueeze(0)
    zero = torch.zeros(1, PARAMETERS_PER_LINK, PARAMETERS_PER_LINK, dtype=torch.float64)
    at = torch.arange(PARAMETERS_PER_LINK).unsqueeze(0)
    return Bodies(at, usual.unsqueeze(0), least, zero, _triangles(usual.unsqueeze(0)))


def together(bodies: "list[Bodies]") -> Bodies | None:
    """All of them; None of none."""
    if not bodies:
        return None
    names = ("at", "base", "least", "metric", "triangles")
    return Bodies(*(torch.cat([getattr(b, name) for b in bodies]) for name in names))


def _least_mass(pi: Float[Tensor, "n 10"]) -> float:
    """A massless link may still have the mass of a twentieth of the others [kg]."""
    return 0.05 * float(pi[:, 0].abs().mean()) + 1e-9


def usual_bodies(pi: Float[Tensor, "n 10"]) -> Float[Tensor, "n 10"]:
    """Of each link a small body about its centre: a twentieth of the links' mean mass, three
    centimetres of the link's own mass wide."""
    mass, com = pi[:, 0].abs(), InertialParameters(pi).com
    small = torch.full_like(mass, _least_mass(pi))
    wide = torch.maximum(mass, small) * WIDTH**2
    # A second moment of `wide` along each axis is an inertia of twice that about each.
    zero = torch.zeros_like(wide)
    inertia = torch.stack([2 * wide, zero, zero, 2 * wide, zero, 2 * wide], 1)
    return InertialParameters.from_com(small, com, inertia).pi


def body_sizes(pi: Float[Tensor, "n 10"]) -> Float[Tensor, "n 10"]:
    """How large the parameters of links are: the mass, the mass at the radius of gyration, and the
    inertia at it; of a link without mass, those of a twentieth of the others'."""
    mass = pi[:, 0].abs().clamp(min=_least_mass(pi))
    inertia = (0.5 * pi[:, [4, 7, 9]].sum(1)).abs()
    # Radius of gyration of each link, five centimetres at least.
    radius = (inertia / mass).sqrt().clamp(min=0.05)
    sizes = [mass, *[mass * radius] * 3, *[mass * radius**2] * 6]
    return torch.stack(sizes, 1)
