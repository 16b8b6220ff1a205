"""Motion of a long log, made a part at a time: as the whole, whoever asks for which part of it."""

import pytest
import torch

from torchid.design import in_parts, motion
from torchid.design.in_parts import MotionInParts
from torchid.design.motion import fast_speed, measurements, timed
from torchid.excitation.synthetic import synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.identification import validation
from torchid.identification.identify import identify
from torchid.identification.settings import Settings
from torchid.log.model import Log
from torchid.robot.library import load_robot

ROBOT = load_robot("3r_friction")
RATE, CUTOFF = 200.0, 8.0


def noisy(seed: int) -> Log:
    log = synthetic_log(ROBOT, trajectory_log(random_trajectory(ROBOT, seed, fill=True), RATE))
    random = torch.Generator().manual_seed(seed)
    return log.replace(tau=log.tau + 0.1 * torch.randn(log.tau.shape, generator=random).double())


FIRST, SECOND = noisy(0), noisy(1)
LOG = Log.concatenate([FIRST, SECOND])
SPEED = torch.full((3,), 0.05, dtype=torch.float64)
SIGNALS = ("q", "dq", "ddq", "direction", "t", "lag")
TAIL = 1e-7
"""Relative to a signal's largest value: what the filter's tail leaves out, twice differentiated."""


@pytest.fixture
def long(monkeypatch):
    """Any log counts as long, and has many parts."""
    monkeypatch.setattr(motion, "LONG", 0)
    monkeypatch.setattr(in_parts, "PART", 100)
    monkeypatch.setattr(validation, "PIECE", 700)


def with_links(log: Log) -> Log:
    return log.replace(ql=log.q - 1e-3 * torch.sin(log.q))


def some_of(log: Log) -> dict[str, Log]:
    return {
        "measured velocities": log,
        "positions alone": log.replace(dq=None, ddq=None),
        "encoders of the links": with_links(log),
        "velocities of something else": log.replace(dq=log.dq.flip(0)),
    }


@pytest.mark.parametrize("cutoff", [CUTOFF, 0.47 * RATE, None])
@pytest.mark.parametrize("kind", list(some_of(LOG)))
def test_parts_are_those_of_the_whole(kind, cutoff, request):
    log = some_of(LOG)[kind]
    whole = timed(measurements(log, cutoff, SPEED))
    request.getfixturevalue("long")
    parts = timed(measurements(log, cutoff, SPEED))
    for one, two in zip(whole, parts, strict=True):
        assert one.warnings == two.warnings
        assert one.own_velocity == two.own_velocity
        assert isinstance(two.motion, MotionInParts)
        for rows in (
            slice(None), slice(0, 1), slice(310, 350), slice(5, 1400), slice(900, None, 7),
            slice(one.samples - 3, None), slice(3, None, 640), slice(40, 40), slice(700, 2000),
        ):  # fmt: skip
            expected, got = one.motion.part(rows), two.motion.part(rows)
            for name in SIGNALS:
                a, b = getattr(expected, name), getattr(got, name)
                assert (a is None) == (b is None), name
                if a is not None:
                    assert a.shape == b.shape
                    size = float(getattr(one.whole, name).abs().max())
                    assert torch.allclose(a, b, rtol=0, atol=TAIL * size), (name, rows)


def test_no_more_than_two_parts_are_kept(long):
    (m, _) = measurements(LOG, CUTOFF, SPEED)
    for start in range(0, m.samples, 100):
        m.motion.part(slice(start, start + 100))
        assert len(m.motion._made["parts"]) <= in_parts.KEPT


def test_fast_speed_is_of_the_same_samples(request):
    expected = fast_speed(measurements(LOG, CUTOFF))
    request.getfixturevalue("long")
    assert torch.allclose(fast_speed(measurements(LOG, CUTOFF)), expected, rtol=1e-7)


@pytest.mark.nightly
@pytest.mark.parametrize(
    "effects",
    [
        ("viscous_friction", "coulomb_friction"),
        ("viscous_friction", "load_dependent_friction:joint=2"),
        ("viscous_friction", "presliding_hysteresis:joint=1,length=0.05"),
    ],
)
def test_a_long_log_is_identified_as_a_short_one(effects, request, monkeypatch):
    settings = Settings(effects=effects, cutoff=CUTOFF)
    one = identify(ROBOT, FIRST, held_out=SECOND, settings=settings)
    request.getfixturevalue("long")
    monkeypatch.setattr(validation, "MOST_SHOWN", 1000)
    two = identify(ROBOT, FIRST, held_out=SECOND, settings=settings)
    assert one.warnings == two.warnings
    std = one.covariance.diagonal().sqrt()
    assert bool(((one.values - two.values).abs() <= 1e-5 * std + 1e-12).all())
    for a, b in ((one.fit, two.fit), (one.held_out, two.held_out)):
        for name in ("rmse", "relative_percent", "relative_percent_raw", "standstill_fraction"):
            assert torch.allclose(getattr(a, name), getattr(b, name), rtol=1e-6), name
    # Of predictions as much is kept as can be looked at, evenly.
    (shown,), (every,) = two.fit_predictions, one.fit_predictions
    step = -(-FIRST.samples * 3 // 1000)
    assert torch.equal(shown.t, every.t[::step])
    assert torch.allclose(shown.predicted, every.predicted[::step], atol=1e-6)
    assert torch.equal(shown.moving, every.moving[::step])
