"""Shapes of effects (a Stribeck speed, a wave number) that nobody gave, found on training data.

An effect is linear in its coefficients once its shape is given. So a shape is judged by how much
the weighted squares of the residual fall when the effect joins all else that is fitted, with
coefficients refitted each time: its grid first, then five times seven values around the best, ever
closer. Effects are taken one after another; where several of one joint are searched, each of them
once more beside the others.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import torch

from torchid.design.motion import Measurement
from torchid.effects.base import Effect, JointEffect, Motion
from torchid.identification.asked import Asked, with_shapes
from torchid.identification.least_squares import Fit
from torchid.identification.rows import RowSource, own_columns, sampled
from torchid.typing import Float, Tensor

LEVELS = 5
"""Times that a shape is refined: to less than a hundredth of the grid's step."""

ROUNDING = 1e-9
"""Share of a column's square left beside the fit below which the column says nothing of its own."""


def search_shapes(
    unknown: Sequence[Asked],
    source: RowSource,
    found: Fit,
    measured: Sequence[Measurement],
    cutoff: float | None,
) -> list[Effect | None]:
    """Effects with the shapes that leave least of the residual; None for one that these motions
    cannot show.

    Args:
        unknown: with shapes to search.
        source: rows of all that is fitted beside them.
        found: its fit, whose weights are used.
        measured: trajectories of the rows, with t, and the torque of the fit.
        cutoff: [Hz] of the rows.
    """
    rows = _Rows(source, found, measured)
    band = cutoff if cutoff is not None else 0.2 * measured[0].rate
    best: list[Effect | None] = [None] * len(unknown)
    users = Counter(j for a in unknown for j in a.effect.joints)
    again = [k for k, a in enumerate(unknown) if any(users[j] > 1 for j in a.effect.joints)]
    for k in (*range(len(unknown)), *again):
        others = [e for j, e in enumerate(best) if e is not None and j != k]
        best[k] = _best(unknown[k], rows.beside(others), rows, band)
    return best


def _best(asked: Asked, beside: "_Beside", rows: "_Rows", band: float) -> Effect | None:
    """The effect with the best shape of its grid, refined; None where none tells anything."""
    best, largest = asked.effect, 0.0
    for level in range(-1, LEVELS):
        for effect in _tried(best, asked.searched, rows.motions, level, band):
            gain = beside.gain(effect)
            if gain > largest:
                best, largest = effect, gain
        if largest == 0:
            return None
    return best


def _tried(
    effect: Effect, searched: Sequence[str], motions: Sequence[Motion], level: int, band: float
) -> list[Effect]:
    """The effect with shapes of its grid (level -1), or around its own."""
    names = [s.name for s in effect.shapes]
    if isinstance(effect, JointEffect):
        grid = effect.grid(motions, effect.joint, band) if level < 0 else None
        table = effect.finer(motions, level, band) if grid is None else grid
        assert table is not None
        values = [tuple(row) for row in table.tolist()]
    else:
        axes = [
            s.grid if level < 0 else s.around(v, level, 1.0).tolist()
            for s, v in zip(effect.shapes, effect.shape_values, strict=True)
        ]
        values = list(product(*axes))
    at = [names.index(name) for name in searched]
    kept = dict.fromkeys(tuple(row[k] for k in at) for row in values)
    return [with_shapes(effect, searched, row) for row in kept]


class _Rows:
    """Weighted rows of a fit, joint by joint, and columns beside them."""

    def __init__(self, source: RowSource, found: Fit, measured: Sequence[Measurement]):
        self.measured = measured
        self.motions = [m.motion for m in measured]
        self._weight = (found.robust * found.whitening.diagonal()).T
        n, size = self._weight.shape[0], source.layout.size
        blocks = list(source)
        self.columns = torch.zeros(n, self._weight.shape[1], size, dtype=torch.float64)
        for i, c in enumerate(source.layout.columns):
            own = torch.cat([b.matrices[i] for b in blocks])
            self.columns[i, :, list(c)] = own * self._weight[i].unsqueeze(-1)
        self.tau = torch.cat([b.tau for b in blocks]).T * self._weight

    def of(self, effect: Effect) -> dict[int, Float[Tensor, "I C"]]:
        """Columns of an effect by joint."""
        parts = [own_columns(effect, m.motion) for m in self.measured]
        return {
            j: sampled(self.measured, [p[k].T for p in parts]).cpu().T * self._weight[j, :, None]
            for k, j in enumerate(effect.joints)
        }

    def beside(self, effects: Sequence[Effect]) -> "_Beside":
        """What is left of columns beside all that is fitted and further effects."""
        wide = [self.columns]
        for effect in effects:
            more = torch.zeros(*self.tau.shape, len(effect.coefficients), dtype=torch.float64)
            for j, own in self.of(effect).items():
                more[j] = own
            wide.append(more)
        a = torch.cat(wide, -1)
        flat = a.flatten(0, 1)
        size = torch.linalg.vector_norm(flat, dim=0)
        flat = flat[:, size > 0] / size[size > 0]
        r = torch.linalg.qr(flat, mode="r").R
        _, s, vt = torch.linalg.svd(r, full_matrices=False)
        kept = s > ROUNDING**0.5 * s[:1]
        q = (flat @ (vt[kept].T / s[kept])).reshape(*self.tau.shape, -1)
        residual = self.tau - q @ torch.einsum("jic,ji->c", q, self.tau)
        return _Beside(self, q, residual)


@dataclass(frozen=True, eq=False)
class _Beside:
    """An orthonormal basis (n, I, K) of what is fitted, and the residual (n, I) that it leaves."""

    rows: _Rows
    basis: Float[Tensor, "n I K"]
    residual: Float[Tensor, "n I"]

    def gain(self, effect: Effect) -> float:
        """By how much the residual's squares fall with an effect; 0 if its one coefficient would
        have a sign that physics forbids."""
        columns = self.rows.of(effect)
        count = len(effect.coefficients)
        inner = torch.zeros(count, count, dtype=torch.float64)
        pull = torch.zeros(count, dtype=torch.float64)
        held = torch.zeros(self.basis.shape[-1], count, dtype=torch.float64)
        for j, x in columns.items():
            inner += x.T @ x
            pull += x.T @ self.residual[j]
            held += self.basis[j].T @ x
        size = inner.diagonal().sqrt().clamp(min=1e-300)
        left = (inner - held.T @ held) / size / size.unsqueeze(-1)
        values, vectors = torch.linalg.eigh(left)
        along = vectors.T @ (pull / size)
        told = values > ROUNDING
        if count == 1 and effect.coefficients[0].non_negative and float(pull[0]) <= 0:
            return 0.0
        return float((along[told].square() / values[told]).sum())
