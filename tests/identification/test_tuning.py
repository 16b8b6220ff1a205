"""The cut-off and the reversal speeds that cross-validation chooses."""

from dataclasses import replace
from functools import lru_cache

import pytest
import torch

from tests.identification.test_rows import layout_of
from torchid.design.motion import direction, fast_speed, measurements
from torchid.effects.base import Motion
from torchid.excitation.synthetic import HonestNoise, nominal_torque, synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.identification import tuning
from torchid.identification.identify import Settings, identify
from torchid.identification.least_squares import fit
from torchid.identification.model import model_torque
from torchid.identification.rows import RowSource
from torchid.identification.tuning import (
    CUTOFFS,
    Training,
    choose_cutoff,
    choose_reversal,
)
from torchid.log.model import Log
from torchid.robot.library import load_robot

ROBOT = load_robot("3r_friction")
RIGID = load_robot("3r")
COARSE = HonestNoise(encoder_step=1e-4, torque_relative=0.02)


def training(log: Log, robot=ROBOT, effects=None) -> Training:
    columns = layout_of(robot) if effects is None else layout_of(robot, effects)
    return Training(log, columns, Settings(rows="all", signs="free"))


def log_of(robot, noise, *, seed=0, rate=100.0, duration=20.0, count=2, **kwargs) -> Log:
    plan = random_trajectory(robot, seed, count=count, fill=True, duration=duration, **kwargs)
    return synthetic_log(robot, trajectory_log(plan, rate), noise, seed)


def true_error(log: Log, robot, effects, cutoff: float) -> float:
    """Mean relative error over joints of the noise-free torque of another motion [%]."""
    columns = layout_of(robot, effects)
    found = fit(RowSource(measurements(log, cutoff), columns))
    values = torch.empty_like(found.x)
    values[list(columns.order)] = found.x
    plan = trajectory_log(random_trajectory(robot, 99, fill=True), 100.0)
    motion = Motion(plan.q, plan.dq, plan.ddq)
    tau = nominal_torque(robot, motion)
    got = model_torque(robot, columns.base, columns.effects, values, motion)
    return float(100 * ((got - tau).norm(dim=0) / tau.norm(dim=0)).mean())


EFFECTS = ("viscous_friction", "coulomb_friction", "torque_offset")


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("robot", "effects", "step", "seed"),
    [
        (RIGID, (), 1e-3, 0),
        (RIGID, (), 3e-5, 1),
        (ROBOT, EFFECTS, 1e-4, 0),
        (ROBOT, EFFECTS, 1e-4, 1),
    ],
)
def test_the_cutoff_is_nearly_the_best_for_the_truth(robot, effects, step, seed):
    log = log_of(robot, HonestNoise(encoder_step=step, torque_relative=0.02), seed=seed)
    choice = choose_cutoff(training(log, robot, effects))
    errors = {f: true_error(log, robot, effects, f) for f in choice.candidates}
    assert choice.cutoff is not None
    assert errors[choice.cutoff] <= 2.0 * min(errors.values()), errors
    assert errors[choice.cutoff] < 0.3 * max(errors.values()) or max(errors.values()) < 1, errors
    assert choice.candidates == tuple(f for f in CUTOFFS if 1.0 <= f <= 20.0)
    assert choice.scores[choice.candidates.index(choice.cutoff)] == min(choice.scores)


@pytest.mark.slow
def test_a_coarser_encoder_asks_for_a_lower_cutoff():
    chosen = [
        choose_cutoff(training(log_of(RIGID, HonestNoise(step, 0.02)), RIGID, ())).cutoff
        for step in (1e-6, 1e-3)
    ]
    assert chosen[1] < chosen[0]
    assert 1.0 <= chosen[1] <= 6.0


@pytest.mark.slow
def test_a_log_without_noise_and_with_accelerations_needs_no_filter():
    choice = choose_cutoff(training(log_of(ROBOT, None)))
    assert choice.cutoff is None
    assert choice.candidates[-1] is None
    assert choose_cutoff(training(log_of(ROBOT, COARSE))).candidates[-1] is not None


def test_candidates_of_short_and_of_slow_logs():
    short = log_of(RIGID, COARSE, duration=4.0, count=1)
    assert min(choose_cutoff(training(short, RIGID, ())).candidates) == 6.0
    slow = log_of(RIGID, COARSE, rate=10.0)
    assert choose_cutoff(training(slow, RIGID, ())).candidates == (1.0, 1.5, 2.0)
    both = log_of(RIGID, COARSE, rate=10.0, duration=3.0, count=1)
    assert choose_cutoff(training(both, RIGID, ())).candidates == (2.0,)


@pytest.mark.nightly
@pytest.mark.parametrize("how", ["another log", "a share of this log"])
def test_choices_depend_on_training_data_only(how):
    log = log_of(ROBOT, COARSE)
    if how == "another log":
        held = log_of(ROBOT, COARSE, seed=5)
        spoilt = held.replace(tau=held.tau.flip(0) * 7, q=held.q.flip(0))
        pairs = [(log, held), (log, spoilt)]
        settings = Settings()
    else:
        late = torch.cat([m.t > 0.61 * m.t[-1] for m in log.trajectories()]).unsqueeze(-1)
        altered = log.replace(
            tau=torch.where(late, 3 - log.tau, log.tau), q=torch.where(late, 0.5 * log.q, log.q)
        )
        pairs = [(log, None), (altered, None)]
        settings = Settings(held_out_fraction=0.39)
    one, two = (identify(ROBOT, a, held_out=b, settings=settings) for a, b in pairs)
    assert one.cutoff == two.cutoff
    assert one.cutoff_choice == two.cutoff_choice
    assert torch.equal(one.reversal, two.reversal)
    torch.testing.assert_close(one.values, two.values, rtol=1e-12, atol=1e-12)
    assert torch.allclose(one.covariance, two.covariance, rtol=1e-9)
    assert not torch.allclose(one.held_out.rmse, two.held_out.rmse)


@lru_cache
def slow_motion() -> Log:
    """Slow, and with many reversals."""
    plan = random_trajectory(ROBOT, 2, count=3, duration=20.0, w_f=1.2)
    slowed = replace(plan, a=0.4 * plan.a, b=0.4 * plan.b)
    return trajectory_log(slowed, 200.0)


def test_a_higher_reversal_speed_must_be_worth_a_hundredth(monkeypatch):
    """Of each joint the lowest speed within 1 % of its least error."""
    scores = torch.tensor(
        [[1.02, 1.009, 5.0], [1.005, 1.0, 4.0], [1.0, 1.1, 3.0], [1.1, 1.2, 2.0], [1.2, 1.3, 1.1],
         [1.3, 1.4, 1.0]], dtype=torch.float64,
    )  # fmt: skip
    given = iter(scores)
    monkeypatch.setattr(tuning, "_filtered_errors", lambda *_, **__: next(given))
    log = log_of(ROBOT, COARSE)
    found = choose_reversal(training(log), 8.0) / fast_speed(measurements(log, 8.0))
    expected = [tuning.REVERSALS[k] for k in (1, 0, 5)]
    assert found.tolist() == pytest.approx(expected)


@pytest.mark.nightly
@pytest.mark.parametrize("joint", [0, 1, 2])
def test_a_planted_delay_of_friction_is_found(joint):
    plan = slow_motion()
    speed = torch.quantile(plan.dq.abs(), 0.99, dim=0)
    planted = torch.zeros(3, dtype=torch.float64)
    planted[joint] = 0.04 * speed[joint]
    clean = synthetic_log(ROBOT, plan, HonestNoise(1e-6, 0.002), seed=1)
    friction = torch.tensor([0.2450, 0.1523, 0.1827], dtype=torch.float64)
    late = torch.cat(
        [
            direction(part.dq, planted) - direction(part.dq, 0 * planted)
            for part in plan.trajectories()
        ]
    )
    found = choose_reversal(training(clean.replace(tau=clean.tau + friction * late)), 8.0)
    share = found / fast_speed(measurements(clean, 8.0))
    assert float(share[joint]) in (pytest.approx(0.02), pytest.approx(0.04))
    others = [float(share[j]) for j in range(3) if j != joint]
    assert max(others) <= 0.005
    sharp = choose_reversal(training(clean), 8.0) / fast_speed(measurements(clean, 8.0))
    assert float(sharp.max()) <= 0.005


def test_without_friction_that_jumps_there_is_no_reversal_speed():
    log = log_of(RIGID, COARSE)
    none = choose_reversal(training(log, RIGID, ("viscous_friction",)), 5.0)
    assert none.tolist() == [0.0, 0.0, 0.0]


@pytest.mark.slow
def test_what_only_one_stretch_excites_spoils_no_score():
    """Joint 3 moves in the last fifth only: without it, its parameters are rounding's."""
    plan = trajectory_log(random_trajectory(ROBOT, 0, fill=True), 200.0)
    first = int(0.81 * plan.samples)
    still = {name: getattr(plan, name).clone() for name in ("q", "dq", "ddq")}
    still["q"][:first, 2] = still["q"][first, 2]
    still["dq"][:first, 2] = still["ddq"][:first, 2] = 0.0
    log = synthetic_log(ROBOT, plan.replace(**still), HonestNoise(encoder_step=0.0), 0)
    choice = choose_cutoff(training(log))
    assert max(choice.scores) < 20
    assert min(choice.scores) < 3


def lengths(log: Log) -> list[int]:
    return [part.samples for part in log.trajectories()]


@pytest.mark.parametrize(
    ("sizes", "longest", "expected"),
    [
        ((300, 300), 1000, [300, 300]),
        ((3000,), 1000, [1000]),
        ((990, 20), 1000, [990]),
        ((20, 5000), 1000, [20, 980]),
        ((500, 490, 20), 1000, [500, 490]),
        ((400,) * 10, 1000, [400, 400]),
    ],
)
def test_long_logs_are_shortened_by_whole_trajectories(monkeypatch, sizes, longest, expected):
    """A remnant too short for the filter must not silence every candidate."""
    monkeypatch.setattr(tuning, "LONGEST", longest)
    total = sum(sizes)
    t = torch.cat([torch.arange(float(s)) for s in sizes])
    index = torch.repeat_interleave(torch.arange(len(sizes)), torch.tensor(sizes))
    log = Log(t=t, q=torch.zeros(total, 1, dtype=torch.float64), trajectory=index)
    assert lengths(tuning.shortened(log)) == expected


@pytest.mark.slow
def test_a_shortened_log_still_gives_a_choice(monkeypatch):
    log = log_of(ROBOT, COARSE, count=3)
    whole = choose_cutoff(training(log))
    monkeypatch.setattr(tuning, "LONGEST", 4100)
    part = choose_cutoff(training(log))
    assert max(part.scores) < float("inf")
    ratio = part.cutoff / whole.cutoff
    assert 0.3 < ratio < 3.1
