"""The likelihood of the oracle beside closed forms."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from torchid_bench.withheld.oracle.evidence import Gap, Terms, comparable, independent, nats

N, JOINTS = 60, 2


def terms(count: int, seed: int = 0) -> Terms:
    """Random columns on two joints, a gap of the first and noise."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(count, JOINTS, N)) * [[[1.0], [5.0]]]
    y = 2 * columns[0] + rng.normal(size=(JOINTS, N)) * [[0.3], [2.0]]
    return Terms.of(Gap(y, np.full(JOINTS, float(N)), (slice(0, N),)), columns)


def test_the_evidence_is_a_marginal_likelihood_at_the_noise_that_is_left() -> None:
    """y = A z + e, z ~ N(0, 1), e ~ N(0, L_j/n_j): log N(y; 0, AA' + noise), but for constants."""
    own = terms(5)
    fit = own.fit(np.full(JOINTS, float(N)))
    a = own.columns.transpose(1, 0, 2).reshape(5, -1).T
    noise = np.repeat(fit.losses / N, N)
    exact = multivariate_normal(cov=a @ a.T + np.diag(noise)).logpdf(own.gap.y.ravel())
    constant = JOINTS * N * (np.log(N) - np.log(2 * np.pi) - 1) / 2
    assert fit.evidence + constant == pytest.approx(exact, abs=1e-6)


def test_coefficients_are_those_of_the_highest_evidence() -> None:
    own, effective = terms(3), np.array([20.0, 45.0])

    def target(z: np.ndarray) -> float:
        left = own.gap.y - np.tensordot(z, own.columns, (0, 1))
        return float(effective @ np.log((left**2).sum(1)) + z @ z)

    z = own.fit(effective).z
    steps = 1e-3 * np.random.default_rng(1).normal(size=(20, 3))
    assert all(target(z + step) > target(z) for step in steps)


def test_columns_may_be_added_one_after_the_other() -> None:
    whole, added = terms(5), Terms.of(terms(5).gap, np.zeros((0, JOINTS, N)))
    for x in whole.columns.transpose(1, 0, 2):
        added = added.with_(x[None])
    assert added.gram == pytest.approx(whole.gram)
    assert added.fit(whole.gap.rows).z == pytest.approx(whole.fit(whole.gap.rows).z)


def test_columns_of_zeros_net_nothing() -> None:
    own = terms(4)
    assert nats(own.with_(np.zeros((3, JOINTS, N))), own) == pytest.approx(0, abs=1e-9)
    assert not independent(np.zeros((3, 3))).any()


def test_both_sides_of_a_comparison_have_the_same_samples() -> None:
    both = terms(4)
    one = Terms.of(both.gap, both.columns.transpose(1, 0, 2)[1:3])
    assert comparable(both, one) == pytest.approx(comparable(one, both))
    assert nats(both, one) == pytest.approx(-nats(one, both))
    assert nats(both, one) > 20


@pytest.mark.parametrize("seed", [1, 2])
def test_a_law_in_other_coefficients_is_as_likely(seed: int) -> None:
    """Its torque alone is bounded beforehand, so a spring may be k q + c0 about any position."""
    base, rng = terms(1), np.random.default_rng(seed)
    raw = rng.normal(size=(2, JOINTS, N))

    def evidence(columns: np.ndarray) -> float:
        into = independent(np.einsum("cjN,djN->cd", columns, columns) / N)
        return base.with_(np.tensordot(into.T, columns, 1)).fit(base.gap.rows).evidence

    mixed = np.tensordot(np.array([[1.0, 0.0], [40.0, 0.01]]), raw, 1)
    assert evidence(mixed) == pytest.approx(evidence(raw), abs=1e-6)


def test_independent_directions_of_several_at_once() -> None:
    root = np.random.default_rng(3).normal(size=(4, 3, 3))
    root[1, :, 0] = 0.0
    precision = root.swapaxes(1, 2) @ root
    into = independent(precision)
    known = np.diag([1.0, 1.0, 1.0])
    found = into.swapaxes(1, 2) @ precision @ into
    assert found[[0, 2, 3]] == pytest.approx(np.broadcast_to(known, (3, 3, 3)), abs=1e-9)
    assert into[1].any(0).sum() == 2
