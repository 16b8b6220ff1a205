"""Which rows a reversal reaches."""

import pytest
import torch

from tests.gap.diagnoses import motion_of
from torchid.gap.passages import REACH, Passage, Rows, reach, row_masks, sliding

RATE, CUTOFF = 200.0, 8.0


def rows(n=2) -> Rows:
    motion = motion_of(n, 20.0, RATE, seed=1)
    return Rows([Passage("one", 0, RATE, 40.0, motion, torch.zeros_like(motion.q), False)], CUTOFF)


def test_a_reversal_reaches_as_far_as_it_is_heard_beside_the_noise():
    """The filtered pulse of a direction that is wrong for an eighth of a period, by hand."""
    given, dry = rows(), torch.tensor([50.0, 400.0], dtype=torch.float64)
    far = reach(given, dry)
    assert REACH <= float(far[0]) < float(far[1]) < 4.0
    pulse = torch.zeros(4001, 1, dtype=torch.float64)
    half = round(0.0625 * RATE / CUTOFF)
    pulse[2000 - half : 2001 + half] = 2.0
    heard = given.low_passed(pulse)[2000:, 0].abs()
    for own, ratio in zip(far.tolist(), dry.tolist(), strict=True):
        last = round(own * RATE / CUTOFF)
        assert float(heard[last - 1] * ratio) > 1.0
        assert float(heard[last:].max() * ratio) <= 1.0


@pytest.mark.parametrize("ratio", [0.0, 1.0])
def test_little_dry_friction_reaches_no_further_than_the_least(ratio):
    assert reach(rows(), torch.full((2,), ratio, dtype=torch.float64)).tolist() == [REACH, REACH]


def test_each_joint_has_its_own_reach():
    given = rows()
    near, far = sliding(given, REACH), sliding(given, 2 * REACH)
    mixed = sliding(given, torch.tensor([REACH, 2 * REACH]))
    assert torch.equal(mixed[0], near[0])
    assert torch.equal(mixed[1], far[1])
    assert int(far[1].sum()) < int(near[1].sum())
    assert not bool((far & ~near).any())
    moving, turning, still = row_masks(given)
    assert not still
    assert torch.equal(near, moving & ~turning)
