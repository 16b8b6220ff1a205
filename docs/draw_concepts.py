"""Draws the pictures of concepts.md, whose frames and torques torchid computes.

`python docs/draw_concepts.py`
"""

import math
from pathlib import Path

import torch

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.report.colours import BLUE, GREEN, GREY, INK, ORANGE, RED
from torchid.report.panels import new_figure, save
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot, link_poses
from torchid.robot.yaml_file import from_mapping

IMAGES = Path(__file__).parent / "img"
A, ALPHA, D, THETA = 1.2, math.radians(-60), 1.0, math.radians(-20)
CLEAR = {"facecolor": "white", "edgecolor": "none", "pad": 0.5}
MASS, LEVER, ANGLE = 2.0, 0.5, math.radians(35)


def one_joint(convention: str, row: dict[str, float]) -> Robot:
    """A robot of one row of a DH table."""
    return from_mapping(
        {"name": convention, "dh": {"convention": convention, "joints": [row]}}, convention
    )


def project(point: torch.Tensor) -> tuple[float, float]:
    """On paper: x to the lower right, y to the upper right, z up."""
    x, y, z = point.tolist()
    return 0.9 * x + 0.5 * y, z - 0.35 * x + 0.3 * y


def arrow(axes, start, end, colour, label="", width=1.6) -> None:
    (x0, y0), (x1, y1) = project(start), project(end)
    style = {"arrowstyle": "-|>", "color": colour, "lw": width, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (x1, y1), (x0, y0), arrowprops=style)
    at = (x1 + 0.22 * (x1 - x0), y1 + 0.22 * (y1 - y0))
    axes.text(*at, label, color=colour, fontsize=9, ha="center", va="center", bbox=CLEAR)
    axes.plot(*at, alpha=0)  # annotations do not widen the axes


def frame(axes, pose: torch.Tensor, index: str) -> None:
    origin = pose[:3, 3]
    for k, (name, colour) in enumerate(zip("xyz", (RED, GREEN, BLUE), strict=True)):
        arrow(axes, origin, origin + 0.5 * pose[:3, k], colour, f"${name}_{{{index}}}$")


def segment(axes, points, label: str, shift=(0.0, 0.0)) -> None:
    flat = [project(p) for p in points]
    axes.plot(*zip(*flat, strict=True), color=INK, linewidth=2.2, zorder=1)
    (x0, y0), (x1, y1) = flat
    axes.text((x0 + x1) / 2 + shift[0], (y0 + y1) / 2 + shift[1], label, fontsize=10, color=INK)


def axis_line(axes, origin, direction, label: str) -> None:
    ends = [project(origin - 0.45 * direction), project(origin + 1.45 * direction)]
    axes.plot(*zip(*ends, strict=True), color=GREY, linewidth=1.0, linestyle="--", zorder=0)
    axes.text(ends[1][0], ends[1][1] + 0.04, label, color=INK, fontsize=8, ha="center")


def dh_panel(axes, convention: str) -> None:
    row = {"a": A, "alpha": ALPHA, "d": D, "theta": THETA}
    base = torch.eye(4, dtype=torch.float64)
    moved = link_poses(one_joint(convention, row), torch.zeros(1, dtype=torch.float64))[0]
    start, end = base[:3, 3], moved[:3, 3]
    if convention == "classical":
        corner, turning, origin = start + D * base[:3, 2], base[:3, 2], start
        segment(axes, (start, corner), "d", (-0.14, 0.0))
        segment(axes, (corner, end), "a", (0.05, 0.05))
        order = "Rz($\\theta_i$) Tz($d_i$) Tx($a_i$) Rx($\\alpha_i$)"
        told = "joint i turns about $z_{i-1}$"
    else:
        corner, turning, origin = end - D * moved[:3, 2], moved[:3, 2], end
        segment(axes, (start, corner), "a", (0.1, 0.06))
        segment(axes, (corner, end), "d", (0.06, -0.1))
        order = "Rx($\\alpha_i$) Tx($a_i$) Rz($\\theta_i$) Tz($d_i$)"
        told = "joint i turns about $z_i$"
    axis_line(axes, origin, turning, "axis of joint i")
    frame(axes, base, "i-1")
    frame(axes, moved, "i")
    axes.set_title(f"{convention}: {order}\n{told}", fontsize=9, color=INK)
    axes.set_aspect("equal")
    axes.margins(0.06)
    axes.set_axis_off()


def dh_figure():
    figure = new_figure(8.6, 3.9)
    for axes, convention in zip(figure.subplots(1, 2), ("classical", "modified"), strict=True):
        dh_panel(axes, convention)
    return figure


def flat_arrow(axes, start, end, colour, label, offset=(0.0, 0.0)) -> None:
    style = {"arrowstyle": "-|>", "color": colour, "lw": 1.6, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", end, start, arrowprops=style)
    axes.text(end[0] + offset[0], end[1] + offset[1], label, color=colour, fontsize=9)


def inertia_figure():
    """One body, its tensor about the two points."""
    from matplotlib.patches import Ellipse

    body = InertialParameters.from_com(
        torch.tensor([2.0], dtype=torch.float64),
        torch.tensor([[0.5, 0.2, 0.0]], dtype=torch.float64),
        torch.tensor([[0.02, 0.0, 0.0, 0.05, 0.0, 0.06]], dtype=torch.float64),
    )
    about_frame, about_com = (
        t[0].tolist() for t in (body.inertia_about_link_frame, body.inertia_about_com)
    )
    figure = new_figure(7.4, 2.4)
    axes = figure.subplots()
    axes.add_patch(Ellipse((0.5, 0.2), 0.95, 0.42, angle=18, facecolor="#dbe4ee", edgecolor=GREY))
    flat_arrow(axes, (0, 0), (0.3, 0), RED, "x", (0.01, -0.05))
    flat_arrow(axes, (0, 0), (0, 0.3), GREEN, "y", (-0.05, 0.0))
    flat_arrow(axes, (0, 0), (0.5, 0.2), INK, "")
    for label, at in (("x", (0.68, 0.2)), ("y", (0.5, 0.38))):
        flat_arrow(axes, (0.5, 0.2), at, RED if label == "x" else GREEN, "")
    axes.plot([0, 0.5], [0, 0.2], "o", color=INK, markersize=4)
    axes.text(-0.16, -0.09, "link frame's origin", fontsize=8, color=INK)
    axes.text(0.2, 0.13, "c = (0.5, 0.2, 0) m", fontsize=8, color=INK, rotation=21)
    axes.text(0.52, 0.13, "centre of mass, m = 2 kg", fontsize=8, color=INK)
    text = (
        "inertia_about_com  I\n"
        f"  Izz = {about_com[5]:.2f} kg m²\n\n"
        "inertia_about_link_frame  J\n"
        "  J = I + m (c'c E - c c')\n"
        f"  Jzz = {about_com[5]:.2f} + 2 (0.5² + 0.2²) = {about_frame[5]:.2f} kg m²\n"
        f"  Jxy = - 2 · 0.5 · 0.2 = {about_frame[1]:.2f} kg m²\n\n"
        "both in the axes of the link frame;\nproducts of inertia with their minus sign"
    )
    axes.text(1.12, 0.2, text, fontsize=8.5, color=INK, va="center", family="monospace")
    axes.set_xlim(-0.2, 2.35)
    axes.set_ylim(-0.2, 0.6)
    axes.set_aspect("equal")
    axes.set_axis_off()
    return figure


def pendulum_torque() -> float:
    """Torque that holds a point mass at ANGLE above the horizontal: axis y, gravity along -z."""
    robot = one_joint("modified", {"a": 0.0, "alpha": math.pi / 2, "d": 0.0, "theta": 0.0})
    mass = torch.tensor([MASS], dtype=torch.float64)
    com = torch.tensor([[LEVER, 0.0, 0.0]], dtype=torch.float64)
    body = InertialParameters.from_com(mass, com, torch.zeros(1, 6, dtype=torch.float64))
    q = torch.tensor([ANGLE], dtype=torch.float64)
    return float(inverse_dynamics(robot, q, 0 * q, 0 * q, body))


def torque_figure():
    from matplotlib.patches import Arc

    figure = new_figure(7.4, 2.2)
    axes = figure.subplots()
    tip = (math.cos(ANGLE), math.sin(ANGLE))
    axes.plot([0, 1.1], [0, 0], color=GREY, linewidth=1, linestyle="--")
    axes.plot([0, tip[0]], [0, tip[1]], color=INK, linewidth=4, solid_capstyle="round")
    axes.plot(*tip, "o", color=INK, markersize=13)
    axes.plot(0, 0, "o", color=BLUE, markersize=11)
    axes.plot(0, 0, "o", color="white", markersize=4)
    axes.text(-0.5, -0.12, "joint axis z, towards you", fontsize=8, color=BLUE)
    axes.add_patch(Arc((0, 0), 1.0, 1.0, theta2=math.degrees(ANGLE), color=RED, linewidth=1.6))
    axes.text(0.55, 0.15, "q > 0", color=RED, fontsize=9)
    axes.add_patch(Arc((0, 0), 0.5, 0.5, theta1=60, theta2=150, color=ORANGE, linewidth=2))
    flat_arrow(axes, (-0.19, 0.16), (-0.222, 0.105), ORANGE, "")
    axes.text(-0.4, 0.3, "tau > 0", color=ORANGE, fontsize=9)
    flat_arrow(axes, tip, (tip[0], tip[1] - 0.42), GREEN, "gravity", (0.03, 0.0))
    text = (
        "tau is what the drive does to the link,\n"
        "positive along the axis, as q is.\n\n"
        f"Here it holds {MASS:g} kg, {LEVER:g} m from the axis,\n"
        f"{math.degrees(ANGLE):.0f}° above the horizontal:\n"
        f"tau = m g c cos q = +{pendulum_torque():.2f} N m\n\n"
        "Friction is what the drive overcomes:\n"
        "it has the sign of dq, and Fv, Fc > 0."
    )
    axes.text(1.55, 0.22, text, fontsize=8.5, color=INK, va="center", family="monospace")
    axes.set_xlim(-0.55, 3.3)
    axes.set_ylim(-0.2, 0.75)
    axes.set_aspect("equal")
    axes.set_axis_off()
    return figure


def main() -> None:
    for name, draw in (("dh", dh_figure), ("inertia", inertia_figure), ("torque", torque_figure)):
        save(draw(), IMAGES / f"concepts-{name}.png")


if __name__ == "__main__":
    main()
