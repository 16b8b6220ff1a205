"""Mistakes of a robot's file, made on its parameters and undone by the effect."""

from dataclasses import replace

import pytest
import torch

from tests.arms import arm
from torchid.effects.file_mistakes import (
    InertiaReferencePoint,
    InertiaScale,
    MirroredLink,
)
from torchid.errors import TorchidError
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot


def mistaken(robot: Robot, kind: str, link: int | slice) -> Robot:
    """The robot with a mistake of one link (or a slice of them), made in the terms of a URDF: mass,
    centre, inertia."""
    own = robot.require_parameters("a test")
    mass, com, inertia = own.mass.clone(), own.com.clone(), own.inertia_about_com.clone()
    if kind == "point":  # the inertia about the frame's origin stands where that of the centre is
        inertia[link] = own.inertia_about_link_frame[link]
    elif kind == "unit":
        inertia[link] *= 1e3
    else:
        com[link, 1] *= -1
        inertia[link, [1, 4]] *= -1
    return robot.with_parameters(InertialParameters.from_com(mass, com, inertia))


CASES = [
    ("point", InertiaReferencePoint(1), 1.0),
    ("unit", InertiaScale(1), -0.999),
    ("mirror", MirroredLink(1, "y"), 1.0),
]


@pytest.mark.parametrize(("kind", "effect", "size"), CASES)
@pytest.mark.parametrize("name", ["3r", "kuka_lwr4"])
def test_the_effect_undoes_the_mistake(name, kind, effect, size):
    robot = arm(name)
    mended = effect.plant(mistaken(robot, kind, 1), [size])
    truth = robot.require_parameters("a test").pi
    assert torch.allclose(mended.require_parameters("a test").pi, truth, atol=1e-9)


def test_mirrored_axes_are_three():
    axes = {(e.joint, e.axis) for e in MirroredLink.starts(arm("3r"))}
    assert axes == {(j, a) for j in range(3) for a in "xyz"}
    with pytest.raises(ValueError, match="x, y or z"):
        MirroredLink(0, "w")


def test_a_robot_without_parameters_has_no_mistake():
    robot = arm("3r")
    bare = replace(robot, parameters=None)
    with pytest.raises(TorchidError):
        InertiaScale(0).change(bare)
