"""Differentiated, filtered motion; the direction of a joint; what a log's dq and ddq are worth."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from torchid.design.in_parts import WIDE
from torchid.design.motion import (
    Measurement,
    direction,
    fast_speed,
    measurements,
    moves,
)
from torchid.errors import LogError
from torchid.excitation.synthetic import synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.log.filtering import ZeroPhaseFilter
from torchid.log.model import Log
from torchid.log.movement import RESTING
from torchid.robot.library import load_robot

ROBOT = load_robot("3r")
RATE, CUTOFF = 200.0, 8.0
LOG = synthetic_log(ROBOT, trajectory_log(random_trajectory(ROBOT, 0, fill=True), RATE))


def slow_direction(dq: list[float], threshold: float) -> list[float]:
    held, out = 0.0, []
    for speed in dq:
        if abs(speed) > threshold:
            held = 1.0 if speed > 0 else -1.0
        out.append(held)
    return out


def one(log: Log, cutoff: float | None = CUTOFF, **kwargs) -> Measurement:
    (found,) = measurements(log, cutoff, **kwargs)
    return found


def shifted(log: Log, name: str, samples: int) -> Log:
    """The signal comes later by a number of samples; the ends are repeated."""
    index = (torch.arange(log.samples) - samples).clamp(0, log.samples - 1)
    return log.replace(**{name: getattr(log, name)[index]})


speeds = st.lists(st.sampled_from([-2.0, -0.5, -0.1, -0.0, 0.0, 0.1, 0.5, 2.0]), min_size=1)


@given(st.tuples(speeds, speeds), st.sampled_from([0.0, 0.1, 0.3, 1.0, 5.0]))
@settings(max_examples=150, derandomize=True)
def test_direction_is_that_of_a_slow_loop(pair, threshold):
    samples = min(map(len, pair))
    columns = [column[:samples] for column in pair]
    dq = torch.tensor(columns, dtype=torch.float64).T
    got = direction(dq, torch.tensor([threshold, 0.1], dtype=torch.float64)).T.tolist()
    assert got == [slow_direction(columns[0], threshold), slow_direction(columns[1], 0.1)]


def test_motion_is_the_filtered_derivative():
    """Away from the ends, of positions alone, to the difference between dq and its chord."""
    found = one(LOG.replace(dq=None, ddq=None))
    low_pass = ZeroPhaseFilter(RATE, CUTOFF)
    inner = slice(found.edge, found.samples - found.edge)
    for got, true in zip(found.motion.state, (LOG.q, LOG.dq, LOG.ddq), strict=True):
        expected = low_pass.apply(true.T).T
        assert float((got - expected)[inner].abs().max() / true.abs().max()) < 2e-3
    assert found.edge == 25
    assert found.rate == pytest.approx(RATE)
    assert torch.equal(found.tau, LOG.tau)
    assert torch.equal(moves(found.whole), found.motion.dq.abs() > RESTING)


def test_rounding_at_rest_has_no_direction():
    """The same log from another file format differs in the last digit, at rest in its sign."""
    dq = torch.tensor([0.0, 0.5, 1.0, 0.2, 0.0, 0.0, -0.4], dtype=torch.float64)
    rounded = dq + 1e-13 * torch.tensor([-1.0, 1, 1, 1, -1, 1, -1], dtype=torch.float64)
    both = torch.stack([dq, rounded], -1)
    assert (
        direction(both, torch.zeros(2, dtype=torch.float64)).T.tolist()
        == [[0, 1, 1, 1, 1, 1, -1]] * 2
    )


def test_the_direction_is_that_of_a_sharper_motion():
    found = one(LOG, reversal=torch.tensor([0.0, 0.05, 0.5], dtype=torch.float64))
    wide = ZeroPhaseFilter(RATE, WIDE * CUTOFF).apply(LOG.dq.T).T
    for j, threshold in enumerate((0.0, 0.05, 0.5)):
        expected = slow_direction(wide[:, j].tolist(), threshold)
        assert found.motion.direction[:, j].tolist() == expected


def test_beyond_the_logs_band_the_direction_is_that_of_the_log():
    found = one(LOG, cutoff=0.1 * RATE)
    assert torch.equal(
        found.motion.direction, direction(LOG.dq, torch.zeros(3, dtype=torch.float64))
    )


def test_without_a_cutoff_the_log_is_taken_as_it_is():
    found = one(LOG, cutoff=None)
    for got, given_ in zip(found.motion.state, (LOG.q, LOG.dq, LOG.ddq), strict=True):
        assert torch.equal(got, given_)
    assert found.edge == 0
    assert found.warnings == ()


@pytest.mark.parametrize("samples", [-4, -1, 1, 4])
def test_a_planted_lag_of_velocity_is_said(samples):
    log = shifted(LOG.replace(ddq=None), "dq", samples)
    (warning,) = one(log).warnings
    assert "lags" in warning if samples > 0 else "leads" in warning
    told = float(warning.split(" by ")[1].split(" ms")[0])
    assert told == pytest.approx(abs(samples) / RATE * 1e3, rel=0.1)


def test_no_lag_no_warning():
    assert one(LOG).warnings == ()


def test_accelerations_that_agree_are_used():
    found = one(LOG)
    assert torch.allclose(found.motion.ddq, ZeroPhaseFilter(RATE, CUTOFF).apply(LOG.ddq.T).T)


def spoilt(kind: str) -> Log:
    ddq = LOG.ddq.clone()
    if kind == "late":
        return shifted(LOG, "ddq", 5)
    if kind == "zero":
        return LOG.replace(ddq=torch.zeros_like(ddq))
    if kind == "one joint zero":
        ddq[:, 1] = 0
    if kind == "other sign":
        ddq = -ddq
    if kind == "degrees":
        ddq = ddq * 57.3
    if kind == "slow joint wrong":
        # A tenth as fast as the others: its own error must not drown in theirs.
        plan = LOG.replace(**{k: LOG.signals[k].clone() for k in ("q", "dq", "ddq")})
        for signal in (plan.q, plan.dq, plan.ddq):
            signal[:, 2] *= 0.01
        plan.ddq[:, 2] *= 3
        return plan
    return LOG.replace(ddq=ddq)


KINDS = ("late", "zero", "one joint zero", "other sign", "degrees", "slow joint wrong")


@pytest.mark.parametrize("kind", KINDS)
def test_accelerations_that_do_not_agree_are_not_used(kind):
    log = spoilt(kind)
    found = one(log)
    torch.testing.assert_close(
        found.motion.ddq, one(log.replace(ddq=None)).motion.ddq, rtol=1e-12, atol=1e-12
    )
    (warning,) = found.warnings
    assert "ddq differs from the derivative of dq" in warning
    if kind == "late":
        assert "(lag 25 ms)" in warning


def test_a_joint_that_never_moves_spoils_no_agreement():
    still = {k: LOG.signals[k].clone() for k in ("q", "dq", "ddq")}
    still["q"][:, 0] = 0.3
    still["dq"][:, 0] = still["ddq"][:, 0] = 0.0
    found = one(LOG.replace(**still))
    assert found.warnings == ()
    assert not bool(moves(found.whole)[:, 0].any())
    assert bool((found.motion.direction[:, 0] == 0).all())


def test_a_log_without_torque():
    with pytest.raises(LogError, match="has no torque") as info:
        measurements(LOG.replace(tau=None, ddq=None), CUTOFF)
    n = LOG.n
    assert info.value.got == f"t, q1..q{n}, dq1..dq{n}"
    with pytest.raises(LogError, match="drive_gain"):
        measurements(LOG.replace(tau=None, current=LOG.tau), CUTOFF)


def test_a_trajectory_that_is_too_short():
    edges = 2 * round(RATE / CUTOFF)
    assert one(LOG.select(slice(0, edges + 10))).samples == edges + 10
    with pytest.raises(LogError, match="too short to be filtered at 8 Hz"):
        measurements(LOG.select(slice(0, edges + 9)), CUTOFF)


def test_a_cutoff_out_of_band():
    for log in (LOG, LOG.replace(dq=None, ddq=None)):
        with pytest.raises(LogError, match="outside the log's band"):
            measurements(log, -1.0)


def test_trajectories_are_filtered_apart():
    other = LOG.replace(q=LOG.q.flip(0) + 1, dq=-LOG.dq.flip(0), ddq=LOG.ddq.flip(0))
    both = Log.concatenate([LOG, other])
    for got, alone in zip(measurements(both, CUTOFF), (LOG, other), strict=True):
        expected = one(alone)
        torch.testing.assert_close(got.motion.ddq, expected.motion.ddq, rtol=1e-12, atol=1e-12)
        assert torch.equal(got.motion.direction, expected.motion.direction)


def test_fast_speed_is_the_99_percent_quantile():
    found = measurements(Log.concatenate([LOG, LOG]), None)
    expected = torch.quantile(LOG.dq.abs(), 0.99, dim=0)
    assert torch.allclose(fast_speed(found), expected, rtol=1e-3)
