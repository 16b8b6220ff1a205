"""Alarms come as rarely as is said, and soon after a change; what a covariate explains is none."""

import torch

from torchid.statistics.drift import Drift, drift

THRESHOLD = 100.0


def run(y: torch.Tensor, covariates: torch.Tensor | None = None, freedom: float = 1e6) -> Drift:
    count = len(y)
    heat = torch.zeros(count, 0, dtype=torch.float64) if covariates is None else covariates
    ones = torch.ones(count, dtype=torch.float64)
    return drift(y, ones, freedom * ones, heat)


def noise(seed: int, count: int) -> torch.Tensor:
    g = torch.Generator().manual_seed(seed)
    return torch.randn(count, generator=g, dtype=torch.float64)


def test_false_alarms_are_as_rare_as_is_said() -> None:
    """Of a detector that comes once in at least 100 sessions on average, 40 sessions see one in
    less than 40 % of all runs (P(alarm by t) <= t / c)."""
    alarms = [float(run(5 + noise(s, 40)).evidence.max()) >= THRESHOLD for s in range(60)]
    assert sum(alarms) <= 0.4 * 60


def test_the_sum_less_the_time_is_a_martingale() -> None:
    """Of evidence M_t the mean is the number of residuals: here over many short series."""
    last = torch.stack([run(noise(s, 4)).evidence for s in range(400)]).mean(0)
    assert last[0] == 0
    # Step 4's e-values are rarely large, so their mean is seen from below.
    assert 0.4 < float(last[1]) < 2.0


def test_a_change_is_seen_soon_and_since_when() -> None:
    for seed in range(5):
        y = 10 + noise(seed, 20)
        y[12:] += 5
        found = run(y)
        first = (found.evidence >= THRESHOLD).nonzero().flatten().tolist()
        assert first
        assert 12 <= first[0] <= 14
        assert found.since == 12
        assert abs(found.after - found.before - 5) < 1.5


def test_what_the_temperature_explains_is_no_change() -> None:
    heat = torch.linspace(24, 38, 20, dtype=torch.float64)
    y = 10 - 0.5 * heat + noise(0, 20)
    assert float(run(y).evidence.max()) > THRESHOLD
    found = run(y, heat.unsqueeze(1))
    assert float(found.evidence.max()) < THRESHOLD
    assert abs(float(found.slope[0]) + 0.5) < 0.3


def test_two_sessions_tell_nothing_of_a_change() -> None:
    found = run(torch.tensor([1.0, 9.0], dtype=torch.float64))
    assert found.since is None
    assert found.evidence[0] == 0


def test_few_blocks_make_no_alarm() -> None:
    """A standard deviation of three degrees of freedom may be far too small."""
    y = noise(1, 6)
    y[-1] += 5
    sure, unsure = (float(run(y, freedom=f).evidence[-1]) for f in (1e6, 3.0))
    assert unsure < 0.2 * sure
