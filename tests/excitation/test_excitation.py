import math
from dataclasses import replace

import pytest
import torch

from tests.excitation.usage import full_design, limit_usage
from tests.marks import quick_first, some
from torchid.effects.base import Motion
from torchid.effects.registry import on_every_joint
from torchid.errors import IdentificationError, RobotError, TorchidError
from torchid.excitation.design import (
    base_regressor,
    condition_number,
    row_weights,
)
from torchid.excitation.fourier import FourierTrajectory, sample_times
from torchid.excitation.limits import largest_scale, motion_limits
from torchid.excitation.trajectories import (
    paper_trajectories_3r,
    random_trajectory,
    sinusoid,
)
from torchid.identification.base_parameters import base_parameters
from torchid.robot.library import load_robot
from torchid.robot.model import Limits, Robot
from torchid.robot.yaml_file import from_mapping

# Columns a1..a5, b1..b5, q0; rows: joints of the first, the second, the third trajectory.
TABLE_5_1 = """
0.453 -0.194 0.465 -0.265 0.010 -0.209 -0.179 0.381 0.159 -0.251 0.199
0.402 0.182 0.061 -0.295 0.054 -0.254 -0.155 0.001 -0.085 0.244 0.390
-0.323 -0.450 0.118 0.313 -0.146 0.223 0.337 -0.459 0.276 -0.006 0.459
-0.047 0.242 -0.314 0.150 -0.116 -0.331 -0.417 -0.254 0.424 -0.279 0.069
0.361 -0.341 0.256 0.303 0.027 -0.085 0.214 0.119 0.446 -0.434 -0.031
0.351 0.246 -0.429 0.249 0.148 -0.049 -0.257 -0.068 -0.031 0.370 -0.488
0.318 0.364 -0.049 -0.122 0.098 0.376 0.082 -0.444 0.162 0.389 -0.258
0.236 -0.369 0.355 0.149 0.424 0.316 0.450 0.009 -0.400 -0.2802 -0.0960
0.354 -0.079 -0.353 -0.013 0.260 0.260 -0.402 0.010 0.130 0.110 -0.403
"""


def random_arm(seed: int = 3, kinds: str = "RRRRRR") -> Robot:
    """An arm with asymmetric limits that all contain 0, but for positions."""
    generator = torch.Generator().manual_seed(seed)
    draw = torch.rand((len(kinds), 10), generator=generator, dtype=torch.float64).tolist()
    joints = [
        {"type": kind, "a": 0.3 * u[0], "alpha": 3 * u[1] - 1.5, "d": 0.3 * u[2], "theta": u[3]}
        for kind, u in zip(kinds, draw, strict=True)
    ]
    limits = {
        "position": [[0.3 - 2 * u[4], 0.4 + 2 * u[5]] for u in draw],
        "velocity": [[-0.2 - u[6], 0.2 + u[7]] for u in draw],
        "acceleration": [[-0.5 - 3 * u[8], 0.5 + 3 * u[9]] for u in draw],
    }
    dh = {"convention": "modified", "joints": joints}
    return from_mapping({"name": "arm", "dh": dh, "limits": limits}, "arm")


def series(ramp: float = 1.0, seed: int = 0, batch: tuple[int, ...] = ()) -> FourierTrajectory:
    generator = torch.Generator().manual_seed(seed)
    a, b = (torch.randn((*batch, 3, 5), generator=generator, dtype=torch.float64) for _ in "ab")
    return FourierTrajectory(a, b, a[..., 0] - b[..., 1], ramp=ramp)


def inside(motion: Motion, limits: Limits) -> bool:
    """Without any tolerance."""
    pairs = zip(motion.state, (limits.position, limits.velocity, limits.acceleration), strict=True)
    return all(bool(((x >= b[:, 0]) & (x <= b[:, 1])).all()) for x, b in pairs)


# --- the series and its blends


def test_the_bare_series_is_eq_5_1():
    trajectory = series(ramp=0.0)
    t = torch.tensor([0.0, 1.7, 12.3], dtype=torch.float64)
    w = 0.15 * math.pi
    expected = trajectory.q0.repeat(3, 1)
    for k in range(5):
        lw = (k + 1) * w
        expected = expected + trajectory.a[:, k] / lw * torch.sin(lw * t)[:, None]
        expected = expected - trajectory.b[:, k] / lw * torch.cos(lw * t)[:, None]
    assert torch.allclose(trajectory.at(t).q, expected, atol=1e-13, rtol=0)


@pytest.mark.parametrize("ramp", [0.0, 1.0, 10.0])
def test_derivatives_agree_with_autograd(ramp):
    trajectory = series(ramp)
    t = torch.linspace(0.03, 19.98, 400, dtype=torch.float64).requires_grad_()
    motion = trajectory.at(t)
    for value, derivative in ((motion.q, motion.dq), (motion.dq, motion.ddq)):
        for j in range(3):
            (found,) = torch.autograd.grad(value[:, j].sum(), t, retain_graph=True)
            assert torch.allclose(found, derivative[:, j], atol=1e-11, rtol=0)


def test_it_starts_and_ends_at_rest():
    trajectory = series(batch=(2,))
    motion = trajectory.at(torch.tensor([0.0, 20.0, -1.0, 21.0], dtype=torch.float64))
    assert motion.dq.abs().max() == 0
    assert motion.ddq.abs().max() < 1e-12
    assert torch.equal(motion.q[:, 0], motion.q[:, 2])


def test_position_velocity_and_acceleration_are_continuous_at_the_blends():
    trajectory = series()
    for border in (1.0, 19.0):
        before, at, after = (
            torch.stack(trajectory.at(torch.tensor([border + d], dtype=torch.float64)).state)
            for d in (-1e-9, 0.0, 1e-9)
        )
        assert (before - at).abs().max() < 1e-6
        assert (after - at).abs().max() < 1e-6


def test_between_the_ramps_it_is_the_series():
    t = torch.linspace(1.0, 19.0, 50, dtype=torch.float64)
    for x, y in zip(series().at(t).state, series(ramp=0.0).at(t).state, strict=True):
        assert torch.equal(x, y)


def test_scaling_is_exact_also_in_the_blends():
    trajectory = series()
    factor = torch.tensor([0.5, 2.0, 0.1], dtype=torch.float64)
    once, scaled = trajectory.sample(100), trajectory.scaled(factor).sample(100)
    swing = (once.q - trajectory.q0) * factor
    assert torch.allclose(scaled.q - trajectory.q0, swing, atol=1e-13, rtol=0)
    assert torch.allclose(scaled.ddq, once.ddq * factor, atol=1e-13, rtol=0)


def test_any_leading_batch():
    trajectory = series(batch=(2, 4))
    motion = trajectory.sample(10)
    assert motion.q.shape == (2, 4, 201, 3)
    one = FourierTrajectory(trajectory.a[1, 2], trajectory.b[1, 2], trajectory.q0[1, 2])
    assert torch.allclose(motion.ddq[1, 2], one.sample(10).ddq, atol=1e-13, rtol=0)


def test_samples_reach_the_end():
    assert len(sample_times(20.0, 100.0)) == 2001
    assert float(sample_times(20.0, 100.0)[-1]) == 20.0
    assert len(sample_times(20.0, 1 / 0.034)) == 589


@pytest.mark.parametrize("ramp", quick_first([1.0, 0.0, 0.05, 10.0], 1))
def test_extremes_enclose_and_are_close(ramp):
    trajectory = series(ramp, batch=(20,))
    motion = trajectory.sample(10_000)
    for values, bounds in zip(motion.state, trajectory.extremes(), strict=True):
        lower, upper = values.amin(1), values.amax(1)
        assert (bounds[..., 0] <= lower).all()
        assert (bounds[..., 1] >= upper).all()
        size = values.abs().amax((0, 1))
        assert ((bounds[..., 1] - upper) / size).max() < 2e-3


# --- table 5.1


def test_table_5_1_as_printed():
    trajectories = paper_trajectories_3r()
    assert trajectories.a.shape == trajectories.b.shape == (3, 3, 5)
    printed = torch.tensor(
        [[float(x) for x in line.split()] for line in TABLE_5_1.strip().splitlines()],
        dtype=torch.float64,
    ).reshape(3, 3, 11)
    assert torch.equal(trajectories.a, printed[..., :5])
    assert torch.equal(trajectories.b, printed[..., 5:10])
    assert torch.equal(trajectories.q0, printed[..., 10])
    assert (trajectories.w_f, trajectories.duration) == (0.15 * math.pi, 20.0)
    assert len(trajectories.sample(100).t) == 2001


def test_table_5_1_keeps_the_limits_of_the_3r():
    robot = load_robot("3r")
    trajectories = paper_trajectories_3r()
    assert inside(trajectories.sample(1000), robot.limits)
    for one in (trajectories, replace(trajectories, ramp=0.0)):
        usage = limit_usage(one.extremes(), motion_limits(robot))
        assert float(usage.max()) == pytest.approx(0.9136, abs=1e-3)


# --- limits


@pytest.mark.parametrize(
    "robot", some([load_robot("3r"), load_robot("kuka_lwr4"), random_arm()], 1)
)
def test_random_trajectories_keep_the_limits_at_every_instant(robot):
    for seed in range(20):
        trajectory = random_trajectory(robot, seed, fill=seed % 2 == 0)
        assert inside(trajectory.sample(10_000), robot.limits)
        usage = limit_usage(trajectory.extremes(), motion_limits(robot))
        assert usage.max() <= 1.0
        if seed % 2 == 0:
            assert usage.amax(0).min() > 1 - 1e-6, "every joint touches one of its limits"


def test_random_trajectories_are_those_of_the_seed():
    robot = load_robot("3r")
    first, again, other = (random_trajectory(robot, seed) for seed in (4, 4, 5))
    assert torch.equal(first.a, again.a)
    assert not torch.equal(first.a, other.a)
    many = random_trajectory(robot, 4, count=3)
    assert many.q0.shape == (3, 3)
    assert first.a.abs().max() <= 0.5


def test_only_the_wanted_share_of_the_limits_is_used():
    robot = load_robot("kuka_lwr4")
    usage = limit_usage(
        random_trajectory(robot, 0, fill=True, usage=0.8).extremes(), motion_limits(robot)
    )
    assert 0.79 < float(usage.max()) <= 0.8


def test_a_joint_that_does_not_move_has_no_scale():
    robot = load_robot("3r")
    still = FourierTrajectory(
        *(torch.zeros((3, 5), dtype=torch.float64) for _ in "ab"),
        torch.zeros(3, dtype=torch.float64),
    )
    assert (largest_scale(still, motion_limits(robot)) > 1e11).all()


def test_a_prismatic_joint():
    robot = random_arm(5, "PRP")
    assert inside(random_trajectory(robot, 0, fill=True).sample(2000), robot.limits)
    designed = full_design(robot, seed=0, restarts=3, iterations=40)
    assert inside(designed.trajectory.sample(2000), robot.limits)
    assert designed.condition_after < designed.start_condition


def test_joints_that_turn_for_ever_stay_within_one_turn():
    robot = load_robot("3r")
    position = torch.tensor(
        [[-math.inf, math.inf], [-1.0, math.inf], [-1.0, 2.0]], dtype=torch.float64
    )
    free = replace(robot, limits=replace(robot.limits, position=position))
    limits = motion_limits(free)
    one_turn = [[-math.pi, math.pi], [-1.0, 2 * math.pi - 1.0], [-1.0, 2.0]]
    assert limits.position.tolist() == one_turn
    assert "joint 1, 2" in random_trajectory(free, 0).warnings[0]
    unknown = replace(robot, limits=replace(robot.limits, position=None))
    assert motion_limits(unknown).position.tolist() == [[-math.pi, math.pi]] * 3


def test_missing_limits_are_named():
    robot = load_robot("3r")
    with pytest.raises(RobotError, match="no finite acceleration limits, which excitation needs"):
        random_trajectory(replace(robot, limits=replace(robot.limits, acceleration=None)), 0)
    slide = random_arm(5, "PRP")
    with pytest.raises(RobotError, match="position limits, which excitation of a sliding joint"):
        sinusoid(replace(slide, limits=replace(slide.limits, position=None)), 0)
    pushed = torch.tensor([[0.1, 2.0]] * 3, dtype=torch.float64)
    with pytest.raises(RobotError, match="do not contain 0"):
        motion_limits(replace(robot, limits=replace(robot.limits, velocity=pushed)))
    with pytest.raises(RobotError, match="share of the limits"):
        random_trajectory(robot, 0, usage=1.5)


@pytest.mark.usefixtures("types_unchecked")
def test_wrong_arguments_are_named():
    robot = load_robot("3r")
    with pytest.raises(TorchidError, match="ramps at both ends do not fit"):
        random_trajectory(robot, 0, duration=1.0)
    with pytest.raises(TorchidError, match="sampling rate is too low"):
        paper_trajectories_3r().sample(0.0)
    with pytest.raises(TorchidError, match="unknown criterion"):
        full_design(robot, seed=0, criterion="a_optimal")
    with pytest.raises(TorchidError, match="at least one start"):
        full_design(robot, seed=0, restarts=0)


# --- sinusoids


@pytest.mark.parametrize("robot", [load_robot("3r"), load_robot("kuka_lwr4"), random_arm()])
def test_sinusoids_keep_the_limits(robot):
    for seed in range(20):
        motion = sinusoid(robot, seed)
        assert inside(motion.sample(1000), robot.limits)
        assert limit_usage(motion.extremes(), motion_limits(robot)).max() <= 1.0
        assert motion.sample(10).dq[0].abs().max() == 0


def test_a_sinusoid_is_eq_5_2():
    motion = sinusoid(load_robot("3r"), 1)
    t = torch.linspace(0, 10, 50, dtype=torch.float64).requires_grad_()
    found = motion.at(t)
    expected = motion.amplitude * torch.sin(2 * math.pi * t[:, None] / motion.period)
    assert torch.allclose(found.dq, expected, atol=1e-14, rtol=0)
    for j in range(3):
        (dq,) = torch.autograd.grad(found.q[:, j].sum(), t, retain_graph=True)
        (ddq,) = torch.autograd.grad(found.dq[:, j].sum(), t, retain_graph=True)
        assert torch.allclose(dq, found.dq[:, j], atol=1e-12, rtol=0)
        assert torch.allclose(ddq, found.ddq[:, j], atol=1e-12, rtol=0)


# --- design


@pytest.mark.nightly
@pytest.mark.parametrize("name", some(["3r", "kuka_lwr4"], 1))
def test_the_design_improves_the_condition_number(name):
    robot = load_robot(name)
    calls = []
    designed = full_design(
        robot, seed=0, restarts=4, iterations=60, progress=lambda k, n: calls.append((k, n))
    )
    assert designed.condition_after < designed.start_condition / 2
    assert designed.condition_after < min(designed.condition_before)
    assert calls == [(k, 60) for k in range(1, 61)]
    motion = designed.trajectory.sample(10_000)
    assert inside(motion, robot.limits)
    found = condition_number(robot, designed.base, motion)
    assert found == pytest.approx(designed.condition_after, rel=0.02)


@pytest.mark.nightly
def test_the_determinant_grows_too():
    robot = load_robot("3r")
    effects = on_every_joint(["viscous_friction", "coulomb_friction", "torque_offset"], 3)
    designed = full_design(robot, effects, seed=1, restarts=3, iterations=60, criterion="d_optimal")
    assert len(designed.base) == 24

    def log_volume(trajectory: FourierTrajectory) -> float:
        y = base_regressor(robot, designed.base, trajectory.sample(50), effects=effects)
        return float(torch.linalg.slogdet(y.T @ y)[1])

    starts = random_trajectory(robot, 1, count=3, fill=True)
    best = max(log_volume(starts.select(k)) for k in range(3))
    assert log_volume(designed.trajectory) > best + 5


def test_the_design_is_that_of_the_seed():
    robot = load_robot("3r")
    first, again, other = (
        full_design(robot, seed=seed, restarts=2, iterations=5) for seed in (0, 0, 1)
    )
    assert torch.equal(first.trajectory.a, again.trajectory.a)
    assert torch.equal(first.trajectory.q0, again.trajectory.q0)
    assert not torch.equal(first.trajectory.a, other.trajectory.a)


@pytest.mark.nightly
def test_a_design_is_for_the_condition_number_of_the_basis():
    robot = load_robot("ur10e")
    made = {
        basis: full_design(robot, seed=0, restarts=2, iterations=5, basis=basis)
        for basis in (None, "report", "conditioned")
    }
    assert [d.base.basis for d in made.values()] == ["conditioned", "report", "conditioned"]
    assert torch.equal(made[None].trajectory.a, made["conditioned"].trajectory.a)
    own, report = made[None], made["report"]
    motion = own.trajectory.sample(50.0)
    weights = row_weights(robot)
    assert own.condition_after == pytest.approx(condition_number(robot, own.base, motion, weights))
    assert own.condition_after < 0.2 * report.condition_after


def test_rows_are_weighted_by_torque_limits():
    robot = load_robot("3r")
    assert row_weights(robot) is None
    torque = torch.tensor([[-100.0, 50.0], [-50.0, 50.0], [-10.0, 10.0]], dtype=torch.float64)
    strong = replace(robot, limits=replace(robot.limits, torque=torque))
    assert row_weights(strong).tolist() == [1.0, 2.0, 10.0]
    base = base_parameters(robot)
    motion = random_trajectory(robot, 0).sample(20)
    plain = condition_number(robot, base, motion)
    assert condition_number(
        robot, base, motion, torch.full((3,), 7.0, dtype=torch.float64)
    ) == pytest.approx(plain)
    assert condition_number(robot, base, motion, row_weights(strong)) != pytest.approx(plain)


def test_the_condition_number_of_too_few_rows():
    robot = load_robot("3r")
    motion = Motion(*(torch.ones((2, 3), dtype=torch.float64) for _ in range(3)))
    with pytest.raises(IdentificationError, match="fewer torques than there are base parameters"):
        condition_number(robot, base_parameters(robot), motion)


# --- files
