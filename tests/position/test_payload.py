"""A load beside servos of unknown strength."""

import pytest
import torch

from tests.position.planted import planted, robot, true_servos
from torchid.position.data import WINDOW_S, prepare
from torchid.position.payload import Loaded, with_load
from torchid.position.problem import some_of
from torchid.position.search import plain
from torchid.position.servo_model import Motions
from torchid.simulation.servo_loop import windows_of


def loaded(mass: float, seed: int, motions: int = 3) -> Loaded | None:
    """A log of the arm with a load, and what is found of that."""
    arm = robot()
    heavy = arm.with_payload(mass, (0.1, 0.0, 0.0)) if mass else arm
    log = planted(true_servos(3), motions=motions, seconds=8.0, seed=seed, robot=heavy)
    data = prepare(arm, log)
    few = Motions(data, some_of(windows_of(data.tracks, WINDOW_S), 12))
    return with_load(few, plain(few))


@pytest.mark.parametrize(("mass", "seed"), [(1.0, 3), (5.0, 5)])
def test_the_interval_of_a_mass_holds_what_stronger_servos_do(mass, seed):
    """No torque is measured: the more the load outweighs the arm, the less says how heavy it is."""
    found = loaded(mass, seed)
    assert found is not None
    low, high = found.between
    assert low < mass < high
    assert low < found.mass < high
    assert bool(((found.com - torch.tensor([0.1, 0.0, 0.0])).abs() < 2.5 * found.std).all())


def test_without_a_load_none_is_found():
    assert loaded(0.0, 6) is None
