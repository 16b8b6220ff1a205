"""Left and right that are mirror images are identified together; those that are not, apart."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

import torchid
from tests.trees import FRICTION, front_legs, legs_log, legs_motion, package_urdfs
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.registry import on_every_joint
from torchid.errors import RobotError, TorchidError
from torchid.identification.base_parameters import base_parameters, nominal_values
from torchid.identification.mirror import mirror_of, mirrored_base
from torchid.robot.inertia import InertialParameters, move
from torchid.robot.model import Robot

FRONT = ("l:r",)


@pytest.fixture(scope="module")
def front(tmp_path_factory) -> Robot:
    """The front legs of a quadruped, joints by the names of their sides."""
    return front_legs(tmp_path_factory.mktemp("front"))


def test_the_mirrored_robot_has_the_mirrored_torques(front):
    """Independently of base parameters: Newton-Euler of the exchanged, reflected bodies."""
    mirror = mirror_of(front, FRONT)
    assert mirror.links == (3, 4, 5, 0, 1, 2)
    assert front.parameters is not None
    draw = torch.Generator().manual_seed(3)
    scale = 1 + 0.3 * torch.rand(6, 1, generator=draw, dtype=torch.float64)
    heavy = replace(front, parameters=InertialParameters(front.parameters.pi * scale))
    images = [move(pi, a) for pi, a in zip(heavy.parameters.pi, mirror.transforms, strict=True)]
    other = torch.stack([images[k] for k in mirror.links])  # the image of link k's image is k
    swapped = replace(front, parameters=InertialParameters(other))
    _, q, dq, ddq = legs_motion(front, 1)
    # Hips about x turn the other way in a mirror, thighs and shanks about y do not.
    sign = torch.tensor([-1.0, 1.0, 1.0] * 2, dtype=torch.float64)
    order = list(mirror.coordinates)
    tau = inverse_dynamics(heavy, q, dq, ddq)
    back = inverse_dynamics(swapped, *(sign * x[:, order] for x in (q, dq, ddq)))
    torch.testing.assert_close(back, sign * tau[:, order], rtol=1e-9, atol=1e-9)


def test_a_mirror_of_a_mirror_is_the_robot(front):
    effects = on_every_joint(FRICTION, front.n)
    base = base_parameters(front, effects)
    across = mirrored_base(mirror_of(front, FRONT), base, effects)
    torch.testing.assert_close(across @ across, torch.eye(len(base)).double(), rtol=0, atol=1e-8)
    own = nominal_values(front, base)
    torch.testing.assert_close(across @ own, own, rtol=0, atol=1e-9)


@pytest.mark.nightly
def test_a_symmetric_robot_is_known_better_and_rightly(front):
    log = legs_log(front, 5)
    alone, both = (
        torchid.identify(
            front, log, settings=torchid.Settings(effects=FRICTION, cutoff=20.0, mirror=mirror)
        )
        for mirror in ((), FRONT)
    )
    ratio = (both.covariance.diagonal() / alone.covariance.diagonal()).sqrt()
    assert float(ratio.nanmedian()) < 0.85, ratio
    truth = nominal_values(front, both.base)
    off = (both.values - truth) / both.covariance.diagonal().sqrt()
    assert float(off.square().nanmean().sqrt()) < 2.0
    assert float((both.values - truth).norm()) < float((alone.values - truth).norm())
    assert any("held together in" in w for w in both.warnings)
    assert not any("no mirror images" in w for w in both.warnings)


def test_one_heavier_leg_is_told_and_not_averaged(front):
    assert front.parameters is not None
    pi = front.parameters.pi.clone()
    pi[2] *= 1.8
    heavy = replace(front, parameters=InertialParameters(pi))
    found = torchid.identify(
        heavy,
        legs_log(heavy, 6),
        settings=torchid.Settings(effects=FRICTION, cutoff=20.0, mirror=FRONT),
    )
    (said,) = [w for w in found.warnings if "no mirror images" in w]
    assert "standard deviations" in said
    off = (found.values - nominal_values(heavy, found.base)) / found.covariance.diagonal().sqrt()
    assert float(off.square().nanmean().sqrt()) < 3.0


def test_what_is_no_mirror_image_is_refused(front):
    with pytest.raises(TorchidError, match="no two sides"):
        mirror_of(front, ("port:starboard",))
    with pytest.raises(TorchidError, match="no two sides"):
        mirror_of(front, ("left",))
    before = front.before.clone()
    before[0, 2, 3] += 0.02
    with pytest.raises(RobotError, match="not its own mirror image"):
        mirror_of(replace(front, before=before), FRONT)


@pytest.mark.parametrize(
    ("file", "pairs"),
    [("solo12.urdf", ("FL:FR", "HL:HR")), ("talos_reduced.urdf", ("left:right",))],
)
def test_published_robots_are_mirror_images(file: str, pairs: tuple[str, ...]):
    found = [path for path in package_urdfs() if Path(path).name == file]
    if not found:
        pytest.skip(f"no {file}")
    robot = torchid.load_robot(found[0])
    mirror = mirror_of(robot, pairs)
    moved = [k for k, image in enumerate(mirror.links) if image != k]
    assert len(moved) >= 12
