"""Standard deviations against the spread of many fits."""

import itertools
import math
from dataclasses import replace
from functools import lru_cache

import pytest
import torch
from msgspec import structs
from scipy.signal import lfilter
from scipy.stats import t as student

from tests.identification.test_rows import a_log, collected, layout_of
from torchid.design.motion import Measurement, measurements
from torchid.identification.least_squares import Fit, fit
from torchid.identification.rows import RowSource
from torchid.identification.statistics import (
    Uncertainty,
    jackknife,
)
from torchid.robot.library import load_robot
from torchid.statistics.autocorrelation import correlation_instants
from torchid.statistics.blocks import FEWEST_BLOCKS, block_length, block_numbers
from torchid.statistics.jackknife import jackknife as blocks_jackknife

ROBOT = load_robot("3r_friction")
LAYOUT = layout_of(ROBOT)
LEVELS = torch.tensor([0.3, 0.1, 0.03], dtype=torch.float64)
KEEP = 0.95  # of the AR(1) noise: correlated over 39 samples
TRIALS = 30


@lru_cache
def motion() -> tuple[Measurement, ...]:
    return tuple(measurements(a_log(ROBOT, rates=(200.0, 200.0), durations=(20.0, 20.0)), None))


@lru_cache
def truth() -> torch.Tensor:
    return fit(RowSource(motion(), LAYOUT), method="ols").x


def ar1(white: torch.Tensor, keep: float = KEEP) -> torch.Tensor:
    driven = white * math.sqrt(1 - keep**2)
    driven[0] = white[0]
    return torch.from_numpy(lfilter([1.0], [1.0, -keep], driven.numpy(), axis=0))


def noise(kind: str, m: Measurement, generator: torch.Generator) -> torch.Tensor:
    white = torch.randn(m.tau.shape, generator=generator, dtype=torch.float64)
    if kind == "ar1":
        return ar1(white) * LEVELS
    if kind == "heteroscedastic":
        return white * LEVELS * (0.2 + 2 * m.motion.dq.abs())
    if kind == "heavy tails":
        chi = torch.randn(3, *m.tau.shape, generator=generator, dtype=torch.float64)
        return white / (chi.square().sum(0) / 3).sqrt() * LEVELS
    return white * LEVELS


def noisy_source(kind: str, seed: int) -> RowSource:
    generator = torch.Generator().manual_seed(seed)
    made = [replace(m, tau=m.tau + noise(kind, m, generator)) for m in motion()]
    return RowSource(made, LAYOUT)


def textbook_std(found: Fit) -> torch.Tensor:
    """s^2 (A'A)^-1, for independent and equal residuals."""
    r = found.factor[:-1, :-1]
    rows = int(found.kept.sum()) - found.x.numel()
    return torch.linalg.inv(r.T @ r).diagonal().mul(found.factor[-1, -1] ** 2 / rows).sqrt()


@lru_cache
def scores(kind: str, method: str) -> tuple[torch.Tensor, torch.Tensor]:
    """(estimate - truth)/std of TRIALS logs: by the jackknife, and by the textbook."""
    ours, theirs = [], []
    for seed in range(TRIALS):
        source = noisy_source(kind, seed)
        found = fit(source, method=method)
        error = found.x - truth()
        ours.append(error / jackknife(source, found).std)
        theirs.append(error / textbook_std(found))
    return torch.stack(ours), torch.stack(theirs)


CASES = [
    ("white", "ols"), ("white", "huber"), ("ar1", "wls"), ("ar1", "huber"),
    ("heteroscedastic", "huber"), ("heavy tails", "huber"),
]  # fmt: skip


@pytest.mark.nightly
@pytest.mark.parametrize(("kind", "method"), CASES)
def test_standard_deviations_are_the_spread_of_many_fits(kind, method):
    ours, _ = scores(kind, method)
    assert float(ours.square().mean().sqrt()) == pytest.approx(1.0, abs=0.15)
    quantile = student.ppf(0.975, FEWEST_BLOCKS)
    assert 0.91 < float((ours.abs() < quantile).double().mean()) < 0.99


@pytest.mark.nightly
def test_why_not_the_textbooks():
    """It is right for white noise, and several times too small for what a filter leaves."""
    assert float(scores("white", "wls")[1].square().mean().sqrt()) == pytest.approx(1.0, abs=0.1)
    assert float(scores("ar1", "wls")[1].square().mean().sqrt()) > 3.5


def test_the_covariance_is_the_spread_between_parameters_too():
    """Any combination of the parameters, in the coordinates where white noise has unit spread."""
    found = [fit(noisy_source("ar1", seed), method="wls") for seed in range(TRIALS)]
    first = noisy_source("ar1", 0)
    r = found[0].factor[:-1, :-1]
    spread = torch.stack([r @ (f.x - truth()) for f in found]).square().mean(0).sum()
    told = (r @ jackknife(first, found[0]).covariance @ r.T).diagonal().sum()
    assert float((told / spread).sqrt()) == pytest.approx(1.0, abs=0.15)


def test_covariance_is_symmetric_and_positive():
    source = noisy_source("ar1", 3)
    v = jackknife(source, fit(source)).covariance
    assert torch.allclose(v, v.T, rtol=1e-9)
    assert float(torch.linalg.eigvalsh(v).min()) > -1e-12 * float(v.diagonal().max())


def test_coefficients_that_are_not_free_have_no_spread():
    source = noisy_source("white", 0)
    out = torch.zeros(LAYOUT.size, dtype=torch.bool)
    out[[0, 7]] = True
    uncertainty = jackknife(source, fit(source, left_out=out))
    assert bool((uncertainty.covariance[out] == 0).all())
    assert bool((uncertainty.covariance[:, out] == 0).all())
    assert bool((uncertainty.std[~out] > 0).all())


@pytest.mark.parametrize(("method", "noise"), [("wls", "ar1"), ("huber", "heavy tails")])
@pytest.mark.parametrize("covariance", ["diagonal", "full"])
@pytest.mark.parametrize("moving_only", [False, True])
def test_normal_equations_are_those_of_the_rows(covariance, moving_only, method, noise):
    """The streamed sums, in the factor's coordinates, against one dense matrix of all rows."""
    source = RowSource(noisy_source(noise, 1).measured, LAYOUT, moving_only=moving_only)
    found = fit(source, method=method, covariance=covariance)
    assert bool(((found.robust > 0) & (found.robust < 1)).any()) == (method == "huber")
    uncertainty = jackknife(source, found)
    bounds = [slice(a, b) for a, b in itertools.pairwise(source.boundaries)]
    correlation = correlation_instants(found.residual * found.kept, bounds)
    block = block_numbers(bounds, block_length(source.instants, correlation))
    a, tau, keep, _ = collected(source)
    stack = torch.cat([a, tau.unsqueeze(-1)], -1) * keep.unsqueeze(-1)
    rows = torch.einsum("ij,mjb->mib", found.whitening, stack) * keep.unsqueeze(-1)
    columns, residual = rows[..., :-1].flatten(0, 1), (rows[..., -1] - rows[..., :-1] @ found.x)
    # Rows that Huber's weights clip pull, but inform not.
    own, residual, robust = block.repeat_interleave(rows.shape[1]), residual.flatten(), found.robust
    whole, pull = (robust.flatten() == 1).unsqueeze(1), robust.flatten().square() * residual
    mine = [own == k for k in range(int(own.max()) + 1)]
    dense = blocks_jackknife(
        torch.stack([(columns * whole)[k].T @ columns[k] for k in mine]),
        torch.stack([columns[k].T @ pull[k] for k in mine]),
        variance=float(pull @ residual) / (len(residual) - columns.shape[1]),
        power=1.0,
    )
    assert dense.blocks == uncertainty.blocks
    assert torch.allclose(uncertainty.covariance, dense.covariance, rtol=1e-6, atol=1e-12)


def test_the_largest_correlation_time_counts():
    generator = torch.Generator().manual_seed(0)
    white = torch.randn(100_000, 2, generator=generator, dtype=torch.float64)
    mixed = torch.stack(
        [white[:, 0], ar1(white, 0.9)[:, 1], torch.zeros(100_000, dtype=torch.float64)], 1
    )
    assert correlation_instants(mixed) == pytest.approx(19, rel=0.15)
    assert correlation_instants(torch.ones(1, 3, dtype=torch.float64)) == 1.0


def test_few_correlation_times_are_said():
    part = [replace(m, tau=m.tau + 0) for m in noisy_source("ar1", 0).measured]
    slow = []
    for m in part:
        t = m.t - m.t[0]
        slow.append(replace(m, tau=m.tau + torch.sin(0.5 * t).unsqueeze(-1) * 3))
    source = RowSource(slow, LAYOUT)
    (warning,) = jackknife(source, fit(source, method="ols")).warnings
    assert "correlation times" in warning
    assert "standard deviations are rough" in warning
    good = noisy_source("white", 0)
    assert jackknife(good, fit(good)).warnings == ()


def test_seconds_are_seconds():
    source = noisy_source("ar1", 0)
    fitted = fit(source, method="wls")
    found = jackknife(source, fitted)
    bounds = [slice(a, b) for a, b in itertools.pairwise(source.boundaries)]
    instants = correlation_instants(fitted.residual, bounds)
    assert found.correlation_seconds == pytest.approx(instants / 200)
    assert found.block_seconds == pytest.approx(block_length(source.instants, instants) / 200)


def test_quantiles_are_students():
    made = Uncertainty(
        method="", blocks=25, block_seconds=1.0, correlation_seconds=0.1, quantile95=2.06,
        covariance=torch.eye(2, dtype=torch.float64), warnings=(),
        by_one_block=torch.zeros(2, dtype=torch.bool),
    )  # fmt: skip
    assert made.quantile(0.95) == pytest.approx(student.ppf(0.975, 24))
    assert made.quantile(0.5) == pytest.approx(student.ppf(0.75, 24))
    assert made.std.tolist() == [1.0, 1.0]
    assert math.isfinite(structs.replace(made, blocks=1).quantile())
