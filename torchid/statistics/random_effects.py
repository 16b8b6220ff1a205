"""A quantity measured in sessions of units: what is the units' own, what the day's, what noise.

    y_us = mu + a_u + b_us + e_us,    a ~ N(0, A^2),  b ~ N(0, B^2),  e_us ~ N(0, v_us), v known

with u the unit and s its session. Restricted maximum likelihood (Patterson and Thompson 1971)
gives the spreads A between units and B between days: with w_us = 1 / (v_us + B^2), W_u = sum_s
w_us, m_u = sum_s w_us y_us / W_u and V_u = A^2 + 1 / W_u,

    -2 l = sum_us [-log w_us + w_us (y_us - m_u)^2] + sum_u [log W_u + log V_u + (m_u - mu)^2 / V_u]
           + log sum_u 1 / V_u

at mu = sum_u m_u / V_u / sum_u 1 / V_u. Intervals of the spreads are those of its profile. Many
quantities are solved at once, each with its own spreads.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import torch
from scipy.special import chdtri, fdtrc

from torchid.statistics.jackknife import student_quantile
from torchid.statistics.multiple import benjamini_hochberg, two_sided
from torchid.statistics.resampling import LEVEL
from torchid.statistics.robust import MAD_TO_SIGMA
from torchid.typing import Bool, Float, Int, Tensor

FINEST, COARSEST = 1e-3, 10.0
"""Least spread above 0 and largest one that are tried, in standard deviations of the estimates."""

REFINED = 16
"""Steps of a golden section, to 5e-4 of its interval, and of a bisection."""

ROUNDS = 10
"""Times that odd units are left out of the spreads and sought again."""


FEWEST_UNITS = 4
"""Units below which none is called odd: the spread of three is not known."""


Objective = Callable[[Tensor], Tensor]
"""Values (P,) of functions of one variable each (P,)."""


@dataclass(frozen=True, eq=False)
class Sessions:
    """Estimates of P quantities from S sessions of U units.

    Attributes:
        values, variances: (P, S); what is nan does not count.
        unit: (S,) unit of each session, 0 .. U - 1.
    """

    values: Float[Tensor, "P S"]
    variances: Float[Tensor, "P S"]
    unit: Int[Tensor, " S"]

    @property
    def counts(self) -> Bool[Tensor, "P S"]:
        """Which of them count."""
        return self.values.isfinite() & self.variances.isfinite()

    def without(self, left_out: Bool[Tensor, "P U"]) -> "Sessions":
        """These sessions without some units, quantity by quantity."""
        gone = left_out[:, self.unit]
        return replace(self, values=torch.where(gone, torch.nan, self.values))

    def of(self, quantities: Tensor) -> "Sessions":
        """These sessions of some of the quantities."""
        return Sessions(self.values[quantities], self.variances[quantities], self.unit)

    def by_unit(self, x: Float[Tensor, "P S"]) -> Float[Tensor, "P U"]:
        """Sums over each unit's sessions."""
        units = int(self.unit.max()) + 1
        return x.new_zeros(len(x), units).index_add_(1, self.unit, x)


@dataclass(frozen=True, eq=False)
class Means:
    """Units' own means given the spreads; nan where a unit has no session that counts.

    Attributes:
        mean, variance: (P, U) of each unit over its sessions, the spread between units not in it.
        centre, centre_variance: (P,) of the population, by generalised least squares.
    """

    mean: Float[Tensor, "P U"]
    variance: Float[Tensor, "P U"]
    centre: Float[Tensor, " P"]
    centre_variance: Float[Tensor, " P"]


@dataclass(frozen=True, eq=False)
class Pooled:
    """Spreads of P quantities, and what they make of U units.

    Attributes:
        mean, std: (P,) of the population's mean, and its standard deviation.
        between, between_ci95: (P,), (P, 2) spread between units; nan with one unit.
        daily, daily_ci95: (P,), (P, 2) spread between days of a unit; nan where no unit has two
            sessions, and then in `between`.
        noise: (P,) standard deviation of a typical session's estimate.
        own, own_std: (P, U) each unit by its sessions alone.
        shrunk, shrunk_std: (P, U) each unit drawn towards the population by as much as its
            sessions leave open (best linear unbiased prediction).
        deviation: (P, U) distance of a unit from the others in standard deviations of what a
            normal unit's would be (studentised; the unit itself and odd ones left out); nan where
            it cannot be told.
        p: (P, U) of that.
        odd: (U,) units that are called odd.
        p_unit: (U,) of each unit, for all quantities together, adjusted for the number of units.
        odd_in: (P, U) in which quantities.
        units, sessions: (P,) how many count.
    """

    mean: Float[Tensor, " P"]
    std: Float[Tensor, " P"]
    between: Float[Tensor, " P"]
    between_ci95: Float[Tensor, "P 2"]
    daily: Float[Tensor, " P"]
    daily_ci95: Float[Tensor, "P 2"]
    noise: Float[Tensor, " P"]
    own: Float[Tensor, "P U"]
    own_std: Float[Tensor, "P U"]
    shrunk: Float[Tensor, "P U"]
    shrunk_std: Float[Tensor, "P U"]
    deviation: Float[Tensor, "P U"]
    p: Float[Tensor, "P U"]
    odd: Bool[Tensor, " U"]
    p_unit: Float[Tensor, " U"]
    odd_in: Bool[Tensor, "P U"]
    units: Int[Tensor, " P"]
    sessions: Int[Tensor, " P"]

    def interval(self, level: float = LEVEL) -> Float[Tensor, "P 2"]:
        """Confidence intervals of the population's means (Student, units - 1)."""
        half = student_quantile(level, (self.units - 1).double()).to(self.std) * self.std
        return torch.stack([self.mean - half, self.mean + half], -1)


def means(data: Sessions, between: Float[Tensor, " P"], daily: Float[Tensor, " P"]) -> Means:
    """Means of units and population for given spreads."""
    counts = data.counts
    spread = data.variances + daily.square().unsqueeze(1)
    w = torch.where(counts, 1 / spread, 0.0)
    total = data.by_unit(w)
    there = total > 0
    y = torch.where(counts, data.values, 0.0)
    mean = torch.where(there, data.by_unit(w * y) / total, torch.nan)
    variance = torch.where(there, 1 / total, torch.nan)
    weight = torch.where(there, 1 / (between.square().unsqueeze(1) + variance), 0.0)
    whole = weight.sum(1)
    centre = (weight * mean.nan_to_num()).sum(1) / whole
    return Means(mean, variance, centre, 1 / whole)


def deviance(
    data: Sessions, between: Float[Tensor, " P"], daily: Float[Tensor, " P"]
) -> Float[Tensor, " P"]:
    """-2 times the restricted log-likelihood, up to a constant."""
    counts = data.counts
    fitted = means(data, between, daily)
    w = torch.where(counts, 1 / (data.variances + daily.square().unsqueeze(1)), 1.0)
    left = torch.where(counts, data.values - fitted.mean[:, data.unit], 0.0)
    within = torch.where(counts, -w.log() + w * left.square(), 0.0).sum(1)
    there = fitted.mean.isfinite()
    spread = between.square().unsqueeze(1) + fitted.variance
    off = (fitted.mean - fitted.centre.unsqueeze(1)).square() / spread
    of_units = torch.where(there, -fitted.variance.log() + spread.log() + off, 0.0).sum(1)
    return within + of_units - fitted.centre_variance.log()


def _lowest(function: Objective, low: Tensor, high: Tensor) -> Tensor:
    """Where functions of one variable each have their minimum (golden section); an end of the
    interval where nothing within is lower."""
    a, b = low, high
    golden = (5**0.5 - 1) / 2
    left, right = b - golden * (b - a), a + golden * (b - a)
    at_left, at_right = function(left), function(right)
    for _ in range(REFINED):
        lower = at_left < at_right
        a, b = torch.where(lower, a, left), torch.where(lower, right, b)
        new = torch.where(lower, b - golden * (b - a), a + golden * (b - a))
        value = function(new)
        left, right = torch.where(lower, new, right), torch.where(lower, left, new)
        at_left, at_right = (
            torch.where(lower, value, at_right), torch.where(lower, at_left, value)
        )  # fmt: skip
    middle = (a + b) / 2
    return torch.where((a == low) & (function(low) <= function(middle)), low, middle)


@dataclass(frozen=True, eq=False)
class _Scale:
    """Spreads that are tried: 0, and a geometric series of multiples of a size."""

    size: Float[Tensor, " P"]

    @property
    def grid(self) -> list[Tensor]:
        # 24: values of a spread above 0, of which the best is refined
        steps = torch.logspace(0, 1, 24, base=COARSEST / FINEST, dtype=torch.float64)
        return [torch.zeros_like(self.size), *(FINEST * s * self.size for s in steps)]


def _likeliest(profile: Objective, scale: _Scale, told: Tensor) -> Tensor:
    """The spread at which a deviance is lowest: the best of a grid, refined between its neighbours;
    0 where the data cannot tell it."""
    grid = torch.stack(scale.grid)
    k = torch.stack([profile(g) for g in grid]).argmin(0)
    low, high = (
        grid.gather(0, (k + step).clamp(0, len(grid) - 1).unsqueeze(0))[0] for step in (-1, 1)
    )
    return torch.where(told, _lowest(profile, low, high), 0.0)


def spreads(data: Sessions) -> tuple[Float[Tensor, " P"], Float[Tensor, " P"]]:
    """Spreads between units and between days with the highest restricted likelihood: the best pair
    of a grid, then one after the other until they stay."""
    scale, repeated, several = _frame(data)
    grid = scale.grid
    best = torch.full_like(scale.size, torch.inf)
    between, daily = torch.zeros_like(best), torch.zeros_like(best)
    for a in grid[::2]:
        for b in grid[::2]:
            a_own, b_own = torch.where(several, a, 0.0), torch.where(repeated, b, 0.0)
            value = deviance(data, a_own, b_own)
            better = value < best
            best = torch.where(better, value, best)
            between, daily = (
                torch.where(better, a_own, between), torch.where(better, b_own, daily)
            )  # fmt: skip
    # 3: times that both spreads are refined in turn: they hardly depend on each other
    for _ in range(3):
        between = _likeliest(partial(deviance, data, daily=daily), scale, several)
        daily = _likeliest(partial(deviance, data, between), scale, repeated)
    return between, daily


def _frame(data: Sessions) -> tuple[_Scale, Tensor, Tensor]:
    """Spreads to try, and which quantities have a unit with two sessions, and two units."""
    counts = data.counts
    own = data.by_unit(counts.double())
    n = counts.sum(1).clamp(min=1)
    y = torch.where(counts, data.values, 0.0)
    centre = y.sum(1, keepdim=True) / n.unsqueeze(1)
    scatter = torch.where(counts, (y - centre).square(), 0.0).sum(1) / n
    noise = torch.where(counts, data.variances, 0.0).sum(1) / n
    size = (scatter + noise).sqrt().clamp(min=1e-300)
    return _Scale(size), (own > 1).any(1), (own > 0).sum(1) > 1


def intervals(
    data: Sessions, between: Float[Tensor, " P"], daily: Float[Tensor, " P"]
) -> tuple[Float[Tensor, "P 2"], Float[Tensor, "P 2"]]:
    """Profile-likelihood intervals of both spreads, by bisection on each side of the best."""
    scale, repeated, several = _frame(data)
    limit = deviance(data, between, daily) + float(chdtri(1, 1 - LEVEL))
    far = 10 * COARSEST * scale.size

    def ends(best: Tensor, profile: Objective) -> Tensor:
        # Below: halves of what is left; at 0 the profile may be inside, and the interval begins
        # there. Above: geometric means, since a spread of two units may be many times as large.
        out = []
        for end in (torch.zeros_like(best), far):
            inside, outside = best.maximum(FINEST * scale.size * (end > 0)), end
            for _ in range(REFINED):
                middle = torch.where(end > 0, (inside * outside).sqrt(), (inside + outside) / 2)
                good = profile(middle) <= limit
                inside, outside = (
                    torch.where(good, middle, inside), torch.where(good, outside, middle)
                )  # fmt: skip
            out.append(torch.where((end == 0) & (profile(end) <= limit), end, inside))
        return torch.stack(out, -1)

    # The other spread at its best beside each one tried; a profile is flat there.
    top = 3 * torch.maximum(scale.size, torch.maximum(between, daily))

    def of_between(a: Tensor) -> Tensor:
        b = _lowest(lambda b: deviance(data, a, b), torch.zeros_like(top), top)
        return deviance(data, a, torch.where(repeated, b, 0.0))

    def of_daily(b: Tensor) -> Tensor:
        a = _lowest(lambda a: deviance(data, a, b), torch.zeros_like(top), top)
        return deviance(data, torch.where(several, a, 0.0), b)

    nothing = torch.full((len(between), 2), torch.nan, dtype=torch.float64)
    first = torch.where(several.unsqueeze(1), ends(between, of_between), nothing)
    second = torch.where(repeated.unsqueeze(1), ends(daily, of_daily), nothing)
    return first, second


def pooled(data: Sessions, level: float = 0.05) -> Pooled:
    """Random effects of all quantities, and odd units.

    A unit is compared with the population that the others make. The spread must not be that of the
    odd units themselves, which would hide each other, so units that are found odd are left out of
    the spreads and of the mean, in the quantities in which they are, and odd ones are sought again,
    until the same are found; the first time those that are far from the median are left out.
    p-values over the quantities of a unit are combined by Bonferroni's rule, which holds whatever
    the correlation of base parameters; over units the share of false ones is held at `level` by
    Benjamini and Hochberg (1995), and within the odd units, over their quantities, at that level
    times the share of units that are odd (Benjamini and Bogomolov 2014).

    Args:
        data: of sessions.
        level: share of false ones among the units called odd.
    """
    counts = data.counts
    own = data.by_unit(counts.double()) > 0
    units = own.sum(1)
    odd_in = _far(data)
    seen: list[Tensor] = []
    for _ in range(ROUNDS):
        rest = data.without(odd_in)
        between, daily = spreads(rest)
        deviation, p = _deviations(data, rest, between, daily)
        tests = p.isfinite().sum(0).clamp(min=1)
        least = torch.where(p.isfinite(), p, 1.0).amin(0)
        p_unit = benjamini_hochberg((least * tests).clamp(max=1.0))
        odd = p_unit <= level
        share = level * float(odd.double().mean())
        inside = torch.stack(
            [benjamini_hochberg(torch.where(c.isfinite(), c, 1.0)) for c in p.T], 1
        )
        now = (inside <= share) & odd & p.isfinite()
        # The quantity that made a unit odd is one of them at any rate.
        now = now | (odd & (p == least) & p.isfinite())
        if any(torch.equal(now, before) for before in (odd_in, *seen)):
            odd_in = now
            break
        seen.append(odd_in)
        odd_in = now
    rest = data.without(odd_in)
    between, daily = spreads(rest)
    between_ci95, daily_ci95 = intervals(rest, between, daily)
    population = means(rest, between, daily)
    every = means(data, between, daily)
    _, repeated, several = _frame(rest)
    square = between.square().unsqueeze(1)
    keep = square / (square + every.variance)
    centre = population.centre.unsqueeze(1)
    shrunk = centre + keep * (every.mean - centre)
    doubt = keep * every.variance + (1 - keep).square() * population.centre_variance.unsqueeze(1)
    # An odd unit is not one of the population towards which others are drawn.
    shrunk = torch.where(odd_in, every.mean, shrunk)
    doubt = torch.where(odd_in, every.variance, doubt)
    typical = torch.where(counts, data.variances, torch.nan).nanmedian(1).values.sqrt()
    nothing = torch.full_like(between, torch.nan)
    return Pooled(
        mean=population.centre,
        std=population.centre_variance.sqrt(),
        between=torch.where(several, between, nothing),
        between_ci95=between_ci95,
        daily=torch.where(repeated, daily, nothing),
        daily_ci95=daily_ci95,
        noise=typical,
        own=every.mean,
        own_std=every.variance.sqrt(),
        shrunk=shrunk,
        shrunk_std=doubt.sqrt(),
        deviation=deviation,
        p=p,
        odd=odd,
        p_unit=p_unit,
        odd_in=odd_in,
        units=units,
        sessions=counts.sum(1),
    )


def heterogeneity(data: Sessions, freedom: Float[Tensor, " S"]) -> Float[Tensor, " P"]:
    """p-values of the hypothesis that the sessions measure one value: Welch's test (1951), which
    for two is Welch's t test.

    It is Cochran's Q with the degrees of freedom of an F distribution that account for the
    variances' being estimates.

    Args:
        data: of sessions, each its own unit.
        freedom: degrees of freedom of their variances.

    Returns:
        nan where fewer than two count.
    """
    counts = data.counts
    m = counts.sum(1).double()
    w = torch.where(counts, 1 / data.variances, 0.0)
    whole, y = w.sum(1, keepdim=True), torch.where(counts, data.values, 0.0)
    q = (w * (y - (w * y).sum(1, keepdim=True) / whole).square()).sum(1) / (m - 1)
    loss = torch.where(counts, (1 - w / whole).square() / freedom, 0.0).sum(1)
    statistic = q / (1 + 2 * (m - 2) / (m.square() - 1) * loss)
    p = fdtrc((m - 1).numpy(), ((m.square() - 1) / (3 * loss)).numpy(), statistic.numpy())
    return torch.where(m > 1, torch.from_numpy(p), torch.nan)


def _far(data: Sessions) -> Bool[Tensor, "P U"]:
    """Units (P, U) far from the median of all, were their spread that of most of them."""
    nothing = torch.zeros(len(data.values), dtype=torch.float64)
    mean = means(data, nothing, nothing).mean
    enough = mean.isfinite().sum(1, keepdim=True) >= FEWEST_UNITS
    far = torch.zeros_like(mean, dtype=torch.bool)
    for _ in range(ROUNDS):  # many odd ones widen the spread, and fewer do the next time
        rest = torch.where(far, torch.nan, mean)
        left = mean - rest.nanmedian(1, keepdim=True).values
        near = torch.where(far, torch.nan, left.abs()).nanmedian(1, keepdim=True).values
        # 3.5: robust standard deviations from the median beyond which a unit is left out of the
        # first spreads; of normal units one in two thousand is
        far = (left.abs() > 3.5 * MAD_TO_SIGMA * near) & enough
    return far


def _deviations(
    data: Sessions, rest: Sessions, between: Tensor, daily: Tensor
) -> tuple[Float[Tensor, "P U"], Float[Tensor, "P U"]]:
    """How far each unit is from the mean of the others, studentised, and its p-value.

    The spread is that of the others, too: leaving unit u out of it changes it by the unit's own
    square, by which the internally studentised distance r becomes the external t = r sqrt((U - 2) /
    (U - 1 - r^2)) of U - 2 degrees of freedom (Cook and Weisberg 1982, eq. 2.2.10), where the
    unit's square is in the spread at all.
    """
    every, others = means(data, between, daily), means(rest, between, daily)
    counted = others.mean.isfinite()
    spread = between.square().unsqueeze(1) + every.variance
    weight = torch.where(counted, 1 / spread, 0.0)
    whole = weight.sum(1, keepdim=True)
    left = whole - weight
    mean = (whole * others.centre.unsqueeze(1) - weight * every.mean.nan_to_num()) / left
    units = counted.sum(1, keepdim=True)
    # For a counted unit, against a mean with it: var(m_u - mu) = V_u - 1 / whole.
    size = (spread - 1 / whole).clamp(min=1e-300).sqrt()
    inner = (every.mean - others.centre.unsqueeze(1)) / size
    # Without the unit the spread shrinks, at most to what its own sessions leave open.
    shrinks = (units - 1 - inner.square()) / (units - 2).clamp(min=1)
    outer = inner / shrinks.maximum(every.variance / spread).clamp(min=1e-12).sqrt()
    apart = (every.mean - mean) / (spread + 1 / left).sqrt()
    t = torch.where(counted, outer, apart)
    freedom = torch.where(counted, units - 2, units - 1).double()
    enough = (units >= FEWEST_UNITS) & every.mean.isfinite()
    t = torch.where(enough, t, torch.nan)
    return t, torch.where(enough, two_sided(t, freedom.clamp(min=1)), torch.nan)
