"""The strategy parameters of CMA-ES (N. Hansen, arXiv:1604.00772, table 1)."""

import math
from dataclasses import dataclass
from functools import lru_cache


@dataclass(frozen=True)
class Strategy:
    """Weights and rates for n variables and a population (tutorial, table 1).

    Attributes:
        weights: by rank, best first; the first half sum to 1, the others are negative.
        mu_eff: variance-effective selection mass of the positive weights.
        c_sigma, d_sigma: rate and damping of the step size.
        c_c, c_1, c_mu: rates of the path, the rank-one and the rank-mu update.
        chi_n: expected length of a standard normal vector.
    """

    weights: tuple[float, ...]
    mu_eff: float
    c_sigma: float
    d_sigma: float
    c_c: float
    c_1: float
    c_mu: float
    chi_n: float


@lru_cache(maxsize=64)
def strategy(n: int, population: int) -> Strategy:
    """The tutorial's defaults (eq. 49-58) for n variables and a population."""
    raw = [math.log((population + 1) / 2) - math.log(i + 1) for i in range(population)]
    good, bad = [w for w in raw if w >= 0], [w for w in raw if w < 0]
    mu_eff = sum(good) ** 2 / sum(w * w for w in good)
    mu_eff_bad = sum(bad) ** 2 / sum(w * w for w in bad)
    c_1 = 2 / ((n + 1.3) ** 2 + mu_eff)
    c_mu = min(1 - c_1, 2 * (0.25 + mu_eff + 1 / mu_eff - 2) / ((n + 2) ** 2 + mu_eff))
    mass = min(
        1 + c_1 / c_mu,
        1 + 2 * mu_eff_bad / (mu_eff + 2),
        (1 - c_1 - c_mu) / (n * c_mu),
    )
    weights = [w / sum(good) for w in good] + [mass * w / -sum(bad) for w in bad]
    c_sigma = (mu_eff + 2) / (n + mu_eff + 5)
    return Strategy(
        weights=tuple(weights),
        mu_eff=mu_eff,
        c_sigma=c_sigma,
        d_sigma=1 + 2 * max(0.0, math.sqrt((mu_eff - 1) / (n + 1)) - 1) + c_sigma,
        c_c=(4 + mu_eff / n) / (n + 4 + 2 * mu_eff / n),
        c_1=c_1,
        c_mu=c_mu,
        chi_n=math.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n * n)),
    )
