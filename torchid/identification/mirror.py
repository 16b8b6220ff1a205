"""Left and right as mirror images: what one side tells, the other one tells too.

A robot is its own mirror image where a plane takes every joint axis of one side to that of the
other. The reflection takes a pseudo-inertia J in the axes of link i to A J A' in those of its image
k, with A = X_k^-1 F X_i of the poses X at rest and the reflection F, an improper transform (Wensing
et al. 2018 have the pseudo-inertia). So the parameters of a mirrored robot are S times its own, and
since its torques are the mirrored ones, its base parameters are P times its own: G S = P G with
their grouping G. Left and right are one where (E - P) beta = 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from scipy.stats import chi2

from torchid.effects.base import Effect, JointEffect
from torchid.errors import RobotError, TorchidError
from torchid.identification.base_parameters import BaseParameters
from torchid.identification.knowledge import pooled
from torchid.robot.inertia import PARAMETERS_PER_LINK, move, paper_order
from torchid.robot.knowledge import NOTHING
from torchid.robot.model import JointType, Robot, link_poses
from torchid.robot.placement import pose
from torchid.typing import Bool, Float, Tensor

SAME = ("viscous_friction", "coulomb_friction", "rotor_inertia")
"""Effects whose coefficients are the same on both sides: those of gears of one type. Offsets and
the like are each drive's own."""

TOLERANCE = 1e-3
"""Distance of an axis from the mirrored one [m], and of directions [1]."""

DOUBT = 0.01
"""Probability, over all values together, that a symmetric robot is contradicted."""

TIGHT = 1e-3
"""Standard deviation of a difference that is held at zero, over that which the log gives it [1]."""

_TOLD = 4


@dataclass(frozen=True)
class Mirror:
    """Which joints are mirror images, and in which plane.

    Attributes:
        links: (L,) image of each link, from 0; a link in the plane is its own.
        coordinates: (n,) image of each coordinate.
        transforms: (L, 4, 4) A of each link, from its frame to its image's [1; m].
    """

    links: tuple[int, ...]
    coordinates: tuple[int, ...]
    transforms: Float[Tensor, "L 4 4"]


def mirror_of(robot: Robot, pairs: Sequence[str]) -> Mirror:
    """The mirror images among a robot's links, by the names of their joints, and by its geometry.

    Args:
        robot: its base held.
        pairs: `left:right`, `FL:FR`: what differs between the names of the two sides.

    Raises:
        TorchidError: a pair that names no two sides, or no joint of the robot.
        RobotError: a moving base, or no plane in which joints of such names are mirror images.
    """
    robot.require_fixed_base("mirror images")
    names = [drive.joint for drive in robot.drives]
    links = tuple(names.index(_image(name, names, pairs)) for name in names)
    coordinates = tuple(robot.drives[links[link]].coordinate for link in robot.own_links)
    for text in pairs:
        sides = text.split(":")
        if len(sides) != 2 or not all(sides) or all(_image(x, names, [text]) == x for x in names):
            raise TorchidError(
                "`mirror=...` names no two sides of this robot.",
                got=text,
                expected="left:right, of names of joints that differ by it alone",
                available=names,
            )
    # Joint frames with the robot at rest; of a revolute joint the axis turns the other way.
    at = link_poses(robot, torch.zeros(robot.n, dtype=torch.float64))
    frames = at @ torch.linalg.inv(robot.after)
    points, axes = frames[:, :3, 3], frames[:, :3, 2]
    images = torch.tensor(links)
    apart = (points - points[images])[images != torch.arange(len(links))]
    directions = [torch.linalg.svd(apart).Vh[0], *torch.eye(3, dtype=torch.float64)]
    worst = None
    for normal in directions:
        turn = torch.eye(3, dtype=torch.float64) - 2 * torch.outer(normal, normal)
        middle = ((points + points[images]) @ normal).mean() / 2
        there = points @ turn.T + 2 * middle * normal
        gap = there - points[images]
        away = torch.linalg.cross(gap, axes[images]).norm(dim=1)
        tilted = torch.linalg.cross(axes @ turn.T, axes[images]).norm(dim=1)
        sliding = torch.tensor([d.joint_type is JointType.PRISMATIC for d in robot.drives])
        off = torch.where(sliding, tilted, torch.maximum(away, tilted))
        if float(off.max()) < TOLERANCE and abs(float(robot.gravity @ normal)) < TOLERANCE * 9.81:
            flip = pose(turn, (2 * middle * normal).tolist())
            return Mirror(links, coordinates, torch.linalg.inv(at)[images] @ flip @ at)
        worst = off if worst is None or off.max() < worst.max() else worst
    assert worst is not None
    j = int(worst.argmax())
    raise RobotError(
        f"robot '{robot.name}' is not its own mirror image.",
        got=f"joints '{names[j]}' and '{names[links[j]]}', {float(worst[j]):.2g} m or rad apart "
        "once mirrored"
        if float(worst[j]) >= TOLERANCE
        else f"gravity {robot.gravity.tolist()}, not in the plane between the sides",
        expected=f"axes at rest that a plane takes to each other, to {TOLERANCE:g}",
    )


def _image(name: str, names: Sequence[str], pairs: Sequence[str]) -> str:
    """The name of the joint on the other side; the joint's own where there is none."""
    for text in pairs:
        left, _, right = text.partition(":")
        for old, new in ((left, right), (right, left)):
            parts = name.split(old) if old else []
            for k in range(1, len(parts)):
                other = old.join(parts[:k]) + new + old.join(parts[k:])
                if other in names:
                    return other
    return name


def mirrored_base(
    mirror: Mirror, base: BaseParameters, effects: Sequence[Effect]
) -> Float[Tensor, "B B"]:
    """P (B, B): base parameters of the mirrored robot from a robot's own.

    Raises:
        RobotError: the mirrored robot's torques are not the mirrored ones.
    """
    count = len(mirror.links)
    unit = torch.eye(PARAMETERS_PER_LINK, dtype=torch.float64)
    links = torch.zeros(count, PARAMETERS_PER_LINK, count, PARAMETERS_PER_LINK).double()
    for link, image in enumerate(mirror.links):
        links[image, :, link] = move(unit, mirror.transforms[link]).T
    order = paper_order(count)
    rigid = links.reshape(len(order), len(order))[order][:, order]
    keys = [
        (e.name, e.joint if isinstance(e, JointEffect) else None, k)
        for e in effects
        for k in range(len(e.coefficient_names()))
    ]
    swap = torch.zeros(len(keys), len(keys)).double()
    for column, (name, joint, k) in enumerate(keys):
        same = name in SAME and joint is not None
        key = (name, mirror.coordinates[joint], k) if same and joint is not None else None
        swap[keys.index(key) if key in keys else column, column] = 1.0
    whole = torch.block_diag(rigid, swap)
    grouping = base.grouping.double()
    across = grouping @ whole
    found = across @ torch.linalg.pinv(grouping)
    if float((across - found @ grouping).norm()) > 10 * TOLERANCE * float(across.norm()):
        raise RobotError(
            "the torques of this robot's mirror image are not its mirrored torques.",
            expected="joints that are mirror images, and friction on both sides or on none",
        )
    return found


def as_one(
    across: Float[Tensor, "B B"],
    base: BaseParameters,
    root: Float[Tensor, "D B"],
    values: Float[Tensor, " B"],
    free: Bool[Tensor, " B"],
) -> tuple[Float[Tensor, "K B"], tuple[str, ...]]:
    """Rows over base parameters that hold left and right together, as measured to be 0, and what
    is to be said.

    The bodies are held together or not, as a whole, for one heavier link is part of many base
    parameters; each coefficient of friction by itself. What the log contradicts is not held.

    Args:
        across: P, from `mirrored_base`.
        base: the base parameters.
        root: of the inverse covariance that the log gives them.
        values: that it gives them.
        free: which of them it determines.
    """
    apart = torch.eye(len(across)).to(across) - across
    apart = torch.where(apart.abs() > 1e-9, apart, 0.0)
    # Of parameters that are not determined nothing is known, of either side.
    usable = (apart.abs().amax(1) > 1e-6) & ~((apart != 0) & ~free).any(1)
    places = usable.nonzero().flatten()
    rows = apart[places]
    if not len(rows):
        return rows, ("left and right share no parameter that this log determines",)
    _, covariance, _ = pooled(root[:0], values, root, values)
    std = (rows @ covariance * rows).sum(1).clamp(min=1e-300).sqrt()
    rows = rows / std.unsqueeze(1)
    off = rows @ values
    rigid = places < base.n_rigid
    alone = (~rigid).nonzero().flatten()
    groups = [rigid, *(torch.arange(len(rows)) == k for k in alone)]
    clear = torch.zeros_like(rigid)
    for group in groups:
        if group.any():
            spread, axes = torch.linalg.eigh(rows[group] @ covariance @ rows[group].T)
            there = spread > NOTHING * spread[-1]
            square = float(((axes.T @ off[group])[there].square() / spread[there]).sum())
            if square > chi2.isf(DOUBT / len(groups), int(there.sum())):
                clear |= group
    said = []
    if clear.any():
        ranked = (off.abs() * clear).argsort(descending=True).tolist()[: min(_TOLD, len(off))]
        other = across @ values
        listed = "; ".join(
            f"{base.names[j]} is {float(values[j]):.4g}, of the other side {float(other[j]):.4g} "
            f"({abs(float(off[k])):.1f} standard deviations apart)"
            for k in ranked
            if bool(clear[k])
            for j in [int(places[k])]
        )
        said.append(f"left and right are no mirror images in {int(clear.sum())} values: {listed}")
    kept = ~clear
    said.append(f"left and right are held together in {int(kept.sum())} of {len(rows)} values")
    return rows[kept] / TIGHT, tuple(said)
