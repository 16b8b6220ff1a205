"""Triangular factor of a tall matrix that arrives in pieces and is never stored.

R of [A b] holds everything least squares needs: ||A x - b||^2 = ||R (x, -1)||^2. It is built by
preconditioned Cholesky QR: rows are multiplied by the inverse of a first guess R0, their Gram
matrix G stays well conditioned, and R = chol(G)' R0 has the accuracy of Householder QR without its
cost (Yamamoto et al. 2015, shifted and preconditioned CholeskyQR). R0 is renewed whenever the rows
it was made from no longer represent the rest.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from torchid.typing import Float

_RENEW_AT = 1e3
"""Mean square of a preconditioned column (1 if rows are like those of the guess) that calls for a
new guess."""
_FLOOR = 1e-6
"""Diagonal entry of the guess, relative to its column, below which the direction is unseen."""
_ENOUGH = 4
"""Rows a column before the first guess: fewer make one that the rest does not resemble."""


class TriangularFactor:
    """Accumulates rows (m, c) into an upper triangular R (c, c) with R'R = A'A.

    The one mutable object of this room: state is a c x c factor whatever the number of rows.
    """

    def __init__(self, columns: int, *, device: torch.device | str | None = None):
        self._guess: Tensor | None = None
        self._inverse: Tensor | None = None
        self._gram = torch.zeros(columns, columns, dtype=torch.float64, device=device)
        self._rows = 0
        self._columns = columns
        self._waiting: list[Tensor] = []

    def add(self, rows: Float[Tensor, "m c"]) -> None:
        """Take in m rows."""
        if rows.shape[0] == 0:
            return
        if self._guess is None:
            self._waiting = [torch.cat([*self._waiting, rows])]
            if self._waiting[0].shape[0] < _ENOUGH * self._columns:
                return
            rows = self._waiting.pop()
            self._precondition(_householder(rows))
        assert self._inverse is not None
        z = rows @ self._inverse
        self._gram.addmm_(z.T, z)
        self._rows += rows.shape[0]
        spread = self._gram.diagonal() / self._rows
        if float(spread.max()) > _RENEW_AT * float(spread.mean().clamp(max=1.0)):
            self._renew()

    def factor(self) -> Float[Tensor, "c c"]:
        """R with a non-negative diagonal; zero if no row came."""
        if self._guess is None:
            return _householder(torch.cat([torch.zeros_like(self._gram), *self._waiting]))
        # Both are upper triangular already; this makes the diagonal non-negative.
        return _householder(_root(self._gram) @ self._guess)

    def _precondition(self, guess: Tensor) -> None:
        """Use R0 = `guess`. A direction it has not seen gets its column's size: a small size there
        would make the inverse large, and its rounding would spoil the columns that were seen."""
        size = torch.linalg.vector_norm(guess, dim=0)
        size = torch.where(size > 0, size, size.max().clamp(min=1.0))
        diagonal = guess.diagonal()
        lifted = torch.where(diagonal.abs() > _FLOOR * size, diagonal, size)
        self._guess = guess - torch.diag(diagonal) + torch.diag(lifted)
        eye = torch.eye(self._columns, dtype=guess.dtype, device=guess.device)
        # Solved from the right: what must hold to rounding is inverse x R0 = 1, the way it is used.
        self._inverse = torch.linalg.solve_triangular(self._guess, eye, upper=True, left=False)

    def _renew(self) -> None:
        assert self._guess is not None
        exact = _root(self._gram) @ self._guess
        self._precondition(_householder(exact / self._rows**0.5))
        assert self._inverse is not None
        z = exact @ self._inverse
        self._gram = z.T @ z


def stacked_factor(factors: list[Tensor]) -> Float[Tensor, "c c"]:
    """R of several matrices on top of each other, from their factors."""
    return _householder(torch.cat(factors))


def combined_factor(
    factors: Sequence[Float[Tensor, "_ _"]], columns: Sequence[Sequence[int]], size: int
) -> Float[Tensor, "C C"]:
    """R of [A b] from the factors of its torque rows, each of its own columns of A and of b.

    Args:
        factors: a torque row's R, (c + 1, c + 1), b last.
        columns: the c columns of A, of `size` in all, that each has.
    """
    wide = []
    for r, c in zip(factors, columns, strict=True):
        embedded = r.new_zeros(r.shape[0], size + 1)
        embedded[:, [*c, size]] = r
        wide.append(embedded)
    return stacked_factor(wide)


def _householder(rows: Tensor) -> Tensor:
    c = rows.shape[1]
    if rows.shape[0] < c:
        rows = torch.cat([rows, rows.new_zeros(c - rows.shape[0], c)])
    r = torch.linalg.qr(rows, mode="r").R
    sign = torch.where(r.diagonal() < 0, -1.0, 1.0).to(r)
    return r * sign.unsqueeze(-1)


def _root(gram: Tensor) -> Tensor:
    """Upper triangular U with U'U = G, also for a singular G.

    G is scaled to a unit diagonal first: a direction the guess got wrong by a factor of a million
    then loses nothing.
    """
    size = gram.diagonal().sqrt()
    safe = torch.where(size > 0, size, torch.ones_like(size))
    scaled = gram / safe / safe.unsqueeze(-1)
    scaled.diagonal().fill_(1.0)
    upper, info = torch.linalg.cholesky_ex(scaled, upper=True)
    if int(info) != 0:
        values, vectors = torch.linalg.eigh(scaled)
        upper = _householder(values.clamp(min=0).sqrt().unsqueeze(-1) * vectors.T)
    return upper * size
