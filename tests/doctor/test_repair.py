"""What the doctor mends, and nothing else."""

import pytest
import torch

from torchid.doctor.repair import RejoinTime
from torchid.log.model import Log


@pytest.mark.parametrize(
    ("t", "steps", "mended"),
    [
        # The clock stood still and caught up: what comes after was right.
        ([0, 5, 10, 10, 10, 25, 30], (2, 3), [0, 5, 10, 15, 20, 25, 30]),
        # It never did.
        ([0, 5, 10, 10, 15, 20, 25], (2,), [0, 5, 10, 15, 20, 25, 30]),
    ],
)
def test_a_clock_that_stood_still(t, steps, mended):
    log = Log(1e-3 * torch.tensor(t).double(), q=torch.zeros(7, 1).double())
    found = RejoinTime(steps).apply(log).t
    torch.testing.assert_close(found, 1e-3 * torch.tensor(mended).double())
