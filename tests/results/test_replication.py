"""Whether a cause is the same in every motion."""

import pytest
import torch

from torchid.results.agreement import MotionScale, repeat_words
from torchid.results.replication import excess_std, replication_of


def scales(*values: float, std: float = 0.1) -> list[MotionScale]:
    return [MotionScale(f"motion {k}", 0.0, 8.0, v, std) for k, v in enumerate(values)]


def test_a_law_repeats_and_its_spread_is_that_of_its_noise():
    g = torch.Generator().manual_seed(5)
    drawn = (1 + 0.1 * torch.randn(40, generator=g, dtype=torch.float64)).tolist()
    found = replication_of(scales(*drawn))
    assert found.mean == pytest.approx(1.0, abs=0.05)
    assert found.spread < 0.05
    assert found.next_std < 0.06
    assert repeat_words(found) == "40 of 40"


def test_what_one_motion_wants_does_not_repeat():
    found = replication_of(scales(0.0, 0.1, -0.2, 3.0, 0.0))
    assert found.spread > 1.0
    # The next motion may want anything.
    assert found.next_std > 1.0
    assert found.repeats < 3


@pytest.mark.parametrize(("std", "asked"), [(0.49, 4), (0.51, None)])
def test_motions_that_can_not_tell_are_not_asked(std, asked):
    found = replication_of(scales(1.0, 1.1, 0.9, 1.0, std=std))
    assert (found and found.asked) == asked
    assert repeat_words(found) == ("-" if asked is None else "4 of 4")


def test_the_spread_is_what_exceeds_the_variances():
    x = torch.tensor([0.0, 2.0], dtype=torch.float64)
    # Two of variance v: (2^2 / 2 - v) / 1.
    assert excess_std(x, torch.full((2,), 0.5).double()) == pytest.approx(1.5**0.5)
    assert excess_std(x, torch.full((2,), 3.0).double()) == 0.0
