"""What is drawn to be planted is a cause, of the size asked for."""

import numpy as np
import pytest
import torch

from tests.arms import arm
from tests.gap.diagnoses import motion_of
from torchid.effects.base import Effect, Motion
from torchid.effects.periodic import Cogging, PositionDependentFriction
from torchid.effects.registry import model_torque
from torchid.effects.spring import JointSpring
from torchid_bench.withheld.into_logs import drawing
from torchid_bench.withheld.into_logs.drawing import Planted, Scene, drawn, well_posed


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Joints of 3r that travel one radian."""
    q = torch.linspace(0, 1, 50, dtype=torch.float64).unsqueeze(1).repeat(1, 3)
    motion = Motion(q, torch.ones_like(q), torch.zeros_like(q))
    return Scene(arm("3r"), (motion,), torch.ones(3, dtype=torch.float64))


@pytest.fixture(scope="module")
def moving() -> Scene:
    """3r along two motions of eight seconds, of which the model leaves .3 N m."""
    motions = []
    for k in (0, 1):
        motion = motion_of(3, 8.0, 125.0, seed=k)
        motion = motion._replace(t=torch.arange(len(motion.q)).double() / 125 + 10.0 * k)
        motions.append(motion._replace(torque=model_torque(arm("3r"), [], motion)))
    return Scene(arm("3r"), tuple(motions), torch.full((3,), 0.3, dtype=torch.float64))


def planted(effect: Effect, values: list[float], size: float = 2.0) -> Planted:
    return Planted(effect, values, size, effect.joints)


@pytest.mark.parametrize("kind", [Cogging, PositionDependentFriction])
def test_a_joint_passes_through_a_whole_period_of_a_wave(
    scene: Scene, kind: type[Cogging | PositionDependentFriction]
) -> None:
    assert not well_posed(scene, planted(kind(0, 6.2), [1.0, 0.5]))
    assert well_posed(scene, planted(kind(0, 6.3), [1.0, 0.5]))


def test_no_spring_pushes_and_nothing_is_too_small_to_show(scene: Scene) -> None:
    assert well_posed(scene, planted(JointSpring(0), [1.0, -5.0]))
    assert not well_posed(scene, planted(JointSpring(0, 1.0), [-1.0, 0.0]))
    assert not well_posed(scene, planted(JointSpring(0), [1.0, 0.0], size=0.4))


def test_what_is_no_cause_is_drawn_again(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    numbers = iter([1.0, 2.0, 7.0, 9.0])
    monkeypatch.setattr(drawing, "_scaled", lambda *_: planted(Cogging(0, next(numbers)), [1.0, 0]))
    found = drawn(scene, "cogging", 2.0, rng(), 0)
    assert found is not None
    assert found.effect == Cogging(0, 7.0)
    numbers = iter([1.0] * drawing.TRIES)
    assert drawn(scene, "cogging", 2.0, rng(), 0) is None


@pytest.mark.parametrize(
    "name",
    ["coulomb_friction", "cogging", "stribeck_friction", "link_inertia", "payload", "contact"],
)
def test_an_effect_has_the_size_that_is_asked_for(moving: Scene, name: str) -> None:
    found = drawn(moving, name, 2.0, rng(), 1)
    assert found is not None
    assert found.size == pytest.approx(2.0, rel=0.1)
    assert found.key["name"] == name
    again = drawn(moving, name, 2.0, rng(), 1)
    assert again == found


def test_a_coefficient_stays_small(moving: Scene) -> None:
    found = drawn(moving, "torque_gain", 1e3, rng(), 1)
    assert found is not None
    assert abs(found.values[0]) == pytest.approx(drawing.CAPS["torque_gain"])
    assert found.size < 1e3


def test_friction_that_is_added_resists(moving: Scene) -> None:
    for seed in range(4):
        found = drawn(moving, "power_law_friction", 2.0, rng(seed), 1)
        assert found is not None
        assert found.values[0] > 0
