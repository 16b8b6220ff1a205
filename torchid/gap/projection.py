"""Gains of candidate columns on the residual, beyond what is already in the model.

With Q an orthonormal basis of the columns in the model and r the residual (so Q' r = 0), columns X
that join the model lower the sum of squares by b' G^-1 b, b = X' r, G = X' X - (Q' X)' (Q' X): the
squared length of r along the part of X that Q does not hold. Joint banks only meet the rows of
their joint. Q' X is kept and extended when columns join.
"""

import math
from dataclasses import dataclass

import torch

from torchid.gap.bank import Bank
from torchid.typing import Bool, Float, Int, Tensor

VISIBLE = 0.01
"""Share of a column's square that must be left outside the model for it to be seen at all. Of less,
what is left is noise of the regressors and the misfit of the effects already there, and the
coefficient would be large and cancel against theirs."""

ROUNDING = 1e-7
"""The same for columns that join the model whatever is left of them."""


NOISE = 1.0
"""Whitened sum of squares that one coefficient could explain by chance."""

SURE = 3.0
"""Standard deviations below zero from which a coefficient has the wrong sign."""

DETERMINED = 0.99
"""Share of a coefficient's direction that must be visible for its sign to be judged."""


@dataclass(frozen=True)
class Gains:
    """Of a bank's members.

    Attributes:
        gain: (S,) fall of the sum of squares; 0 where physics forbids the sign.
        df: (S,) directions of the columns that are visible.
        values: (S, C) coefficients; those of invisible directions have the least norm.
    """

    gain: Float[Tensor, " S"]
    df: Int[Tensor, " S"]
    values: Float[Tensor, "S C"]


class Projector:
    """Residual and orthonormal basis of a growing model.

    Args:
        y: (n, N) whitened torque the model must explain.
    """

    def __init__(self, y: Float[Tensor, "n N"]):
        self.n, self.count = y.shape
        self.y = y
        self.q = y.new_zeros(0, y.numel())
        self.r = y.clone()

    def copy(self) -> "Projector":
        """The same model, to which other columns may be added."""
        out = object.__new__(Projector)
        out.__dict__.update(self.__dict__)
        return out

    def add(
        self, columns: Float[Tensor, "C R"], place: int | None, visible: float = VISIBLE
    ) -> None:
        """Columns join the model: the directions of which at least `visible` is not yet in it."""
        full = in_all_rows(columns, place, self.n)
        size = full.norm(dim=1, keepdim=True)
        full = full[(size > 0).flatten()] / size[size > 0].unsqueeze(-1)
        for _ in range(2):  # once more: classical Gram-Schmidt loses digits
            full = full - (full @ self.q.T) @ self.q
        _, s, v = torch.linalg.svd(full, full_matrices=False)
        new = v[s**2 > visible]
        new = new - (new @ self.q.T) @ self.q
        self.q = torch.cat([self.q, torch.linalg.qr(new.T).Q.T])
        flat = self.r.flatten()
        self.r = (flat - (flat @ self.q.T) @ self.q).reshape(self.n, self.count)

    @property
    def loss(self) -> float:
        """Sum of squares."""
        return float(self.r.square().sum())

    def rows_of(self, place: int | None) -> slice:
        """Where a place's rows are in the stacked ones."""
        if place is None:
            return slice(0, self.n * self.count)
        return slice(place * self.count, (place + 1) * self.count)


def in_all_rows(columns: Float[Tensor, "C R"], place: int | None, n: int) -> Float[Tensor, "C nN"]:
    """Columns of one joint's rows with zeros in those of the other n - 1."""
    if place is None:
        return columns
    out = columns.new_zeros(columns.shape[0], n, columns.shape[1])
    out[:, place] = columns
    return out.flatten(1)


class Scanner:
    """Gains of a bank while a projector's model grows."""

    def __init__(self, bank: Bank, keep: Bool[Tensor, "n N"]):
        self.bank = bank
        # The residual and the basis are zero in rows that do not count; only here must they be.
        rows = keep.flatten() if bank.place is None else keep[bank.place]
        self.gram = (bank.columns * rows) @ bank.columns.transpose(1, 2)
        self._signed = torch.tensor([c.non_negative for c in bank.coefficients])
        known = bank.known or (0.0,) * len(bank.coefficients)
        self._known = self.gram.new_tensor(known)
        self._largest = self.gram.new_tensor([c.largest for c in bank.coefficients])
        self._held = bank.columns.new_zeros(*bank.columns.shape[:2], 0)
        self._basis: Tensor | None = None

    def _projections(self, q: Float[Tensor, "p nN"], rows: slice) -> Float[Tensor, "S C p"]:
        """Q' X, extended by what joined; made anew where the basis is another one."""
        known = self._held.shape[-1]
        if self._basis is None or not _begins_with(q, self._basis):
            known, self._held = 0, self._held[..., :0]
        if known < len(q):
            self._held = torch.cat([self._held, self.bank.columns @ q[known:, rows].T], -1)
        self._basis = q
        return self._held

    def gains(self, model: Projector) -> Gains:
        """Gains of all members."""
        rows = model.rows_of(self.bank.place)
        b = self.bank.columns @ model.r.flatten()[rows]
        held = self._projections(model.q, rows)
        left = self.gram - held @ held.transpose(1, 2)
        return _solve(self.gram, left, b, self._signed, self._known, self._largest)


def _begins_with(q: Tensor, start: Tensor) -> bool:
    return q is start or (len(start) <= len(q) and torch.equal(q[: len(start)], start))


def _solve(
    gram: Tensor, left: Tensor, b: Tensor, signed: Tensor, known: Tensor, largest: Tensor
) -> Gains:
    """Gains from what is left of the Gram matrices (S, C, C), in units where columns have length
    one. Columns that are below noise at their largest plausible size are none."""
    square = gram.diagonal(dim1=1, dim2=2)
    felt = (square * largest.square() > NOISE) & (square > 0)
    size = torch.where(felt, square.clamp(min=1e-300).sqrt(), math.inf)
    scaled = left / (size.unsqueeze(-1) * size.unsqueeze(-2))
    values, vectors = torch.linalg.eigh(scaled)
    seen = values > VISIBLE
    along = (vectors.transpose(1, 2) @ (b / size).unsqueeze(-1)).squeeze(-1)
    safe = torch.where(seen, values, torch.ones_like(values))
    along = torch.where(seen, along, torch.zeros_like(along))
    gain = (along.square() / safe).sum(-1)
    x = (vectors @ (along / safe).unsqueeze(-1)).squeeze(-1) / size
    # A sign counts only where the coefficient is determined, not along invisible directions, and
    # is no noise: an effect is not refused for an inertia that it hardly has.
    squares = vectors.square() * seen.unsqueeze(-2)
    sure = squares.sum(-1) > DETERMINED
    noise = SURE * (squares / safe.unsqueeze(-2)).sum(-1).sqrt() / size
    wrong = (sure & (((x < -known - noise) & signed) | (x.abs() > largest))).any(-1)
    return Gains(torch.where(wrong, torch.zeros_like(gain), gain), seen.sum(-1), x)
