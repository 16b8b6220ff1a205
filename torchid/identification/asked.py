"""The effects that an identification is asked for: kinds, places and shapes, as they are written;
and the search for shapes (a Stribeck speed, a wave number) that nobody gave.

viscous_friction                        on every joint
joint_spring:joint=2,curvature=0        on joint 2, its shape given
stribeck_friction:joint=3               its shape, vs, is searched
gear_coupling:joint=6,source_joint=5    on a pair of joints
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import product

import torch

from torchid.effects.base import Effect, JointEffect, Motion
from torchid.effects.names import PLACES
from torchid.effects.registry import effect_from_record, fitted_kind
from torchid.effects.written import name_and_pairs
from torchid.errors import TorchidError
from torchid.identification.least_squares import Fit
from torchid.identification.rows import RowSource, sampled
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor


@dataclass(frozen=True)
class AskedEffect:
    """An effect at one place.

    Attributes:
        effect: with the shapes that are given, and any value for the others.
        searched: names of those others.
    """

    effect: Effect
    searched: tuple[str, ...]

    @property
    def plain(self) -> bool:
        """Whether its columns are known, and functions of the present motion alone."""
        return not (self.searched or self.effect.needs or self.effect.over_time)


def asked_effects(written: Sequence[str], robot: Robot) -> tuple[AskedEffect, ...]:
    """Effects of a robot, kind by kind in the order in which they are first named.

    Raises:
        TorchidError: an effect that cannot be fitted beside base parameters, an unknown key or a
            joint that the robot does not have, a place named twice.
    """
    asked_for = [asked for text in written for asked in _places(text, robot)]
    order = list(dict.fromkeys(a.effect.name for a in asked_for))
    asked_for.sort(key=lambda a: order.index(a.effect.name))
    places = [a.effect.identity for a in asked_for]
    twice = [identity for k, identity in enumerate(places) if identity in places[:k]]
    if twice:
        name, joints = twice[0]
        where = " and ".join(f"joint {j + 1}" for j in joints)
        raise TorchidError(
            "an effect is named twice.", got=f"{name} of {where}", expected="each place once"
        )
    gains = [a.effect.name for a in asked_for if a.effect.scale_of_torque]
    if len(gains) == len(robot.driven):
        raise TorchidError(
            "torque gains of all joints cannot be identified: a gain that they share is the same "
            "as heavier bodies.",
            got=f"{gains[0]} on all {robot.n} joints",
            expected=f"{gains[0]}:joint=J, and one joint at least whose torque is trusted",
        )
    return tuple(asked_for)


def _places(text: str, robot: Robot) -> list[AskedEffect]:
    """The effect at the places that are named; at every place where none is."""
    name, given = name_and_pairs(text, "effect")
    kind = fitted_kind(name)
    own = [f.name for f in fields(kind)]
    unknown = [key for key in given if key not in own]
    if unknown:
        what = "a coefficient, which is what is identified"
        known = unknown[0] in [c.name for c in kind.coefficients]
        raise TorchidError(
            f"effect {text}: '{unknown[0]}' "
            + (f"is {what}." if known else f"does not belong to {kind.name}."),
            available=own,
        )
    shapes = {s.name: s.grid[len(s.grid) // 2] for s in kind.shapes if s.grid}
    searched = tuple(s for s in shapes if s not in given)
    values = {**shapes, **{k: v for k, v in given.items() if k not in PLACES}}
    where = {k: v for k, v in given.items() if k in PLACES}
    # Joints, from 1, of every place where the effect can be.
    names = [p for p in PLACES if p in own]
    joints = dict.fromkeys(e.identity[1] for e in kind.candidates(robot))
    places = [dict(zip(names, (j + 1 for j in at), strict=True)) for at in joints]
    zeros = {c.name: 0.0 for c in kind.coefficients}
    effects = [
        effect_from_record({"effect": kind.name, **place, **zeros, **values}, robot)[0]
        for place in places
        if all(place[k] == v for k, v in where.items())
    ]
    if not effects:
        raise TorchidError(
            f"effect {text}: there is no such place on this arm.",
            available=[",".join(f"{k}={v}" for k, v in p.items()) for p in places],
        )
    return [AskedEffect(effect, searched) for effect in effects]


def with_shapes(effect: Effect, names: Sequence[str], values: Sequence[float]) -> Effect:
    """The effect with other values of some of its shapes."""
    return replace(effect, **dict(zip(names, values, strict=True)))


ROUNDING = 1e-9
"""Share of a column's square left beside the fit below which the column says nothing of its own."""


def search_shapes(
    unknown: Sequence[AskedEffect],
    source: RowSource,
    fitted: Fit,
    cutoff: float | None,
) -> list[Effect | None]:
    """Effects with the shapes that leave least of the residual; None for one that these motions
    cannot show.

    An effect is linear in its coefficients once its shape is given. So a shape is judged by how
    much the weighted squares of the residual fall when the effect joins all else that is fitted,
    with coefficients refitted each time: its grid first, then five times seven values around the
    best, ever closer. Effects are taken one after another; where several of one joint are
    searched, each of them once more beside the others.

    Args:
        unknown: with shapes to search.
        source: rows of all that is fitted beside them, of trajectories with t and the torque of
            the fit.
        fitted: its fit, whose weights are used.
        cutoff: [Hz] of the rows.
    """
    rows = _Rows(source, fitted)
    band = cutoff if cutoff is not None else 0.2 * source.measured[0].rate
    best: list[Effect | None] = [None] * len(unknown)
    users = Counter(j for a in unknown for j in a.effect.joints)
    again = [k for k, a in enumerate(unknown) if any(users[j] > 1 for j in a.effect.joints)]
    for k in (*range(len(unknown)), *again):
        others = [e for j, e in enumerate(best) if e is not None and j != k]
        beside = rows.beside(others)
        # The best shape of the grid, refined; none where none tells anything.
        now, largest = unknown[k].effect, 0.0
        # 5: times that a shape is refined: to less than a hundredth of the grid's step
        for level in range(-1, 5):
            for effect in _tried(now, unknown[k].searched, rows.motions, level, band):
                gain = beside.gain(effect)
                if gain > largest:
                    now, largest = effect, gain
            if largest == 0:
                break
        best[k] = now if largest > 0 else None
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

    def __init__(self, source: RowSource, fitted: Fit):
        self.measured = source.measured
        self.motions = [m.whole for m in source.measured]
        self._weight = (fitted.robust * fitted.whitening.diagonal()).T
        n, size = self._weight.shape[0], source.layout.size
        blocks = list(source)
        self.columns = torch.zeros(n, self._weight.shape[1], size, dtype=torch.float64)
        for i, c in enumerate(source.layout.columns):
            own = torch.cat([b.matrices[i] for b in blocks])
            self.columns[i, :, list(c)] = own * self._weight[i].unsqueeze(-1)
        self.tau = torch.cat([b.tau for b in blocks]).T * self._weight

    def of(self, effect: Effect) -> dict[int, Float[Tensor, "I C"]]:
        """Columns of an effect by joint."""
        parts = [effect.own_columns(motion) for motion in self.motions]
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
        clear = values > ROUNDING
        if count == 1 and effect.coefficients[0].non_negative and float(pull[0]) <= 0:
            return 0.0
        return float((along[clear].square() / values[clear]).sum())
