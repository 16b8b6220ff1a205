"""Motions that were left out are a factor of how sure an effect is."""

import pytest
import torch

from torchid.position.checked import Checked
from torchid.position.effects import BY_NAME, GRAVITY
from torchid.position.record import Accuracy

WAY = Accuracy.of_joints(torch.tensor([9.0, 9.0]), torch.tensor([4.0, 4.0]))


def checked(beside_plain: float, beside_file: float, file: bool = True) -> Checked:
    """Squared errors of joint 1 fall by these on the mean of twenty blocks; joint 2's rise."""
    g = torch.Generator().manual_seed(4)
    falls = torch.randn(2, 20, 2, generator=g, dtype=torch.float64)
    falls = falls - falls.mean(1, keepdim=True) - 3.0
    falls[0, :, 0] += 3.0 + beside_plain
    falls[1, :, 0] += 3.0 + beside_file
    errors = (torch.zeros(1, 2), torch.zeros(1, 2))
    return Checked(WAY, WAY, WAY, WAY if file else None, errors, falls, (0.0, 1.0))


def test_an_effect_is_held_against_servos_that_lack_it():
    """What plain servos have, too, beside the file's; gravity and its own numbers as well."""
    one = checked(beside_plain=-3.0, beside_file=3.0)
    new = [("coulomb_friction", False), ("command_delay", False), ("dead_zone", True)]
    assert [one.confirmed(BY_NAME[name], 0, changed) for name, changed in new] == [1.0] * 3
    assert one.confirmed(GRAVITY, 0, False) == 1.0
    assert one.confirmed(BY_NAME["dead_zone"], 0, False) == 0.0
    # Without servos in the file nobody lacks what plain ones have.
    plain = checked(beside_plain=-3.0, beside_file=-3.0, file=False)
    assert plain.confirmed(BY_NAME["command_delay"], 0, False) == 1.0


def test_what_does_no_good_elsewhere_is_unsure_there():
    shares = [checked(fall, 0.0).confirmed(BY_NAME["dead_zone"], 0, False) for fall in (-1, 0, 1)]
    assert shares == sorted(shares)
    assert shares[0] < 0.1
    assert shares[1] == pytest.approx(0.5, abs=0.2)
    assert shares[2] > 0.9
    assert checked(3.0, 3.0).confirmed(BY_NAME["dead_zone"], 1, False) == 0.0


def test_what_acts_in_few_blocks_is_asked_of_the_log_as_it_is():
    one = checked(beside_plain=0.2, beside_file=0.0)
    assert 0.5 < one.confirmed(BY_NAME["dead_zone"], 0, False) < 1.0
    assert one.confirmed(BY_NAME["end_stop"], 0, False) == 1.0
