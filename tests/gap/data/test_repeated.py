"""Repeats of a motion in a log as it is read."""

import pytest
import torch

from tests.log.examples import log_at, uniform
from torchid.gap.data.repeated import repeated_motion
from torchid.log.model import Log


def test_a_second_run_is_found_where_it_begins() -> None:
    """The second run begins 1.5 s later on the same motion."""
    t = 0.01 * torch.arange(1200, dtype=torch.float64)
    one = log_at(t.numpy())
    two = log_at((t[:900] + 1.5).numpy()).replace(t=t[:900], names=("second",), tau=None)
    (repeat,) = repeated_motion(Log.concatenate([one.replace(tau=None), two]))
    assert (repeat.first, repeat.second) == ("example", "second")
    assert repeat.start_first - repeat.start_second == pytest.approx(1.5, abs=0.02)
    assert repeat.duration > 8.0


def test_nothing_where_nothing_repeats_or_all_is_short() -> None:
    assert repeated_motion(uniform(samples=100)) == ()
    one = uniform(samples=800)
    other = one.replace(q=one.q.flip(-1) * torch.linspace(0.2, 2, 800)[:, None], dq=None, ddq=None)
    assert repeated_motion(Log.concatenate([one.replace(dq=None, ddq=None), other])) == ()
