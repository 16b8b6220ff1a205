"""The robot in a pose of its log, drawn by its joints: what each joint's error is, what the causes
remove of it, and which they are."""

import itertools
from collections.abc import Sequence
from textwrap import wrap
from typing import Any

import numpy as np
import torch

from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.position.diagnosis import PositionDiagnosis
from torchid.report.colours import BEFORE, GREY, GRID, INK
from torchid.report.panels import SMALL, Figure, new_figure
from torchid.results.answer import Answer
from torchid.results.cause import LINK
from torchid.results.words import joint_labels, short
from torchid.robot.model import FREE, JointType, Robot, link_poses
from torchid.typing import Float, Tensor

PHONE = 3.6
"""Width on a phone [inch]."""
_POSES, _VIEWS, _TILT = 40, 12, 0.3  # that are tried, and how far it is looked at from above [rad]
_LARGEST, _SMALLEST, _DOT = 0.26, 0.08, 0.025  # radii of joints, and of their axes [inch]
_LINE, _COLUMN = 0.155, 1.85  # height of one, and width of a column of them [inch]


def _places(robot: Robot, q: Float[Tensor, "K n"]) -> tuple[np.ndarray, list[tuple[int, int]]]:
    """Points of the robot (K, P, 3): the base, each link's joint, and the ends of the branches; and
    which of them are held together, by their numbers."""
    poses = link_poses(robot, q)
    count = robot.n_links
    before = robot.before.to(q)
    bones = []
    points = [torch.zeros(len(q), 3, dtype=q.dtype)]
    for link, parent in enumerate(robot.parents):
        own = before[link] if parent < 0 else poses[:, parent] @ before[link]
        points.append(own[..., :3, 3].expand(len(q), 3))
        bones.append((parent + 1, link + 1))
    for k, end in enumerate(robot.ends):
        points.append((poses[:, end.link] @ end.pose.to(q))[:, :3, 3])
        bones.append((end.link + 1, count + 1 + k))
    if (roots := [link + 1 for link, parent in enumerate(robot.parents) if parent < 0])[1:]:
        # A body with several limbs is drawn where they are, wherever its frame may be.
        points[0] = torch.stack([points[r] for r in roots]).mean(0)
    return torch.stack(points, 1).numpy(), bones


def _views(up: np.ndarray) -> list[np.ndarray]:
    """(2, 3) projections that keep what is up upright, from all sides."""
    side = np.cross(up, np.eye(3)[int(np.abs(up).argmin())])
    side /= np.linalg.norm(side)
    front = np.cross(up, side)
    out = []
    for angle in 2 * np.pi * (np.arange(_VIEWS) + 0.5) / _VIEWS:
        right = np.cos(angle) * side + np.sin(angle) * front
        ahead = np.cross(up, right)
        out.append(np.stack([right, np.cos(_TILT) * up + np.sin(_TILT) * ahead]))
    return out


def _clearest(points: np.ndarray, up: np.ndarray) -> np.ndarray:
    """The points (P, 2) in the pose, and from the side, in which they are farthest apart."""
    best, chosen = -np.inf, np.zeros((points.shape[1], 2))
    for view, pose in itertools.product(_views(up), points):
        flat = pose @ view.T
        # Points that are one from everywhere count no pose for or against.
        apart = np.linalg.norm(pose[:, None] - pose[None], axis=-1)
        seen = np.linalg.norm(flat[:, None] - flat[None], axis=-1)
        pairs = apart > 1e-3 * apart.max()
        size = max(np.ptp(flat, axis=0).max(), 1e-9)
        score = np.log(np.maximum(seen[pairs] / size, 1e-3)).mean() if pairs.any() else 0.0
        if score > best:
            best, chosen = score, flat / size
    return chosen


def _kept_apart(places: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Discs (n, 2) moved as little as keeps them from covering each other."""
    out = places + 1e-4 * np.random.default_rng(0).standard_normal(places.shape)
    for _ in range(200):
        between = out[:, None] - out[None]
        far = np.linalg.norm(between, axis=-1) + np.eye(len(out))
        lack = np.maximum(0.0, 0.9 * (radii[:, None] + radii[None]) - far)
        np.fill_diagonal(lack, 0.0)
        if lack.max(initial=0.0) < 1e-4:
            break
        out += 0.5 * ((lack / far)[..., None] * between).sum(1)
    return out


def _rows(wanted: np.ndarray, heights: np.ndarray, height: float) -> np.ndarray:
    """Middles of labels, in falling order, near to where they are wanted, apart from each other and
    inside the figure."""
    middles, limit = wanted.copy(), height / 2
    for k, own in enumerate(heights):
        middles[k] = min(middles[k], limit - own / 2)
        limit = middles[k] - own / 2
    limit = -height / 2
    for k in reversed(range(len(heights))):
        middles[k] = max(middles[k], limit + heights[k] / 2)
        limit = middles[k] + heights[k] / 2
    return middles


def _pose(robot: Robot, q: Float[Tensor, "T n"]) -> tuple[np.ndarray, list[tuple[int, int]]]:
    """Points of the robot (P, 2) in the pose of a log, and from the side, that show it best, and
    which of them are held together."""
    some = q[:: max(1, len(q) // _POSES)]
    some = some[torch.isfinite(some).all(1)].to(torch.float64)
    points, bones = _places(robot, some if len(some) else torch.zeros(1, robot.n).double())
    gravity = robot.gravity.numpy().astype(float)
    size = float(np.linalg.norm(gravity))
    return _clearest(points, -gravity / size if size > 0 else np.array([0.0, 0.0, 1.0])), bones


def _labels(robot: Robot, answer: Answer) -> dict[int, list[str]]:
    """Lines beside each joint: its name with its errors, then its causes, the largest first."""
    causes: dict[int, list[str]] = {j: [] for j in range(robot.n)}
    for cause in sorted(answer.entries, key=lambda c: -c.share):
        own: Sequence[int] = cause.at
        if cause.effect == LINK:  # the joints that move links, or carry them nearest
            own = [robot.drives[k].coordinate if k < robot.n_links else robot.n - 1 for k in own]
        for j in own:
            causes[j].append(cause.name)
    names, labels = joint_labels([j.name for j in answer.joints]), {}
    # Coordinates of a base that moves are no joints.
    # Causes beside a joint
    most_named = 2
    # of a line beside a joint
    letters = 22
    for j in range(FREE if robot.floating else 0, robot.n):
        one, error = answer.joints[j], "never moves"
        if one.before > 0:
            error = f"{one.before:.3g} \u2192 {one.after:.3g}"
        name = short(names[j].removesuffix("_joint"), letters - len(error) + 4)
        every = list(dict.fromkeys(causes[j]))
        lines = [line for text in every[:most_named] for line in wrap(text, letters)]
        labels[j] = [f"{name}   {error}", *lines]
        if len(every) > most_named:
            labels[j].append(f"and {len(every) - most_named} more")
    return labels


def skeleton_figure(
    robot: Robot, answer: Answer, q: Float[Tensor, "T n"], width: float = 6.4
) -> Figure:
    """The robot by its joints, in the pose of a log that shows them best.

    The whole disc of a joint is the error of the model as given, its solid part what remains with
    the causes (areas); squares are prismatic joints.

    Args:
        robot: any tree.
        answer: of a diagnosis of it.
        q: positions of the log [rad; m].
        width: of the figure [inch].
    """
    flat, bones = _pose(robot, q)
    before, after = (
        np.array([max(0.0, x) if x == x else 0.0 for x in (getattr(j, key) for j in answer.joints)])
        for key in ("before", "after")
    )
    largest = max(before.max(initial=0.0), after.max(initial=0.0), 1e-12)
    most = _LARGEST * min(1.0, (8 / robot.n) ** 0.5)
    radii, left = (most * np.sqrt(x / largest) for x in (before, after))
    hubs = np.maximum(np.maximum(radii, left), _SMALLEST)
    joints, labels = [link + 1 for link in robot.own_links], _labels(robot, answer)

    # Labels stand in two columns, each joint's on its side of the middle; a phone has numbers only.
    low, high = flat.min(0), flat.max(0)
    side_by_side = width > PHONE
    ordered = sorted(labels, key=lambda j: float(flat[joints[j], 0]))
    half = len(ordered) // 2
    sides = ((-1, ordered[:half]), (1, ordered[half:])) if side_by_side else ()
    tall = [_LINE * sum(len(labels[j]) + 0.9 for j in own) for _, own in sides]
    room = width - 2 * (_COLUMN if side_by_side else 0.2) - 2 * _LARGEST
    span = np.maximum(high - low, 0.15)
    # 4.2: robot [inch]
    scale = min(room / span[0], 4.2 / span[1])
    height = max(scale * span[1] + 3 * _LARGEST, *tall, 1.5) + 0.4
    figure = new_figure(width, height)
    figure.set_layout_engine("none")
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(-width / 2, width / 2), ylim=(-height / 2, height / 2), aspect="equal")
    axes.set_axis_off()
    at = (flat - 0.5 * (low + high)) * scale
    at[joints] = _kept_apart(at[joints], hubs)
    # Discs that moved may lie beside the figure's middle.
    ends = np.concatenate([at, *(at[joints] + s * hubs[:, None] for s in (-1, 1))])
    at -= 0.5 * (ends.min(0) + ends.max(0))
    for a, b in bones:
        axes.plot(*at[[a, b]].T, color=GREY, linewidth=9, solid_capstyle="round", alpha=0.45)
    if robot.parents.count(-1) == 1 and not robot.floating:
        axes.plot(at[0, 0] + np.array([-0.3, 0.3]), [at[0, 1]] * 2, color=INK, linewidth=3)
    for k in range(len(robot.ends)):
        axes.plot(*at[robot.n_links + 1 + k], "o", color=INK, markersize=4)
    for j in labels:
        slides = robot.joint_types[j] is JointType.PRISMATIC
        _draw_joint(axes, at[joints[j]], slides, hubs[j], radii[j], left[j])
        if not side_by_side:
            axes.text(at[joints[j], 0] + hubs[j], at[joints[j], 1] + hubs[j], str(j + 1),
                      fontsize=SMALL, fontweight="bold", color=INK, zorder=9)  # fmt: skip
    for side, members in sides:
        _write_labels(axes, side, [(at[joints[j]], labels[j]) for j in members])
    return figure


def _draw_joint(axes: Any, at: Any, slides: bool, *sizes: float) -> None:
    """A joint's hub, its error before and what is left of it, by their radii [inch]."""
    from matplotlib.patches import Circle, Rectangle

    # 0.32: opacity of what the causes remove
    looks = ((GRID, 1.0), (BEFORE, 0.32), (BEFORE, 1.0), (INK, 1.0))
    for k, (radius, (colour, opacity)) in enumerate(zip((*sizes, _DOT), looks, strict=True)):
        shape = Rectangle(at - radius, 2 * radius, 2 * radius) if slides else Circle(at, radius)
        shape.set(color=colour, alpha=opacity, linewidth=0, zorder=4 + k)
        axes.add_patch(shape)


def _write_labels(axes: Any, side: int, members: Sequence[tuple[np.ndarray, list[str]]]) -> None:
    """Labels of some joints in the column of their side (-1, 1), each with a line to its joint."""
    width, height = axes.get_xlim()[1] * 2, axes.get_ylim()[1] * 2
    own = sorted(members, key=lambda member: -float(member[0][1]))
    heights = np.array([_LINE * (len(lines) + 0.9) for _, lines in own])
    middles = _rows(np.array([at[1] for at, _ in own]), heights, height - 0.2)
    edge, near = side * (width / 2 - 0.02), side * (width / 2 - _COLUMN + 0.1)
    for ((x, y), lines), middle in zip(own, middles, strict=True):
        top = middle + _LINE * (len(lines) - 1) / 2
        line = top - 0.085
        axes.plot([x, near, edge], [y, line, line], color=GREY, linewidth=0.6, zorder=3)
        for k, text in enumerate(lines):
            axes.text(
                edge, top - k * _LINE - (0.09 if k else 0), text, fontsize=SMALL, color=INK,
                fontweight="normal" if k else "bold", va="center", zorder=9,
                ha="right" if side > 0 else "left",
            )  # fmt: skip


def skeleton_of(d: TorqueDiagnosis | PositionDiagnosis, width: float = 6.4) -> Figure:
    """The skeleton of a diagnosis that holds motion."""
    if isinstance(d, PositionDiagnosis):
        return skeleton_figure(d.data.robot, d.answer, d.data.q, width)
    q = torch.cat([t.motion.q[t.valid] for t in d.traces])
    return skeleton_figure(d.robot, d.answer, q, width)
