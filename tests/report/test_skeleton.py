"""The robot is drawn by its joints, whatever its file was, and labels do not cover each other."""

import itertools

import pytest
import torch

from torchid.report.colours import BEFORE
from torchid.report.skeleton import PHONE, skeleton_figure
from torchid.results.answer import Answer, Cause, JointError
from torchid.robot.library import load_robot


def answer(n: int, causes: tuple[Cause, ...] = ()) -> Answer:
    """The first joint is the worst, and the last one never moves."""
    joints = tuple(
        JointError(
            joint=j, name=f"joint_{j + 1}", noise=(0.0, 0.1),
            before=float("nan") if j == n - 1 else 4.0 / (1 + j),
            after=float("nan") if j == n - 1 else 1.0 / (1 + j),
        )
        for j in range(n)
    )  # fmt: skip
    return Answer(
        status="explained", error="the gap", unit="N m", before=5.0, after=1.0, noise=(0.0, 0.1),
        closed=0.9, joints=joints, causes=causes,
    )  # fmt: skip


def circles(figure):
    """(radius, opacity) of what is solid and light."""
    axes = figure.axes[0]
    return [
        (p.get_radius(), p.get_alpha())
        for p in axes.patches
        if hasattr(p, "get_radius") and p.get_facecolor()[:3] == pytest.approx(rgb(BEFORE))
    ]


def rgb(colour: str):
    return tuple(int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))


@pytest.mark.parametrize("name", ["3r", "panda", "kuka_lwr4"])
def test_labels_are_apart_and_inside(name):
    robot = load_robot(name)
    causes = tuple(Cause(effect="coulomb_friction", joints=(j,), share=0.1) for j in range(robot.n))
    q = torch.linspace(-1, 1, 30, dtype=torch.float64)[:, None].expand(30, robot.n)
    figure = skeleton_figure(robot, answer(robot.n, causes), q)
    figure.canvas.draw()
    boxes = [t.get_window_extent() for t in figure.axes[0].texts]
    assert len(boxes) >= 2 * robot.n
    for a, b in itertools.combinations(boxes, 2):
        wide = min(a.x1, b.x1) - max(a.x0, b.x0)
        high = min(a.y1, b.y1) - max(a.y0, b.y0)
        # Lines of text touch by their ascenders at most.
        assert wide <= 0 or high <= 0.25 * min(a.height, b.height)
    assert all(b.x0 >= 0 and b.x1 <= figure.bbox.x1 for b in boxes)
    assert all(b.y0 >= 0 and b.y1 <= figure.bbox.y1 for b in boxes)


def test_areas_are_the_errors():
    found = circles(skeleton_figure(load_robot("3r"), answer(3), torch.zeros(1, 3)))
    light = sorted((r for r, alpha in found if alpha < 1), reverse=True)
    solid = sorted((r for r, alpha in found if alpha == 1), reverse=True)
    assert light[1] / light[0] == pytest.approx(0.5**0.5)
    assert solid[0] / light[0] == pytest.approx(0.5)


def test_a_phone_has_numbers_alone():
    figure = skeleton_figure(load_robot("3r"), answer(3), torch.zeros(1, 3), PHONE)
    assert [t.get_text() for t in figure.axes[0].texts] == ["1", "2", "3"]


@pytest.mark.parametrize("name", ["panda", "kuka_lwr4"])
def test_discs_that_make_room_for_others_stay_inside(name):
    """Joints that lie on each other are drawn beside each other, at either end of the arm."""
    robot = load_robot(name)
    q = torch.tensor([0.3, -1.4, 0.2, 1.5, 0.1, 0.5, 0.0], dtype=torch.float64)[None]
    axes = skeleton_figure(robot, answer(robot.n), q, PHONE).axes[0]
    for low, high, at in ((*axes.get_xlim(), 0), (*axes.get_ylim(), 1)):
        for disc in axes.patches:
            assert low <= disc.get_center()[at] - disc.get_radius()
            assert disc.get_center()[at] + disc.get_radius() <= high
