"""Tails against the distributions from which the values are."""

import pytest
import torch
from scipy import stats

from torchid.statistics.tail import tail_probability


@pytest.mark.parametrize(
    "law",
    [stats.chi2(3), stats.expon(), stats.genpareto(0.4)],
    ids=("chi2", "exponential", "pareto"),
)
def test_the_tail_leads_to_rare_values(law) -> None:
    values = torch.from_numpy(law.rvs(4000, random_state=0))
    for rare in (1e-3, 1e-4):
        found = tail_probability(values, float(law.isf(rare)))
        assert rare / 4 < found < 4 * rare


def test_what_is_not_in_the_tail_is_no_surprise() -> None:
    values = torch.linspace(0, 1, 100, dtype=torch.float64)
    assert tail_probability(values, 0.5) == 1.0
    assert tail_probability(values[:3], 2.0) is None  # nothing is known of a tail of so few
