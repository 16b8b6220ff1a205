"""Logs as the diagnosis prepares them: refusals, rows that count, and directions of motion."""

import math
from functools import cache

import pytest
import torch

from tests.gap.motions import ROBOT
from torchid.design.bands import bands
from torchid.errors import LogError
from torchid.excitation.synthetic import synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.gap.data import prepare, spread_over
from torchid.log.model import Log
from torchid.typing import Tensor


@cache
def log(rate: float = 250.0, duration: float = 8.0, seeds: tuple[int, ...] = (0, 1)) -> Log:
    """Exact, in one piece a trajectory."""
    made = [
        synthetic_log(
            ROBOT,
            trajectory_log(random_trajectory(ROBOT, s, duration=duration, fill=True), rate),
        )
        for s in seeds
    ]
    return Log.concatenate([m.replace(dq=None, ddq=None) for m in made])


def changed(given: Log, factor: list[float], about: list[float] | None = None) -> Log:
    """The motion of each joint scaled."""
    middle = given.q.new_tensor(about or [0.3] * given.n)
    return given.replace(q=middle + (given.q - middle) * given.q.new_tensor(factor))


def test_faster_trajectories_are_resampled_to_the_slowest():
    slow = log().replace(t=2 * log().t)
    both = Log.concatenate([log(), slow])
    found = prepare(ROBOT, both, None)
    assert len({s.rate for s in found.segments}) == 1
    assert found.segments[0].rate == pytest.approx(
        0.5 * prepare(ROBOT, log(), None).segments[0].rate
    )
    assert any("resampled to" in w for w in found.warnings)
    # Nothing of the motion is lost, nor of the torque below the filter's band.
    alone = prepare(ROBOT, log(), None, rate=found.segments[0].rate)
    first = log().q[log().slices()[0]]
    q = alone.segments[0].motion.q
    assert float((q.std(0) / first.std(0) - 1).abs().max()) < 0.01


def test_rates_that_differ_by_less_and_more_than_one_percent_become_one():
    rates = [(165.5, (0,)), (166.7, (1,)), (168.4, (2,))]
    data = prepare(ROBOT, Log.concatenate([log(rate, 6.0, seeds) for rate, seeds in rates]), None)
    assert data.samples.rate == pytest.approx(165.5)
    assert len(data.segments) == 3


def test_too_short_is_refused():
    with pytest.raises(LogError, match="too short") as found:
        prepare(ROBOT, log(duration=8.0).select(slice(0, 200)), None)
    assert "0.8" in str(found.value)
    # The way out that is named is one.
    cutoff = float(str(found.value.hint).split("cutoff=")[1].split("`")[0])
    assert len(prepare(ROBOT, log(duration=8.0).select(slice(0, 200)), cutoff).segments) == 1


def test_short_ones_among_long_ones_are_left_out_and_said():
    keep = torch.ones(log().samples, dtype=torch.bool)
    keep[log().slices()[1]] = False
    keep[log().slices()[1].start : log().slices()[1].start + 150] = True
    found = prepare(ROBOT, log().select(keep), None)
    assert len(found.segments) == 1
    assert any("too short" in w and log().names[1] in w for w in found.warnings)


@pytest.mark.parametrize(("cutoff", "rate"), [(None, 250.0), (4.0, 250.0), (12.0, 250.0)])
def test_the_cut_off_is_the_wanted_one(cutoff, rate):
    narrow, wide = bands(log(rate), cutoff)
    assert cutoff is None or narrow == cutoff
    assert narrow < wide < rate / 2
    found = prepare(ROBOT, log(rate), cutoff)
    assert found.samples.cutoff == narrow
    assert found.segments[0].rate > 2 * wide


def test_signals_are_those_of_the_log():
    """Positions and torques in the wide band: those of a smooth motion as they were."""
    found = prepare(ROBOT, log(), None)
    assert found.still == ()
    assert found.missing == {"age", "velocity"}
    for segment, rows in zip(found.segments, log().slices(), strict=True):
        step = round(250.0 / segment.rate)
        inner = slice(found.samples.edge, -found.samples.edge)
        assert torch.allclose(segment.motion.q[inner], log().q[rows][::step][inner], atol=1e-4)
        assert torch.allclose(segment.tau[inner], log().tau[rows][::step][inner], atol=2e-2)


def test_own_velocities_are_known():
    true = trajectory_log(random_trajectory(ROBOT, 0, duration=8.0, fill=True), 250.0)
    made = synthetic_log(ROBOT, true).replace(ddq=None)
    assert prepare(ROBOT, made, None).missing == {"age"}


def test_joints_that_never_move_are_said():
    found = prepare(ROBOT, changed(log(), [1.0, 0.0, 1.0]), None)
    assert found.still == (1,)
    assert any("joint 2 never moves" in w for w in found.warnings)
    assert found.keep[1].all()
    assert found.slides.tolist() == [True, False, True]


@pytest.mark.parametrize("moves", [0.0, 1e-4])
def test_a_log_in_which_nothing_moves_shows_pushes_at_most(moves):
    found = prepare(ROBOT, changed(log(), [moves] * 3), None)
    assert found.stands
    with pytest.raises(LogError, match="stands still"):
        found.require_motion()
    assert not prepare(ROBOT, log(), None).stands


def test_repeated_torques_have_an_age():
    held = log().tau.clone()
    held[700:730, 1] = held[700, 1]
    found = prepare(ROBOT, log().replace(tau=held), None)
    assert found.missing == {"velocity"}
    assert float(found.segments[0].motion.age[:, 1].max()) > 0.05
    assert float(found.segments[0].motion.age[:, [0, 2]].abs().max()) == 0


def test_the_clock_of_another_log_goes_on():
    first = prepare(ROBOT, log(), None)
    later = prepare(ROBOT, log(), None, clock=first.end + 1.0)
    assert later.segments[0].start == pytest.approx(first.end + 1.0)
    assert first.seconds == pytest.approx(16.0, abs=2.0)


def dwelling() -> tuple[Log, Tensor]:
    """A log whose joint 2 stands still for a second at a time; and the instants it stands."""
    rate, seconds = 250.0, 12.0
    t = torch.arange(0, seconds, 1 / rate, dtype=torch.float64)
    # Half a cosine up, rest, half a cosine down, rest: 2 s, 1 s, 2 s, 1 s.
    phase = t % 6.0
    up = (1 - (math.pi * phase / 2).cos()) / 2
    down = (1 + (math.pi * (phase - 3) / 2).cos()) / 2
    q2 = torch.where(phase < 2, up, torch.where(phase < 3, 1.0, torch.where(phase < 5, down, 0.0)))
    rest = ((phase > 2) & (phase < 3)) | (phase > 5)
    others = torch.stack([(1.3 * t).sin(), (1.7 * t).sin()], -1)
    q = torch.stack([others[:, 0], q2, others[:, 1]], -1)
    return Log(t, q, tau=10 * q.cos()), rest


def test_rows_at_rest_do_not_count():
    given, rest = dwelling()
    found = prepare(ROBOT, given, None)
    step = round(250.0 / found.segments[0].rate)
    deep = -torch.nn.functional.max_pool1d(-rest.double()[None, None], 101, 1, 50)[0, 0] > 0
    resting = found.samples.pick([deep[::step]])
    moving = found.samples.pick([~rest[::step]])
    assert int(resting.sum()) > 10
    assert not found.keep[1][resting].any()
    assert found.keep[0][resting].double().mean() > 0.5
    assert found.keep[1][moving].double().mean() > 0.6


def test_a_dwelling_joint_keeps_the_direction_it_came_from():
    given, rest = dwelling()
    g = torch.Generator().manual_seed(0)
    noisy = given.replace(q=given.q + 1e-5 * torch.randn(given.q.shape, generator=g))
    found = prepare(ROBOT, noisy, None)
    segment = found.segments[0]
    step = round(250.0 / segment.rate)
    t = segment.motion.t
    phase = t % 6.0
    inner = (t > 1) & (t < 11)
    up = inner & (phase > 2.3) & (phase < 2.7)
    down = inner & (phase > 5.3) & (phase < 5.7)
    assert rest[::step][up].all()
    assert (segment.motion.direction[up, 1] == 1).all()
    assert (segment.motion.direction[down, 1] == -1).all()
    assert segment.motion.direction.abs().max() <= 1


@pytest.mark.parametrize(
    ("source", "asked", "expected"),
    [
        ("current", None, 0.05),
        ("sensor", None, 0.01),
        ("both", None, 0.01),
        ("sensor", 0.0, 0.0),
        ("current", 0.02, 0.02),
    ],
)
def test_the_scale_of_torques_from_currents_is_known_as_well_as_their_gains(
    source: str, asked: float | None, expected: float
) -> None:
    """And the default for them is said aloud; sensors are known better."""
    torque = log().tau
    assert torque is not None
    noise = 0.01 * torch.randn(torque.shape, generator=torch.Generator().manual_seed(0))
    given = {
        "current": log().replace(tau=None, current=torque / 10).with_torque([10.0] * 3),
        "sensor": log(),
        "both": log().replace(current=torque / 10 + noise),
    }[source]
    data = prepare(ROBOT, given, None, gain_std=asked)
    assert data.gain_std == expected
    assert any("`gain_std=" in w for w in data.warnings) == (asked is None and source == "current")


def ramps(lengths: tuple[int, ...], rate: float = 10.0) -> Log:
    """Trajectories whose first position is the number of the sample in the log."""
    count = sum(lengths)
    t = torch.arange(count, dtype=torch.float64) / rate
    q = torch.arange(count, dtype=torch.float64).unsqueeze(1).repeat(1, 2)
    run = torch.repeat_interleave(torch.arange(len(lengths)), torch.tensor(lengths))
    return Log(t, q, tau=q, trajectory=run, names=tuple(f"run {k}" for k in range(len(lengths))))


def test_a_log_that_is_not_too_long_is_diagnosed_whole():
    whole = ramps((600, 600))
    kept, said = spread_over(whole, 130.0)
    assert kept is whole
    assert said == ()


@pytest.mark.parametrize("lengths", [(60_000,), (300,) * 200, (20_000, 40_000)])
def test_of_a_long_log_stretches_spread_over_all_of_it_are_diagnosed(lengths):
    whole = ramps(lengths)
    kept, (said,) = spread_over(whole, 1200.0)
    assert 1000 < sum(kept.duration) <= 1200
    assert f"of {sum(whole.duration):.0f} s of motion {sum(kept.duration):.0f} s" in said
    # Samples as they were, in order, and from the log's beginning to its end.
    rows = kept.q[:, 0].long()
    assert bool((rows.diff() > 0).all())
    assert torch.equal(kept.t, whole.t[rows])
    assert rows[0] < 0.05 * whole.samples
    assert rows[-1] > 0.95 * whole.samples
    assert len(set(kept.names)) == kept.trajectory_count
    # No stretch goes over a border of trajectories, and none has a hole.
    for part in kept.trajectories():
        own = part.q[:, 0].long()
        assert bool((own.diff() == 1).all())
        assert len(whole.trajectory[own].unique()) == 1
