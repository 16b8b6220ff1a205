"""Sets that are one and the same."""

import torch

from torchid_study.wrenches.alike import alike


def test_sets_with_the_same_forces_are_one():
    force = torch.tensor(
        [[1.0, 2.0], [1.00001, 2.00001], [1.0, 2.1], [1.0, 2.0]], dtype=torch.float64
    )
    one = alike(force)
    assert len(set(one.tolist())) == 2
    assert one[0] == one[1] == one[3] != one[2]
    apart = alike(force, torch.tensor([0, 0, 0, 1]))
    assert apart[0] == apart[1] != apart[3]
