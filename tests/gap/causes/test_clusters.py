"""How much more windows differ in what they say than independent samples would."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.gap.causes.problems import candidate, problem
from torchid.gap.causes.candidates import Library
from torchid.gap.causes.clusters import WINDOWS, Clusters
from torchid.gap.causes.evidence import Evidence
from torchid.gap.causes.search import Search

ROWS = 640


def clusters(earlier: int = 0, asked: int = ROWS, joints: int = 1) -> Clusters:
    """Of a log of so many samples, beside an earlier one."""
    total = earlier + asked
    bounds = ([slice(0, earlier)] if earlier else []) + [slice(earlier, total)]
    keep = np.ones((joints, total))
    library: Any = SimpleNamespace(
        samples=SimpleNamespace(bounds=bounds), asked=np.arange(total) >= earlier,
        keep=keep, rows=keep.sum(1),
    )  # fmt: skip
    return Clusters(cast(Library, library))


def fitted(torque: np.ndarray, left: np.ndarray) -> np.ndarray:
    """What is left once the torque's coefficient is fitted."""
    return left - (left @ torque) / (torque @ torque) * torque


NONE, ONE = np.zeros(1), np.ones(1)


def test_independent_samples_count_as_such() -> None:
    """On average over 400 logs; the variance of one is that of chi^2 over the windows less one."""
    rng, of = np.random.default_rng(0), clusters()
    torque = np.sin(np.arange(ROWS) / 9)
    every = rng.normal(size=(400, ROWS))
    ratios = [of.same(torque[None], fitted(torque, x)[None], NONE)[0] for x in every]
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.1)
    assert np.var(ratios) == pytest.approx(2 / (WINDOWS - 1), rel=0.4)


def test_no_sample_tells_more_than_its_time_allows() -> None:
    rng, of = np.random.default_rng(0), clusters()
    torque, left = rng.normal(size=(2, 1, ROWS))
    assert of.same(torque, left, np.array([7.0])) >= 7.0
    assert of.same(np.eye(1, ROWS), left, ONE) >= 1.0  # all of it in one window


@given(seed=st.integers(0, 2**32 - 1), size=st.floats(0.5, 3.0))
def test_what_has_the_torques_shape_in_each_window_counts_as_one_sample_a_window(
    seed: int, size: float
) -> None:
    """A coefficient that is another one in every window, beside noise of size one: the ratio is
    that of the variances, (1 + size^2 sum d^2 / W) for noise known exactly."""
    rng, of = np.random.default_rng(seed), clusters()
    torque = np.sin(np.arange(ROWS) / 2)
    own = size * rng.normal(size=WINDOWS)
    own = np.repeat(own - own.mean(), ROWS // WINDOWS)
    left = fitted(torque, own * torque + rng.normal(size=ROWS))
    variance = (left**2).mean()
    sums = (left * torque).reshape(WINDOWS, -1).sum(1)
    expected = (sums**2).sum() * WINDOWS / (WINDOWS - 1) / (variance * (torque**2).sum())
    assert of.same(torque[None], left[None], NONE)[0] == pytest.approx(expected, rel=0.02)


def test_an_earlier_log_says_how_much_what_is_new_differs_by_itself() -> None:
    """The asked log is quiet about its mean, the earlier one is not; its own mean is a presence."""
    rng, of = np.random.default_rng(1), clusters(earlier=ROWS)
    torque = np.tile(np.sin(np.arange(ROWS) / 2), 2)
    noise = rng.normal(size=2 * ROWS)
    steady = np.concatenate([np.full(ROWS, 2.0), np.zeros(ROWS)])
    windows = np.concatenate([np.repeat(rng.normal(size=WINDOWS), ROWS // WINDOWS), np.zeros(ROWS)])
    quiet, present, varies = (
        of.new(torque[None], (noise + x * torque)[None], ONE)[0] for x in (0.0, steady, windows)
    )
    assert present < 2 * max(quiet, 1.0)
    assert varies > 5 * max(quiet, 1.0)


@pytest.mark.parametrize(("earlier", "factor"), [(ROWS, 2.0), (4 * ROWS, 1.25), (ROWS // 2, 3.0)])
def test_a_difference_has_both_logs_variance(earlier: int, factor: float) -> None:
    assert clusters(earlier).both == pytest.approx(factor)


def test_joints_are_apart() -> None:
    rng, of = np.random.default_rng(2), clusters(joints=2)
    torque = np.stack([np.sin(np.arange(ROWS) / 9)] * 2)
    left = rng.normal(size=(2, ROWS))
    left[1] += np.repeat([1.0, -1.0], ROWS // 2) * torque[1]
    one, other = of.same(torque, left, np.ones(2))
    assert other > 5 * one


def test_a_candidate_has_fewer_samples_where_what_is_left_varies_with_it() -> None:
    """A coefficient that differs from window to window tells less of its mean than noise of the
    same size."""

    def telling(steady: bool) -> float:
        library = Library(problem("viscous_friction"))
        term = candidate(Search(library), "viscous_friction", 1)
        windows = Clusters(library).logs[0]
        signs = np.repeat([1.0, -1.0] * WINDOWS, np.diff(windows)[0])[: library.gap.shape[1]]
        more = 0.3 * signs * term.columns[0]
        if steady:
            more = np.random.default_rng(0).permutation(more)
        library.gap[1] += more * library.keep[1]
        evidence = Evidence(library)
        one, other = (evidence.fit(t, evidence.rows / 4) for t in ((term,), ()))
        return float(evidence.telling(one, other)[1])

    assert telling(steady=False) < 0.2 * telling(steady=True)
