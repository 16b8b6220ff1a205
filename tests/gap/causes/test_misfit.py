import numpy as np

from tests.gap.causes.problems import problem
from torchid.gap.causes.misfit import foreseen, noise_of_repeats


def test_a_law_of_the_state_is_foreseen_and_noise_is_not() -> None:
    of = problem(None)
    rng = np.random.default_rng(0)
    keep = of.data.keep.numpy().astype(float)
    speed = of.data.samples.of([m.dq.T for m in of.given.motions]).numpy()
    noise = rng.normal(size=keep.shape)
    assert (foreseen(of, np.tanh(3 * speed) * keep) > 0.8).all()
    assert (foreseen(of, noise * keep) < 0.1).all()


def test_a_log_without_repeats_tells_no_noise() -> None:
    assert np.isnan(noise_of_repeats(problem(None))).all()
