"""Least squares of which some coefficients are corrections of bodies' inertial parameters.

    x'Hx - 2 b'x + sum_k x_k^2 / sigma_k^2 + sum_bodies tr((R^-1 P(x))^2) / sigma^2,  P(p + x) >= 0

P is a body's pseudo-inertia [[S, m c], [m c', m]], linear in its ten parameters, and positive
definite of bodies alone. The metric is that of Lee, Wensing and Park (2020) at a reference R: the
squared relative change of a body, which depends on no frame. What least squares leave a body is the
solution; else a conic program is solved: many at once by Newton's method for the fixed point of the
projection (Pang and Qi 1993), or, where it does not settle, one by one by interior points
(Clarabel, Goulart and Chen 2024).
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, cached_property

import clarabel  # type: ignore[import-untyped]
import numpy as np
import torch
from scipy import sparse
from scipy.linalg import block_diag

from torchid.design.gram import DETERMINED, inverse_root
from torchid.errors import TorchidError
from torchid.robot.inertia import PARAMETERS_PER_LINK, InertialParameters, pseudo_inertia_basis
from torchid.typing import Float, Int, Tensor

INSIDE = 1e-3
"""Share of a small body that every body holds at least: none is flat or without mass."""

STEPS, SETTLED = 20, 1e-10
"""Newton steps at most, of which six are the rule, and the change of a pseudo-inertia, relative to
its largest entry, from which on there is no further one."""


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
        """These bodies where their coefficients stand so many places further."""
        return replace(self, at=self.at + by)

    def are(self, x: Float[Tensor, " K"]) -> bool:
        """Whether coefficients leave all of them bodies."""
        return not _no_bodies([self], x.unsqueeze(0))

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

    @cached_property
    def pull(self) -> Float[Tensor, " K"]:
        """Towards where they are expected."""
        zero = torch.zeros_like(self.ridge)
        return zero if self.centre is None else self.squares @ self.centre

    def value(self, x: Float[Tensor, " K"]) -> float:
        """How unlikely coefficients are beforehand, in squares of standard deviations, beside
        zeros; negative where zeros are farther from what is expected."""
        return float(x @ self.squares @ x - 2 * x @ self.pull)

    def solve(
        self, matrix: Float[Tensor, "K K"], right: Float[Tensor, " K"]
    ) -> Float[Tensor, " K"]:
        """The minimum beside normal equations.

        Raises:
            TorchidError: the conic program has no solution.
        """
        matrix, right = matrix + self.squares, right + self.pull
        root = inverse_root(matrix, known=self.squares)
        x = root @ (root.T @ right)
        _stay_bodies([self.bodies], matrix.unsqueeze(0), right.unsqueeze(0), x.unsqueeze(0))
        return x


def _no_bodies(bodies: Sequence[Bodies | None], x: Float[Tensor, "G K"]) -> list[list[int]]:
    """Which coefficients leave no bodies; those that correct equally many together."""
    alike: dict[int, list[int]] = {}
    for k, some in enumerate(bodies):
        if some is not None:
            alike.setdefault(len(some.at), []).append(k)
    out = []
    for asked in alike.values():
        each = [b for b in map(bodies.__getitem__, asked) if b is not None]
        at, base, least = (torch.stack([getattr(b, name) for b in each]) for name in _LIMITS)
        own = base - least + x[asked].gather(1, at.flatten(1)).view(at.shape)
        pseudo = (own @ pseudo_inertia_basis().flatten(1)).view(*at.shape[:2], 4, 4)
        failed = torch.linalg.cholesky_ex(pseudo)[1].any(1).tolist()
        out.append([k for k, wrong in zip(asked, failed, strict=True) if wrong])
    return [some for some in out if some]


_LIMITS = ("at", "base", "least")


def _stay_bodies(
    bodies: Sequence[Bodies | None],
    matrix: Float[Tensor, "G K K"],
    right: Float[Tensor, "G K"],
    x: Float[Tensor, "G K"],
) -> None:
    """Put what leaves no bodies at the minimum among coefficients that do, beside normal equations
    that hold all that is known."""
    for asked in _no_bodies(bodies, x):
        each = [b for b in map(bodies.__getitem__, asked) if b is not None]
        there = torch.from_numpy(_minima(each, matrix[asked].numpy(), right[asked].numpy()))
        # Where others hold all of a body's columns the program has no digits, and x stays.
        x[asked] = torch.where(there.isfinite().all(1, keepdim=True), there, x[asked])


def _minima(each: Sequence[Bodies], matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Minimum (G, K) of each of G problems, over coefficients that leave its bodies physical; NaN
    where a problem's program has no solution."""
    # Beside the bodies' own coefficients all others follow.
    at = torch.stack([b.at for b in each]).flatten(1).numpy()
    g = np.arange(len(each))[:, None]
    others = np.ones(right.shape, dtype=bool)
    others[g, at] = False
    rest, row = others.nonzero()[1].reshape(len(g), -1), g[:, None]
    inner = inverse_root(torch.from_numpy(matrix[row, rest[:, :, None], rest[:, None]])).numpy()
    across = matrix[row, rest[:, :, None], at[:, None]]
    held = inner.transpose(0, 2, 1) @ across
    alone = matrix[row, at[:, :, None], at[:, None]] - held.transpose(0, 2, 1) @ held
    pull = right[g, at] - _times(held.transpose(0, 2, 1), _times(inner, right[g, rest], True))
    own, settled = _by_newton(each, alone, pull)
    own[~settled] = np.nan
    for k in (~settled).nonzero()[0].tolist():
        with suppress(TorchidError):
            own[k] = nearest_to(each[k], alone[k], pull[k])
    x = np.zeros_like(right)
    x[g, at] = own
    x[g, rest] = _times(inner, _times(inner, right[g, rest] - _times(across, own), True))
    return x


def _times(matrix: np.ndarray, x: np.ndarray, transposed: bool = False) -> np.ndarray:
    """Each of several matrices times its vector."""
    return (x[:, None] @ matrix)[:, 0] if transposed else (matrix @ x[..., None])[..., 0]


_J, _I = np.tril_indices(4)
_SIZE = np.where(_I == _J, 1.0, np.sqrt(2.0))
_PLACES = np.zeros((4, 4), dtype=int)
_PLACES[_I, _J] = _PLACES[_J, _I] = np.arange(PARAMETERS_PER_LINK)


def _by_newton(
    each: Sequence[Bodies], matrix: np.ndarray, right: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Minima (G, C) over the coefficients of bodies, body by body, and which of them are found: by
    Newton's method for the fixed point y = [y - t (Q y - c)]+, y the pseudo-inertias' triangles and
    [.]+ the projection onto what is positive definite."""
    # The objective y'Qy - 2c'y of the triangles, which hold x and the body without it.
    rest = (torch.stack([b.base for b in each]) - torch.stack([b.least for b in each])).numpy()
    units = torch.linalg.inv(torch.stack([b.triangles for b in each])).numpy()
    count, size = rest.shape[1], right.shape[1]

    def in_units(a: np.ndarray) -> np.ndarray:
        return (units @ a.reshape(len(a), count, size // count, -1)).reshape(len(a), size, -1)

    base = rest.reshape(right.shape)
    q = in_units(in_units(matrix).transpose(0, 2, 1))
    c = in_units(right + _times(matrix, base))[..., 0]
    # Where nothing is known of some direction, the middle of what is possible is the answer.
    diagonal = q.diagonal(0, 1, 2)
    factor, failed = torch.linalg.cholesky_ex(torch.from_numpy(q))
    left = factor.diagonal(dim1=1, dim2=2).numpy() ** 2
    sure = (failed.numpy() == 0) & (left > DETERMINED * diagonal).all(1)
    # 10.0: step along the slope, of which the projection is the fixed point, in units of the
    # largest second derivative: any has the same one; at a tenth and at ten times of it more steps
    # are taken
    step = 10.0 / diagonal.max(1)[:, None]
    moved = np.eye(size) - step[..., None] * q
    y, settled = np.zeros_like(c), np.zeros(len(c), dtype=bool)
    y[sure] = np.linalg.solve(q[sure], c[sure, :, None])[..., 0]
    now = sure.nonzero()[0]
    for _ in range(STEPS):
        if not len(now):
            break
        own, m = y[now], moved[now]
        z = (_times(m, own) + (step * c)[now]).reshape(len(now), count, size // count)
        values, vectors = np.linalg.eigh((z / _SIZE)[..., _PLACES])
        kept, turned = np.maximum(values, 0.0), vectors.swapaxes(-1, -2)
        near = (vectors * kept[..., None, :]) @ turned
        off = own - (near[..., _I, _J] * _SIZE).reshape(own.shape)
        done = np.abs(off).max(1) <= SETTLED * np.abs(own).max(1)
        y[now] -= off * done[:, None]
        settled[now] = done
        now, m, off = now[~done], m[~done], off[~done]
        # The projection's slope: divided differences of [.]+ in the eigenvectors' frame.
        kept, sizes, vectors = kept[~done], np.abs(values[~done]), vectors[~done]
        both = sizes[..., None] + sizes[..., None, :] + 1e-300
        shares = ((kept[..., None] + kept[..., None, :]) / both)[..., None, _I, _J]
        pairs = vectors[..., _I, :, None] * vectors[..., _J, None, :]
        frame = (pairs[..., _I, _J] + pairs[..., _J, _I]) * (0.5 * _SIZE * _SIZE[:, None])
        slope = (frame * shares) @ frame.swapaxes(-1, -2)
        held = (slope @ m.reshape(len(m), count, size // count, size)).reshape(m.shape)
        y[now] -= np.linalg.solve(np.eye(size) - held, off[..., None])[..., 0]
    x = y.reshape(len(y), count, 1, -1) @ units
    return x.reshape(right.shape) - base, settled


def nearest_to(bodies: Bodies, matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The minimum over the coefficients of bodies, body by body.

    Raises:
        TorchidError: the program has no digits, or no end.
    """
    # Columns of length one, and every body in units of the small one that it holds.
    size = np.sqrt(matrix.diagonal().clip(min=1e-12 * matrix.diagonal().max()))
    if not (np.isfinite(matrix).all() and np.isfinite(right).all() and size.min() > 0):
        raise TorchidError("no bodies were found that fit.", got="numbers without digits")
    base = (bodies.base - bodies.least).unsqueeze(1) @ bodies.triangles
    solver = clarabel.DefaultSolver(
        _sparse(np.triu(2 * matrix / size / size[:, None]).T),
        -2 * right / size,
        _sparse(block_diag(*bodies.triangles.numpy()) / -size[:, None]),
        base.flatten().numpy(),
        [clarabel.PSDTriangleConeT(4)] * len(bodies.at),
        _settings(),
    )
    try:
        found = solver.solve()
    except BaseException as error:  # a panic of Rust code is no Exception
        if type(error).__name__ != "PanicException":
            raise
        raise TorchidError("no bodies were found that fit.", got=str(error)) from error
    if "Solved" not in str(found.status):
        raise TorchidError("no bodies were found that fit.", got=str(found.status))
    return np.array(found.x) / size


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


def some_body(usual: Float[Tensor, " 10"], there: Float[Tensor, " 10"]) -> Bodies:
    """A body of which nothing is known but that it is one, with what is there already.

    Args:
        usual: a small body of its size.
        there: parameters that are corrected; zeros of a body that is wholly new.
    """
    usual, at = usual.unsqueeze(0), torch.arange(PARAMETERS_PER_LINK).unsqueeze(0)
    zero = torch.zeros(1, PARAMETERS_PER_LINK, PARAMETERS_PER_LINK, dtype=torch.float64)
    return Bodies(at, there.unsqueeze(0), INSIDE * usual, zero, _triangles(usual))


def together(bodies: "list[Bodies]") -> Bodies | None:
    """Bodies of several parts as one; None where there are none."""
    if not bodies:
        return None
    names = ("at", "base", "least", "metric", "triangles")
    return Bodies(*(torch.cat([getattr(b, name) for b in bodies]) for name in names))


def _least_mass(pi: Float[Tensor, "n 10"]) -> float:
    """A massless link may still have the mass of a twentieth of the others [kg]."""
    return 0.05 * float(pi[:, 0].abs().mean()) + 1e-9


def usual_bodies(pi: Float[Tensor, "n 10"]) -> Float[Tensor, "n 10"]:
    """A small body (n, 10) of each link, about its centre: a twentieth of the links' mean mass,
    three centimetres of the link's own mass wide."""
    mass, com = pi[:, 0].abs(), InertialParameters(pi).com
    small = torch.full_like(mass, _least_mass(pi))
    # 0.03: radius that a link's mass is spread over at least, where a change of it is measured [m]
    wide = torch.maximum(mass, small) * 0.03**2
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
