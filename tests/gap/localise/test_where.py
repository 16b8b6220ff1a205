"""Planted structure is found in its regime and joint, and where there is none nothing is found."""

import math
from dataclasses import replace
from typing import get_args

import msgspec
import pytest
import torch

from tests.gap.diagnoses import NOISE, banded, coloured, floor, trace
from tests.marks import quick_first
from torchid.gap.localise.regimes import reversals
from torchid.gap.localise.resampling import Draws, Look, best_of, corrected, linear, quadratic
from torchid.gap.localise.signatures import white_share
from torchid.gap.localise.where import where
from torchid.gap.record import NoiseFloor, Regime

JOINT = 1


def on_joint(formula):
    """A gap on one joint only."""

    def gap(motion, model):
        out = torch.zeros_like(motion.q)
        out[:, JOINT] = formula(motion, model)[:, JOINT]
        return out

    return gap


def in_time(formula):
    return lambda motion, model: formula(motion.t).unsqueeze(-1).expand_as(motion.q)


def clear(regimes):
    return {(r.joint, r.regime) for r in regimes if r.p < 0.05}


def of(regimes, name, joint=JOINT):
    return next(r for r in regimes if (r.joint, r.regime) == (joint, name))


PLANTED = {
    "coulomb": (lambda m, tau: 0.3 * m.dq.sign(), {"velocity_reversal"}, ()),
    "stribeck": (
        lambda m, tau: 0.4 * torch.exp(-((m.dq / 0.05) ** 2)) * m.dq.sign(),
        {"low_speed", "velocity_reversal"},
        ("transient",),  # a long crawl
    ),
    "viscous": (lambda m, tau: 0.2 * m.dq, {"high_speed"}, ()),
    "inertia": (lambda m, tau: 0.1 * m.ddq, {"high_acceleration"}, ("velocity_reversal",)),
    "load": (
        lambda m, tau: 0.2 * tau * (m.ddq.abs() < 1),
        {"gravity_load"},
        ("high_acceleration", "transient", "high_frequency"),
    ),
    "cogging": (lambda m, tau: 0.05 * torch.sin(24 * m.q + 0.7), {"position_periodic"}, ()),
    "vibration": (
        in_time(lambda t: 0.1 * torch.sin(2 * math.pi * 15 * t)),
        {"high_frequency"},
        (),
    ),
    "drift": (in_time(lambda t: 0.1 * t / 60), {"slow_drift"}, ()),
    "warming": (
        lambda m, tau: -0.2 * (1 - torch.exp(-m.t / 30)).unsqueeze(-1) * m.dq,
        {"slow_drift"},
        ("high_speed",),
    ),
    "bump": (in_time(lambda t: torch.exp(-(((t - 20) / 0.15) ** 2))), {"transient"}, ()),
}


@pytest.mark.parametrize("name", quick_first(PLANTED, 5))
def test_planted_structure_is_found_in_its_regime_and_on_its_joint_alone(name):
    formula, expected, also = PLANTED[name]
    for seed in (3, 4):
        joints, regimes = where([trace(on_joint(formula), seed=seed)], floor(), seed, band=20.0)
        found = clear(regimes)
        assert {(JOINT, r) for r in expected} <= found
        assert found <= {(JOINT, r) for r in (*expected, *also)}
        assert joints[JOINT].share > 0.95
        for regime in expected:
            r = of(regimes, regime)
            assert 0 < r.excess <= 1
            assert r.ci95[0] <= r.excess <= r.ci95[1]


def test_share_of_a_line_is_its_share_of_the_energy_above_the_noise():
    """A sine of amplitude a over the angle holds a^2 / 2; all of the gap above the noise."""
    gap = on_joint(lambda m, tau: 0.15 * torch.sin(20 * m.q))
    _, regimes = where([trace(gap, seed=5)], floor(), 0, band=20.0)
    assert of(regimes, "position_periodic").excess == pytest.approx(0.9, abs=0.15)


def test_share_of_a_jump_is_all_of_a_gap_that_only_flips():
    _, regimes = where(
        [trace(on_joint(lambda m, tau: 0.5 * m.dq.sign()), seed=6)], floor(), 0, band=20.0
    )
    assert of(regimes, "velocity_reversal").excess == pytest.approx(1.0, abs=0.15)


def test_times_of_transients():
    bumps = in_time(
        lambda t: sum(torch.exp(-(((t - c) / 0.1) ** 2)) for c in (12.3, 41.0))  # type: ignore[return-value]
    )
    _, regimes = where([trace(on_joint(bumps), seed=2)], floor(), 0, band=20.0)
    times = of(regimes, "transient").times
    assert all(any(w.from_s - 0.15 < c < w.to_s + 0.15 for w in times) for c in (12.3, 41.0))
    middles = [0.5 * (w.from_s + w.to_s) for w in times]
    assert all(min(abs(m - c) for c in (12.3, 41.0)) < 0.4 for m in middles)
    assert not of(regimes, "transient", joint=0).times


def test_times_are_those_of_the_trajectory():
    """Time runs on from one trajectory to the next; what is told does not."""
    bump = in_time(lambda t: torch.exp(-(((t - 12.3) / 0.1) ** 2)))
    first, second = trace(seed=1), trace(on_joint(bump), seed=2)
    later = second.motion._replace(t=second.motion.t + 100.0)
    both = [replace(first, name="one"), replace(second, name="two", motion=later)]
    _, regimes = where(both, floor(), 0, band=20.0)
    times = of(regimes, "transient").times
    assert times
    assert all(w.trajectory == "two" for w in times)
    assert all(abs(0.5 * (w.from_s + w.to_s) - 12.3) < 0.4 for w in times)


def test_all_regimes_of_all_joints_are_there():
    joints, regimes = where([trace(n=2, seconds=20.0)], floor(2), 0, band=20.0)
    assert [j.joint for j in joints] == [0, 1]
    assert {(r.joint, r.regime) for r in regimes} == {
        (j, r) for j in range(2) for r in get_args(Regime)
    }
    assert all(0 < r.p <= 1 and -1 <= r.excess <= 1 for r in regimes)


def test_joints_by_hand():
    """RMS of valid instants alone; shares of the squares above the noise."""
    made = trace(n=2, seconds=10.0)
    gap = torch.tensor([0.3, 0.4], dtype=torch.float64)
    measured = made.before + gap
    measured[:25] += 100.0
    level = torch.tensor([0.1, 0.2], dtype=torch.float64)
    bracket = NoiseFloor(level, level, "bracket")
    joints, _ = where([replace(made, measured=measured)], bracket, 0, band=20.0)
    assert [j.gap_rms for j in joints] == pytest.approx([0.3, 0.4])
    above = [0.09 - 0.01, 0.16 - 0.04]
    assert [j.share for j in joints] == pytest.approx([x / sum(above) for x in above])


def test_two_trajectories_with_invalid_instants():
    gap = on_joint(PLANTED["coulomb"][0])
    traces = []
    for seed in (7, 8):
        one = trace(gap, seed=seed, seconds=30.0)
        valid = one.valid.clone()
        valid[3000:3200] = False
        measured = one.measured.clone()
        measured[3000:3200] = torch.nan
        traces.append(replace(one, valid=valid, measured=measured))
    _, regimes = where(traces, floor(), 0, band=20.0)
    assert clear(regimes) == {(JOINT, "velocity_reversal")}


@pytest.mark.parametrize("rate", [50.0, 1000.0])
def test_other_rates(rate):
    made = trace(on_joint(PLANTED["viscous"][0]), seed=1, rate=rate)
    _, regimes = where([made], floor(), 0, band=20.0)
    assert clear(regimes) == {(JOINT, "high_speed")}


def test_a_joint_at_rest_and_a_gap_of_zero_are_no_regime():
    made = trace(seed=1, seconds=20.0)
    still = made.motion.q.clone()
    still[:, 0] = 0.3
    dq, ddq = made.motion.dq.clone(), made.motion.ddq.clone()
    dq[:, 0], ddq[:, 0] = 0.0, 0.0
    motion = made.motion._replace(q=still, dq=dq, ddq=ddq)
    _, regimes = where([replace(made, motion=motion, measured=made.before)], floor(), 0, band=20.0)
    assert all(r.p > 0.05 and r.excess == pytest.approx(0) for r in regimes)
    assert of(regimes, "velocity_reversal", joint=0).p == 1.0


def test_a_short_log_says_nothing():
    _, regimes = where([trace(seconds=1.0)], floor(), 0, band=20.0)
    assert all(r.p == 1.0 for r in regimes)


def test_same_seed_same_answer():
    traces = [trace(on_joint(PLANTED["coulomb"][0]), seconds=20.0)]
    noise = msgspec.structs.replace(floor(), source="repeats")  # without them an end is NaN
    assert where(traces, noise, 3, band=20.0) == where(traces, noise, 3, band=20.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("correlation", "runs"),
    [
        (0.0, 12),
        (0.98, 12),
        pytest.param(0.0, 150, marks=pytest.mark.nightly),
        pytest.param(0.98, 150, marks=pytest.mark.nightly),
    ],
)
def test_no_structure_no_regime(correlation, runs):
    """Any p below 0.05 in 5 % of runs; the bound is the 99.9 % quantile of that binomial."""
    from scipy.stats import binom

    alarms = sum(
        bool(clear(where([trace(seed=100 + s, correlation=correlation)], floor(), s, band=20.0)[1]))
        for s in range(runs)
    )
    assert alarms <= binom.ppf(0.999, runs, 0.05)


def test_jumps_are_measured_and_slopes_are_not():
    rate, t = 100.0, torch.arange(0, 4, 0.01, dtype=torch.float64)
    sign = torch.where(t < 2, 1.0, -1.0).unsqueeze(-1).double()
    error = (0.4 * sign[:, 0] + 0.3 * t).unsqueeze(-1)
    since, jump = reversals(sign, error, rate, 20.0)
    assert jump[200, 0] == pytest.approx(0.4)
    assert int((jump != 0).sum()) == 1
    assert since[199, 0] == torch.inf
    assert since[250, 0] == pytest.approx(0.5)


def test_white_noise_has_its_share_above_half_the_band():
    rate = 60.0
    x = banded(coloured(200_000, 1, 0, 0.0), rate)
    from torchid.log.filtering import ZeroPhaseFilter

    upper = x - ZeroPhaseFilter(rate, 10.0).apply(x.T).T
    share = float(upper.square().sum() / x.square().sum())
    assert white_share(rate, 20.0) == pytest.approx(share, rel=0.02)


def test_quadratic_energy_has_no_bias_from_noise():
    """Block sums that are pure noise: E (sum c)^2 = sum E c^2, which is taken out."""
    g = torch.Generator().manual_seed(0)
    parts = torch.randn(20, 4000, generator=g, dtype=torch.float64)
    energy = quadratic(parts, torch.ones(4000, dtype=torch.float64))
    values = energy(torch.ones(1, 20, dtype=torch.float64))[0]
    assert abs(float(values.mean())) < 4 * float(values.std()) / math.sqrt(4000)


def test_p_is_uniform_for_exchangeable_statistics():
    """The observed statistic drawn as its null: p < 0.2 in 20 % of runs for the smallest of all."""
    hits = 0
    for seed in range(200):
        g = torch.Generator().manual_seed(seed)
        both = torch.randn(2, 100, 3, generator=g, dtype=torch.float64)
        looks = [
            Look(x[0], x[1:], linear(torch.zeros(4, 3).double()), torch.ones(3, dtype=torch.bool))
            for x in both
        ]
        hits += bool(corrected([looks[0], best_of([looks[1], looks[0]])]).min() < 0.2)
    assert 20 <= hits <= 62


def test_draws_are_permutations_and_signs():
    draws = Draws.of(12, seed=1, count=7)
    assert torch.equal(draws.order.sort(-1).values, torch.arange(12).expand(7, -1))
    assert bool((draws.signs.abs() == 1).all())
    assert NOISE > 0
