"""How far the internal forces can be from a reference's, as far as the torque and each kind of
condition go: no sampling, and so no distribution that was chosen by somebody.

Among the sets with the reference's torque, x = x_ref + N z, the force at joint i differs by a
linear function of z, and its mean square over a motion is z' G_i z. With G_i = sum of l_k e_k e_k',

    max z'G_i z  <=  sum of l_k (max |e_k'z|)^2,

and each max |e_k'z| over a convex region is a pair of conic programs. From the best of their
solutions, z <- argmax (G_i z)'z climbs to a local maximum (z'G z is convex, so every step is up).
The greatest error lies between the two: reached <= greatest <= bound.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import torch

from torchid.design.bodies import triangle
from torchid.effects.base import Motion
from torchid.extraction.convex.conic import Rows, minimise
from torchid.results.record import Col
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor
from torchid.wrenches.regressor import internal_wrenches
from torchid_study.equal_torque.hit_and_run import Region, analytic_centre, interior_point
from torchid_study.equal_torque.sample import EqualTorqueSpace

KINDS = ("feasible", "inertia", "com", "total_mass", "inertia+com")
"""Kinds whose regions are convex; a negative mass makes its link's conditions another's."""


@dataclass(frozen=True, eq=False)
class ForceReach:
    """Greatest force error of the sets of one kind, in root mean square over a motion.

    Attributes:
        kind: of condition that need not be met; `feasible` when all must.
        reached: (n,) error of a set that was found, per joint [N].
        bound: (n,) that no such set exceeds [N].
    """

    kind: Annotated[str, Col("what may be violated")]
    reached: Annotated[Float[Tensor, " n"], Col()]
    bound: Annotated[Float[Tensor, " n"], Col()]


def force_squares(
    robot: Robot, motion: Motion, directions: Float[Tensor, "P D"]
) -> Float[Tensor, "n D D"]:
    """G_i: mean square force at each joint along changes `directions` z, z'G_i z [N^2]."""
    rigid = InertialParameters.from_paper_order(directions.T.contiguous())
    force = internal_wrenches(robot, *motion.state, rigid)[..., :3]
    d, t = force.shape[:2]
    flat = force.permute(2, 0, 1, 3).reshape(robot.n, d, 3 * t)
    return flat @ flat.mT / t


def force_reach(
    space: EqualTorqueSpace,
    squares: Float[Tensor, "n D D"],
    kinds: Sequence[str] = KINDS,
) -> tuple[ForceReach, ...]:
    """The greatest force errors of each kind of set, see the module's text.

    Args:
        space: of the reference.
        squares: see `force_squares`.
        kinds: of `KINDS`; one without any set, or without a condition to violate, is left out.
    """
    reaches = []
    for kind in kinds:
        cone = _cone(space, frozenset(kind.split("+")) - {"feasible"})
        if cone is None:
            continue
        both = [cone.reach(square) for square in squares]
        reached, bound = torch.tensor(both, dtype=squares.dtype).T
        reaches.append(ForceReach(kind, reached, bound))
    return tuple(reaches)


@dataclass(frozen=True, eq=False)
class _Cone:
    """A region in coordinates y of z = origin + axes y, in which it is round."""

    rows: tuple[Rows, ...]
    origin: np.ndarray
    axes: np.ndarray

    def furthest(self, direction: np.ndarray) -> np.ndarray | None:
        """The z that goes furthest along a direction; None where the solver fails."""
        cost = -(self.axes.T @ direction)
        size = float(np.linalg.norm(cost))
        if size == 0.0:
            return self.origin
        solution = minimise(cost / size, self.rows)
        return self.origin + self.axes @ solution.point if solution.usable else None

    def reach(self, square: Tensor) -> tuple[float, float]:
        """Root mean squares reached and not exceeded; nan where the solver fails."""
        g = square.numpy()
        values, vectors = np.linalg.eigh(g)
        total, z = 0.0, self.origin
        # Thin directions together: l_k |e_k'z|^2 <= l |z|^2 would need |z|; each has its own pair.
        for value, axis in zip(values[::-1], vectors.T[::-1], strict=True):
            # 1e-4: principal axes of G below this share of the largest count by a rougher bound
            if value <= 1e-4**2 * values[-1]:
                break
            far = [self.furthest(sign * axis) for sign in (1.0, -1.0)]
            ends = [end for end in far if end is not None]
            if len(ends) < 2:
                return float("nan"), float("nan")
            total += value * max(float(axis @ end) ** 2 for end in ends)
            z = max([z, *ends], key=lambda end: float(end @ g @ end))
        # 4: starts of a climb
        for _ in range(4):
            higher = self.furthest(g @ z)
            if higher is None or higher @ g @ higher <= z @ g @ z * (1 + 1e-6):
                break
            z = higher
        best = float(z @ g @ z)
        return best**0.5, max(total, best) ** 0.5


def _cone(space: EqualTorqueSpace, relaxed: frozenset[str]) -> _Cone | None:
    """The region of a kind as conic rows; None if it has no interior or nothing is relaxed."""
    limits = space.limits(1)
    if "com" in relaxed:
        if bool((space.widest == space.conditions.com_box).all()):
            return None
        limits = replace(limits, com=space.widest.unsqueeze(0))
    if "total_mass" in relaxed:
        if not bool(torch.isfinite(space.conditions.total_mass).any()):
            return None
        free = limits.total.new_tensor([[0.0, float(space.heaviest.sum())]])
        limits = replace(limits, total=free)
    if "inertia" in relaxed:
        # Only |J| limits the inertias then; depth for the barrier to have an inside.
        depth = 4 * space.inertia.amax(-1)
        limits = replace(limits, second=-depth.unsqueeze(0))
    region = space.region(limits)
    start, inside = interior_point(region)
    if not bool(inside[0]):
        return None
    # 80: Newton steps at most
    centre, axes = analytic_centre(region, start, 80)
    rows = _rows(region.at(centre, axes), with_bodies="inertia" not in relaxed)
    return _Cone(rows, centre[0].numpy(), axes[0].numpy())


def _rows(region: Region, *, with_bodies: bool) -> tuple[Rows, ...]:
    """One region's inequalities, each scaled to size 1 at the origin."""
    a, b = region.a[0].numpy(), region.b[0].numpy()
    used = np.abs(a).max(1) > 0
    a, b = a[used], b[used]
    rows = [Rows("linear", "nonnegative", a / b[:, None], np.ones_like(b), np.zeros_like(b))]
    d = a.shape[1]
    f = region.f[0].reshape(-1, 4, 4, d).permute(0, 3, 1, 2).numpy()
    c = region.c[0].reshape(-1, 4, 4).numpy()
    bodies = region.c.shape[1] // 16
    for k in range(bodies if with_bodies else 0):
        size = float(np.abs(c[k]).max())
        matrix, offset = triangle(f[k] / size).T, triangle(c[k] / size)
        rows.append(Rows(f"block_{k + 1}", "semidefinite", matrix, offset, np.zeros_like(offset)))
    return tuple(rows)
