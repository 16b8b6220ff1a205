"""Which effects look alike: angles between the spans of their columns along a motion.

Two effects at the same place are confused where some combination of the one's columns is nearly
some combination of the other's. The largest canonical correlation of the two spans, the cosine of
their smallest principal angle, says how nearly (Bjorck and Golub 1973, Numerical methods for
computing angles between linear subspaces). It is taken of the torque itself, not about its mean,
for a constant torque is an effect too. Nothing is projected out: beside refitted base parameters
more effects look alike, and a wrong body would not be seen at all.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torchid.effects.base import Effect, JointEffect, ModelEffect, Motion
from torchid.effects.registry import KINDS
from torchid.robot.model import Robot
from torchid.typing import Float

ALIKE = 0.8
"""Correlation from which an effect is a rival: the other has two thirds of its energy."""


class Rival(NamedTuple):
    """An effect that another one is confused with.

    Attributes:
        name: of the rival.
        correlation: largest canonical correlation, at the joint and shapes where it is largest.
        joint: that joint, from 0; None for two effects of the whole arm.
    """

    name: str
    correlation: float
    joint: int | None

    @property
    def same(self) -> bool:
        """Whether no motion of this kind tells them apart."""
        # 1e-6: correlation short of 1 up to which two effects are the same, whatever their
        # coefficients
        return self.correlation > 1 - 1e-6


@dataclass(frozen=True)
class _Span:
    """Orthonormal columns of one effect at one place, for all its shapes.

    Attributes:
        name: of the effect.
        joint: of the place; None for the whole arm.
        source: other joint of the place; None where there is none.
        basis: (S, R, C) rows of that joint, or of all joints one after another.
        own: whether the rows are the joint's.
    """

    name: str
    joint: int | None
    source: int | None
    basis: Float[Tensor, "S R C"]
    own: bool


def rivals(
    robot: Robot,
    motions: Sequence[Motion],
    cutoff: float,
    *,
    joints: Sequence[int] | None = None,
    kinds: Mapping[str, type[Effect]] = KINDS,
    alike: float = ALIKE,
) -> dict[str, tuple[Rival, ...]]:
    """For every effect those that it is confused with, the most alike first; the nearest one where
    none is that much alike.

    Args:
        robot: with parameters.
        motions: with t and torque, each on a uniform grid.
        cutoff: of the band that waves along the position must lie in [Hz].
        joints: where effects of one joint are compared, from 0; all if None.
        kinds: effects by name.
        alike: correlation from which an effect is listed.
    """
    places = range(robot.n) if joints is None else joints
    spans = [
        span for kind in kinds.values() for span in _spans(kind, robot, motions, cutoff, places)
    ]
    best: dict[tuple[str, str], Rival] = {}
    for k, a in enumerate(spans):
        for b in spans[k + 1 :]:
            if a.name == b.name or not _same_place(a, b):
                continue
            joint = a.joint if a.joint is not None else b.joint
            size = _correlation(a, b, robot.n)
            for one, other in ((a.name, b.name), (b.name, a.name)):
                last = best.get((one, other))
                if last is None or size > last.correlation:
                    best[one, other] = Rival(other, size, joint)
    out = {}
    for name in kinds:
        found = sorted((r for (one, _), r in best.items() if one == name), key=_order)
        near = [r for r in found if r.correlation >= alike]
        out[name] = tuple(near or found[:1])
    return out


def aged(effect: Effect, motion: Motion, values: Sequence[float] = (1.0,)) -> Motion:
    """The motion with the age of its samples, which comes with the effect that holds samples."""
    if "age" not in effect.needs or not isinstance(effect, ModelEffect):
        return motion
    return motion._replace(age=effect.measured(motion, values).age)


def _order(rival: Rival) -> tuple[float, str]:
    """The most alike first; what rounding might swap goes by name."""
    return -round(rival.correlation, 6), rival.name


def _same_place(a: _Span, b: _Span) -> bool:
    """Whether two effects act on the same joint, or one of them on the whole arm."""
    if None in (a.joint, b.joint):
        return True
    return a.joint == b.joint and (None in (a.source, b.source) or a.source == b.source)


def _spans(
    kind: type[Effect],
    robot: Robot,
    motions: Sequence[Motion],
    cutoff: float,
    places: Sequence[int],
) -> list[_Span]:
    """Spans of an effect at its places; none where it has no torque."""
    out = []
    if issubclass(kind, JointEffect):
        for joint in places:
            shapes = [s.reshape(-1, 1, 1) for s in kind.grid(motions, joint, cutoff).unbind(1)]
            parts = [kind.formula(m, *shapes)[..., joint, :] for m in motions]
            columns = torch.cat(parts, -2)
            basis = _basis(columns if shapes else columns.unsqueeze(0))
            out.append(_Span(kind.name, joint, None, basis, own=True))
    elif issubclass(kind, ModelEffect):
        for effect in kind.candidates(robot):
            at = effect.joints[0] if effect.joints else None
            if at is not None and at not in places:
                continue
            basis = _basis_of_all([effect.torque_columns(aged(effect, m), robot) for m in motions])
            source = getattr(effect, "source_joint", None)
            out.append(_Span(kind.name, at, source, basis, own=False))
        if kind.shared:
            everywhere = [
                torch.stack([e.torque_columns(m, robot) for e in kind.candidates(robot)]).sum(0)
                for m in motions
            ]
            out.append(_Span(kind.name, None, None, _basis_of_all(everywhere), own=False))
    return [span for span in out if span.basis.shape[0]]


def _basis_of_all(parts: Sequence[Float[Tensor, "_ n C"]]) -> Float[Tensor, "1 R C"]:
    """Basis of torque on all joints, joint after joint."""
    return _basis(torch.cat(list(parts)).movedim(1, 0).flatten(0, 1).unsqueeze(0))


def _basis(columns: Float[Tensor, "S R C"]) -> Float[Tensor, "S R C"]:
    """Orthonormal bases; directions that are rounding are zero."""
    size = columns.norm(dim=1, keepdim=True)
    unit = columns / torch.where(size > 0, size, 1.0)
    u, s, _ = torch.linalg.svd(unit, full_matrices=False)
    # 1e-6: of columns of length one: directions below it are rounding, or secants' curvature
    return u * (s > 1e-6 * s[..., :1].clamp(min=1e-300)).to(u).unsqueeze(1)


def _correlation(a: _Span, b: _Span, n: int) -> float:
    """Largest singular value of Qa' Qb over all shapes of both."""
    qa, qb = a.basis, b.basis
    if a.own != b.own:
        # Of the effect of several joints, the rows of the other's joint.
        joint = a.joint if a.own else b.joint
        assert joint is not None
        qa, qb = (q if x.own else q.unflatten(1, (n, -1))[:, joint] for x, q in ((a, qa), (b, qb)))
    cross = torch.einsum("arc,brd->abcd", qa, qb).flatten(0, 1)
    return min(1.0, float(torch.linalg.matrix_norm(cross, ord=2).max())) if len(cross) else 0.0
