import numpy as np
import torch

from tests.gap.causes.problems import problem
from torchid.gap.causes.misfit import foreseen, noise_of_repeats


def test_a_law_of_the_state_is_foreseen_and_noise_is_not() -> None:
    of = problem(None)
    keep = of.data.keep.double()
    speed = of.data.samples.of([m.dq.T for m in of.given.motions])
    g = torch.Generator().manual_seed(0)
    noise = torch.randn(keep.shape, generator=g, dtype=torch.float64) * keep
    law = foreseen(of, torch.tanh(3 * speed) * keep)
    assert bool((law.share > 0.7).all())
    assert bool((law.low > 0.2).all())
    assert bool((law.low < law.share).all())
    none = foreseen(of, noise)
    assert bool((none.share < 0.1).all())
    assert bool((none.low < 0).all())
    # What is foreseen worse than by nothing is left as it is.
    torch.testing.assert_close(none.beyond(noise)[none.share <= 0], noise[none.share <= 0])


def test_a_joint_of_which_nothing_is_left_has_nothing_foreseen() -> None:
    of = problem(None)
    speed = of.data.samples.of([m.dq.T for m in of.given.motions]) * of.data.keep
    speed[1] = 0.0
    found = foreseen(of, speed)
    assert float(found.torque[1].abs().max()) == 0.0
    assert float(found.share[1]) == 0.0


def test_a_sample_does_not_foresee_itself() -> None:
    """A spike changes nothing within its own fold."""
    of = problem(None)
    speed = of.data.samples.of([m.dq.T for m in of.given.motions]) * of.data.keep
    at = int((of.folds.parts == 1).nonzero()[20])
    spiked = speed.clone()
    spiked[0, at] += 50.0
    one, two = (foreseen(of, x).torque for x in (speed, spiked))
    own = of.folds.parts == 1
    assert torch.equal(one[:, own], two[:, own])
    assert not torch.equal(one[0, ~own], two[0, ~own])


def test_a_log_without_repeats_tells_no_noise() -> None:
    assert np.isnan(noise_of_repeats(problem(None))).all()
