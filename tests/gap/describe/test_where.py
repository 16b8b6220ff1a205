"""Planted structure is found in its regime and joint, and where there is none nothing is found."""

from dataclasses import replace
from typing import get_args

import pytest
import torch

from tests.gap.diagnoses import floor, trace
from torchid.gap.describe.where import regime_instants, where
from torchid.gap.diagnosis import Trace
from torchid.gap.record import NoiseFloor, Regime

JOINT = 1


def on_joint(formula):
    """A gap on one joint only."""

    def gap(motion, model):
        out = torch.zeros_like(motion.q)
        out[:, JOINT] = formula(motion, model)[:, JOINT]
        return out

    return gap


def clear(regimes):
    return {(r.joint, r.regime) for r in regimes if r.p < 0.05}


def of(regimes, name, joint=JOINT):
    return next(r for r in regimes if (r.joint, r.regime) == (joint, name))


PLANTED = {
    "stribeck": (
        lambda m, tau: 0.4 * torch.exp(-((m.dq / 0.05) ** 2)) * m.dq.sign(), {"slow"}, {"reversal"}
    ),
    "viscous": (lambda m, tau: 0.2 * m.dq, {"fast"}, set()),
    "rest": (lambda m, tau: 0.4 * (m.dq.abs() < 1e-9), {"rest"}, {"slow"}),
    "turning": (
        lambda m, tau: 0.5 * m.dq.sign() * torch.exp(-((m.dq / 0.2) ** 2)), {"reversal"}, {"slow"}
    ),
}  # fmt: skip


def resting(made: Trace) -> Trace:
    """The same, with the joint at rest for a fifth of the time."""
    still = ((made.motion.t % 5.0) < 1.0).unsqueeze(1)
    dq = torch.where(still, 0.0, made.motion.dq)
    return replace(made, motion=made.motion._replace(dq=dq))


@pytest.mark.parametrize("name", PLANTED)
def test_planted_structure_is_found_in_its_regime_and_on_its_joint_alone(name):
    formula, expected, also = PLANTED[name]
    for seed in (3, 4):
        made = trace(None, seed=seed)
        made = resting(made) if name == "rest" else made
        gap = on_joint(formula)(made.motion, made.before)
        joints, regimes = where(
            [replace(made, measured=made.measured + gap)], floor(), seed, band=20.0
        )
        found = clear(regimes)
        assert {(JOINT, r) for r in expected} <= found
        assert found <= {(JOINT, r) for r in expected | also}
        assert joints[JOINT].share > 0.95
        for regime in expected:
            r = of(regimes, regime)
            assert 0 < r.excess <= 1
            assert r.ci95[0] <= r.excess <= r.ci95[1]


def test_a_gap_of_one_regime_has_all_of_its_excess_there():
    """What of it is beyond the regime's share of the time."""
    made = resting(trace(None, seed=5, n=2))
    gap = on_joint(lambda m, tau: 3.0 * (m.dq.abs() < 1e-9))(made.motion, made.before)
    _, regimes = where([replace(made, measured=made.measured + gap)], floor(2), 0, band=20.0)
    assert of(regimes, "rest").excess == pytest.approx(0.8, abs=0.1)
    assert of(regimes, "fast").excess < 0


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
    gap = on_joint(PLANTED["viscous"][0])
    traces = []
    for seed in (7, 8):
        one = trace(gap, seed=seed, seconds=30.0)
        valid = one.valid.clone()
        valid[3000:3200] = False
        measured = one.measured.clone()
        measured[3000:3200] = torch.nan
        traces.append(replace(one, valid=valid, measured=measured))
    _, regimes = where(traces, floor(), 0, band=20.0)
    assert clear(regimes) == {(JOINT, "fast")}


def test_a_joint_at_rest_and_a_gap_of_zero_are_no_regime():
    made = trace(seed=1, seconds=20.0)
    still = made.motion.q.clone()
    still[:, 0] = 0.3
    dq, ddq = made.motion.dq.clone(), made.motion.ddq.clone()
    dq[:, 0], ddq[:, 0] = 0.0, 0.0
    motion = made.motion._replace(q=still, dq=dq, ddq=ddq)
    _, regimes = where([replace(made, motion=motion, measured=made.before)], floor(), 0, band=20.0)
    assert all(r.p > 0.05 and r.excess == pytest.approx(0) for r in regimes)
    assert of(regimes, "reversal", joint=0).p == 1.0


def test_a_short_log_says_nothing():
    _, regimes = where([trace(seconds=1.0)], floor(), 0, band=20.0)
    assert all(r.p == 1.0 for r in regimes)


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


def test_regimes_are_parts_of_the_time():
    """Each joint rests, or moves slowly or fast or in between; a reversal is soon over."""
    made = resting(trace(None, seed=1))
    (masks,) = regime_instants([made], 20.0)
    rest, slow, fast, turned = (masks[name] for name in get_args(Regime))
    assert not (rest & slow).any()
    assert not (fast & (rest | slow)).any()
    assert bool((made.motion.dq[rest].abs() < 0.05).all())
    speed = made.motion.dq.abs()
    for j in range(3):
        assert float(speed[slow[:, j], j].max()) < float(speed[fast[:, j], j].min())
        assert 0 < float(turned[:, j].double().mean()) <= 0.26
    assert not any(bool(x[~made.valid].any()) for x in masks.values())


@pytest.mark.parametrize("rate", [50.0, 1000.0])
def test_other_rates(rate):
    made = trace(on_joint(PLANTED["viscous"][0]), seed=1, rate=rate)
    _, regimes = where([made], floor(), 0, band=20.0)
    assert clear(regimes) == {(JOINT, "fast")}
