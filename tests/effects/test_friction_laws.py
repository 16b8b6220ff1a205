"""Friction laws at speeds where they are known by hand."""

import math

import pytest
import torch

from torchid.effects.base import Effect, Motion
from torchid.effects.friction import CoulombFriction, TorqueOffset
from torchid.effects.friction_laws import (
    AsymmetricFriction,
    LoadDependentFriction,
    LoadDependentStribeck,
    PowerLawFriction,
    StribeckFriction,
)
from torchid.log.movement import RESTING


def at(*speeds: float, torque: float | None = None) -> Motion:
    dq = torch.tensor(speeds, dtype=torch.float64).unsqueeze(-1)
    return Motion(
        torch.zeros_like(dq), dq, dq, torque=None if torque is None else torch.full_like(dq, torque)
    )


@pytest.mark.parametrize("d", [1.0, 2.0, 0.5])
def test_stribeck_at_rest_at_its_speed_and_far_above(d: float) -> None:
    effect = StribeckFriction(0, vs=0.2, d=d)
    found = effect.torque(at(0.0, 1e-14, 0.2, -0.2, 1e6), [3.0])
    expected = torch.tensor([0.0, 3.0, 3.0 / math.e, -3.0 / math.e, 0.0], dtype=torch.float64)
    torch.testing.assert_close(found, expected, rtol=1e-6, atol=1e-12)


def test_stribeck_with_coulomb_falls_from_breakaway_to_coulomb() -> None:
    motion = at(*torch.logspace(-4, 1, 50, dtype=torch.float64).tolist())
    total = CoulombFriction(0).torque(motion, [2.0]) + StribeckFriction(0).torque(motion, [1.0])
    assert bool((total.diff() <= 0).all())
    assert float(total[0]) == pytest.approx(3.0, abs=1e-5)
    assert float(total[-1]) == pytest.approx(2.0, abs=1e-12)


@pytest.mark.parametrize("a", [1.5, 2.0, 2.5])
def test_power_law_by_hand(a: float) -> None:
    found = PowerLawFriction(0, a=a).torque(at(-4.0, -1.0, 0.0, 1.0, 4.0), [0.5])
    assert found.tolist() == pytest.approx([-0.5 * 4**a, -0.5, 0.0, 0.5, 0.5 * 4**a], rel=1e-14)


@pytest.mark.parametrize("load", [5.0, -5.0])
def test_load_dependent_friction_has_the_sign_of_the_speed_not_the_load(load: float) -> None:
    found = LoadDependentFriction(0).torque(at(-2.0, 0.0, 0.1, torque=load), [0.1])
    assert found.tolist() == [-0.5, 0.0, 0.5]


@pytest.mark.parametrize("load", [5.0, -5.0])
def test_what_fades_grows_with_the_load(load: float) -> None:
    """A tenth of 5 N m at rest, e times less at vs; Stribeck friction of half a newton metre."""
    effect, speeds = LoadDependentStribeck(0, vs=0.2, d=1.5), (-1e-14, 0.2, -0.4)
    found = effect.torque(at(*speeds, torque=load), [0.1])
    assert found.tolist() == pytest.approx([-0.5, 0.5 / math.e, -0.5 / math.exp(2**1.5)], rel=1e-9)
    plain = StribeckFriction(0, vs=0.2, d=1.5).torque(at(*speeds), [0.5])
    torch.testing.assert_close(found, plain, rtol=1e-14, atol=0)


def test_asymmetry_by_direction() -> None:
    """Fc = 2, dF = 0.5: 2.5 forwards, 1.5 backwards, nothing known at rest."""
    motion = at(-3.0, 3.0, 0.0)
    total = CoulombFriction(0).torque(motion, [2.0])
    total = total + AsymmetricFriction(0).torque(motion, [0.5, 0.0])
    assert total.tolist() == [-1.5, 2.5, 0.0]
    assert AsymmetricFriction(0).torque(motion, [0.0, 0.1]).tolist() == pytest.approx([0.3, 0.3, 0])


def test_asymmetry_is_an_offset_unless_the_joint_dwells() -> None:
    moving = at(-1.0, 0.5, 2 * RESTING)
    offset = TorqueOffset(0).columns(moving)
    assert torch.equal(AsymmetricFriction(0).columns(moving)[:, :1], offset)
    # A joint at rest that keeps the direction it came from, with noise on its speed.
    resting = at(0.0, 0.9 * RESTING, -0.9 * RESTING)._replace(
        direction=torch.ones(3, 1, dtype=torch.float64)
    )
    assert not AsymmetricFriction(0).columns(resting)[:, 0].any()


@pytest.mark.parametrize(
    "make",
    [
        lambda: StribeckFriction(0, vs=0.0),
        lambda: StribeckFriction(0, d=math.nan),
        lambda: PowerLawFriction(0, a=-1.0),
    ],
)
def test_shapes_without_meaning_are_refused(make) -> None:
    with pytest.raises(ValueError, match="positive"):
        make()


@pytest.mark.parametrize("effect", [StribeckFriction(0), CoulombFriction(0)])
def test_known_direction_wins_over_noise(effect: Effect) -> None:
    noisy = at(1e-5, -1e-5)._replace(direction=torch.ones(2, 1, dtype=torch.float64))
    assert bool((effect.torque_columns(noisy) > 0).all())
