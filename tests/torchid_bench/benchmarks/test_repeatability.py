"""The score of repeated fits, on numbers whose deviations are known."""

import numpy as np
import pytest

from torchid_bench.benchmarks.repeatability import scored


def draws(stated: float, count: int = 10, numbers: int = 200, seed: int = 0):
    """Numbers of a deviation of 1, each draw's own, stated as so much."""
    values = np.random.default_rng(seed).normal(size=(count, numbers))
    return [
        {"numbers": {f"x{k}": (float(v), stated) for k, v in enumerate(row)}, "seconds": 2.0}
        for row in values
    ]


@pytest.mark.parametrize(("stated", "low", "high"), [(1.0, 0.92, 0.95), (0.25, 0.33, 0.40)])
def test_the_share_is_that_of_normal_draws(stated, low, high):
    """Beside the mean of nine others a draw deviates by sqrt(10 / 9) of its own: 94 %, 36 %."""
    name, numbers, count, within, ratio, seconds, _ = scored("fit", draws(stated))
    hits, total = (int(x) for x in str(within).split(" (")[0].split(" of "))
    assert (name, numbers, count, seconds) == ("fit", 200, 10, "2")
    assert low < hits / total < high
    assert float(ratio) == pytest.approx(1 / stated, rel=0.1)


def test_a_number_of_two_draws_does_not_count():
    some = draws(1.0, count=4, numbers=2)
    for draw in some[2:]:
        del draw["numbers"]["x0"]
    some[0]["numbers"]["x1"] = (90.0, 1.0)
    _, numbers, _, within, _, _, worst = scored("fit", some)
    assert numbers == 1
    assert str(within).startswith("0 of 4") or str(within).split(" ")[2] == "4"
    assert str(worst).startswith("x1 (")
