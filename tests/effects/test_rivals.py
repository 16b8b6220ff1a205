"""Which effects look alike: correlations of spans against closed forms, and known aliases."""

import math

import pytest
import torch

from tests.arms import arm
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Motion
from torchid.effects.registry import KINDS
from torchid.effects.rivals import ALIKE, Rival, aged, rivals
from torchid.effects.transient import DroppedSamples

JOINTS = (0, 1, 2)


def motion(seconds: float = 10.0) -> Motion:
    """Sines of every joint of the 3R, of whole periods, sampled in their middles."""
    t = (torch.arange(round(40 * seconds), dtype=torch.float64) + 0.5) / 40
    w = 2 * math.pi * torch.tensor([0.3, 0.4, 0.7])
    angle = t[:, None] * w
    q, dq, ddq = angle.sin(), w * angle.cos(), -(w**2) * angle.sin()
    return Motion(q, dq, ddq, t=t, torque=inverse_dynamics(arm("3r"), q, dq, ddq))


def found(*names: str, alike: float = ALIKE) -> dict[str, tuple[Rival, ...]]:
    kinds = {name: KINDS[name] for name in names}
    return rivals(arm("3r"), [motion()], 8.0, joints=JOINTS, kinds=kinds, alike=alike)


def test_correlation_of_a_speed_and_its_sign_is_known():
    """Of a sine and its square wave 2 sqrt(2) / pi; an offset is orthogonal to both."""
    said = found("viscous_friction", "coulomb_friction", "torque_offset", alike=0.5)
    (coulomb,) = said["viscous_friction"]
    assert coulomb.name == "coulomb_friction"
    assert coulomb.correlation == pytest.approx(2 * math.sqrt(2) / math.pi, abs=2e-3)
    (nearest,) = said["torque_offset"]
    assert nearest.correlation < 1e-9


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("payload", "link_inertia"),  # the last link
        ("joint_spring", "torque_offset"),  # its rest torque
        ("rotor_inertia", "link_inertia"),  # J_zz of the first link
    ],
)
def test_what_is_the_same_by_physics_is_marked_both_ways(one, other):
    said = found(one, other)
    for a, b in ((one, other), (other, one)):
        assert [r.name for r in said[a]] == [b]
        assert said[a][0].same


def test_a_near_likeness_is_not_marked_as_the_same():
    said = found("viscous_friction", "power_law_friction")
    (rival,) = said["viscous_friction"]
    assert 0.9 < rival.correlation < 1
    assert not rival.same


@pytest.mark.slow
def test_rivalry_goes_both_ways_and_the_most_alike_comes_first():
    said = found(*KINDS)
    assert set(said) == set(KINDS)
    for name, others in said.items():
        assert others, f"{name} has not even a nearest one"
        sizes = [round(r.correlation, 6) for r in others]
        assert sizes == sorted(sizes, reverse=True)
        assert len({r.name for r in others}) == len(others)
        for r in others:
            back = {b.name: b.correlation for b in said[r.name]}
            assert r.correlation < ALIKE or back[name] == pytest.approx(r.correlation)


def test_a_delay_common_to_all_joints_is_seen_beside_an_effect_of_the_arm():
    """One joint's delay is a third of a filter's lag at most; that of all joints is most of it."""
    (rival,) = found("time_delay", "filter_lag")["filter_lag"]
    assert rival.joint is None
    assert rival.correlation > 0.5


def test_joints_are_compared_on_their_own():
    """Only joint 2 reverses: only there friction can be told from an offset."""
    m = motion()
    dq = torch.stack((torch.ones_like(m.dq[:, 0]), m.dq[:, 1], -torch.ones_like(m.dq[:, 2])), -1)
    kinds = {name: KINDS[name] for name in ("coulomb_friction", "torque_offset")}
    for joint, same in ((0, True), (1, False), (2, True)):
        said = rivals(arm("3r"), [m._replace(dq=dq)], 8.0, joints=(joint,), kinds=kinds)
        assert said["coulomb_friction"][0].same is same


def test_held_samples_bring_their_age():
    held = aged(DroppedSamples(0), motion())
    assert float(held.age.max()) > 0
    assert aged(KINDS["viscous_friction"](0), motion()).age is None
