import math
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchid.errors import LogError
from torchid.log.checks import check_log
from torchid.log.model import Log

from .examples import log_at, same, snapshot, uniform

DEGREES = 180 / math.pi


def check(log: Log, **changes: Any) -> tuple[str, ...]:
    return check_log(log, **({"n": 2, "robot_name": "arm"} | changes))


def changed(log: Log, name: str, row: int, joint: int, value: float) -> Log:
    signal = getattr(log, name).clone()
    signal[row, joint] = value
    return log.replace(**{name: signal})


def test_a_good_log_passes_unaltered() -> None:
    log = Log.concatenate([uniform(), uniform(samples=300)])
    before = snapshot(log)
    assert check(log) == ()
    assert check(log.replace(dq=None, ddq=None, tau=None, current=None)) == ()
    assert same(log, before)


def test_joint_count() -> None:
    with pytest.raises(LogError, match="robot 'arm'") as info:
        check(uniform(3))
    assert (info.value.got, info.value.expected) == ("3 (q1..q3)", "2 (q1..q2)")


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    ("name", "column"), [("q", "q2"), ("dq", "dq2"), ("tau", "tau2"), ("current", "i2")]
)
def test_not_finite(name: str, column: str, value: float) -> None:
    log = changed(changed(uniform(), name, 7, 1, value), name, 99, 1, math.nan)
    with pytest.raises(LogError, match=f"column {column} has 2 values .* row 8 of 'example'"):
        check(log)


def test_not_finite_in_the_second_trajectory_and_in_two_columns() -> None:
    log = Log.concatenate([uniform(), uniform(names=("second",))])
    log = changed(changed(log, "q", 501 + 3, 0, math.nan), "q", 501, 1, math.nan)
    with pytest.raises(LogError, match="row 4 of 'second', and 1 more columns"):
        check(log)
    t = uniform().t.clone()
    t[3] = math.nan
    with pytest.raises(LogError, match="column t has 1"):
        check(uniform(t=t))


def test_time_stands_still_or_goes_back() -> None:
    t = uniform().t.clone()
    t[10] = t[9]
    t[20] = t[19]
    t[30] = t[28]
    with pytest.raises(LogError, match="does not increase in row 11 of 'example'") as info:
        check(uniform(t=t))
    assert "2 repeated and 1 decreasing" in str(info.value)
    assert "0.09 s, then 0.09 s" in str(info.value)


def test_time_may_restart_in_a_trajectory() -> None:
    log = Log.concatenate([uniform(), uniform()])
    assert check(log) == ()
    with pytest.raises(LogError, match="does not increase in row 502"):
        check(log.replace(trajectory=torch.zeros(log.samples, dtype=torch.int64), names=("one",)))


def test_single_sample() -> None:
    with pytest.raises(LogError, match="one sample only"):
        check(uniform(samples=1))


def in_degrees(log: Log, *names: str) -> Log:
    return log.replace(**{name: getattr(log, name) * DEGREES for name in names})


LIMITS = torch.tensor([[-3.0, 3.0]] * 2, dtype=torch.float64)


def test_everything_in_degrees() -> None:
    with pytest.raises(LogError, match="q1 looks like degrees") as info:
        check(in_degrees(uniform(), "q", "dq", "ddq"), position_limits=LIMITS)
    assert "deg/s" in str(info.value)


def test_units_that_look_wrong_are_said_where_they_are_forced() -> None:
    for log in (
        in_degrees(uniform(), "q", "dq"),
        in_degrees(uniform(), "q"),
        uniform().replace(t=1000 * uniform().t),
    ):
        with pytest.raises(LogError) as info:
            check(log, position_limits=LIMITS)
        first, *_ = check(log, position_limits=LIMITS, force=True)
        assert first.startswith(info.value.problem)


def test_degrees_within_known_limits() -> None:
    small = uniform().replace(q=uniform().q * 0.15 * DEGREES, dq=None)  # up to 10 or so
    assert check(small) == ()
    limits = torch.tensor([[-2.9, 2.9], [-1.0, 1.0]], dtype=torch.float64)
    with pytest.raises(LogError, match="looks like degrees"):
        check(small, position_limits=limits)
    assert check(uniform(), position_limits=limits) == ()


@pytest.mark.parametrize("unknown", [math.nan, math.inf])
def test_joints_without_limits_turn_on(unknown: float) -> None:
    """Motors, and a joint that a file calls continuous: radians, which are said to be taken."""
    log = uniform(dq=None)
    wound = log.replace(q=log.q + torch.tensor([4000.0, 0.0], dtype=torch.float64))
    own = torch.tensor([[-unknown, unknown], [-2.0, 2.0]], dtype=torch.float64)
    for limits in (None, own):
        (said,) = check(wound, position_limits=limits)
        assert "q1 up to 4001, without limits: taken for radians" in said
    # Velocities tell degrees all the same.
    with pytest.raises(LogError, match="units of q1 look like degrees"):
        check(in_degrees(uniform(), "q"), position_limits=None)


def test_the_limits_of_the_file_count() -> None:
    log = uniform(dq=None)
    wound = log.replace(q=log.q + torch.tensor([90.0, 0.0], dtype=torch.float64))
    own = torch.tensor([[-100.0, 100.0], [-2.0, 2.0]], dtype=torch.float64)
    assert check(wound, position_limits=own) == ()
    with pytest.raises(LogError, match="q1 looks like degrees"):
        check(wound, position_limits=LIMITS)


def test_a_sliding_joint_has_no_degrees() -> None:
    log = uniform()
    log = log.replace(q=log.q * 5 / log.q.abs().amax(0))
    scaled = torch.tensor([1.0, DEGREES], dtype=torch.float64)
    with pytest.raises(LogError, match="q2 looks like degrees"):
        check(log.replace(q=log.q * scaled), prismatic=[True, False], position_limits=LIMITS)
    with pytest.raises(LogError, match="every measured velocity"):  # not degrees: the clock
        check(log.replace(dq=log.dq / 2), prismatic=[True, True])


def test_a_sliding_joint_in_millimetres() -> None:
    log = uniform()
    far = log.replace(q=log.q * 1000, dq=log.dq * 1000)
    with pytest.raises(LogError, match="q1 looks like millimetres"):
        check(far, prismatic=[True, True])
    limits = torch.tensor([[-2000.0, 2000.0]] * 2, dtype=torch.float64)
    check(far.replace(q=far.q / 20, dq=far.dq / 20), prismatic=[True, True], position_limits=limits)


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_velocity_in_degrees(noise: float) -> None:
    log = in_degrees(uniform(), "dq")
    log = log.replace(
        dq=log.dq + noise * torch.randn(501, 2, generator=torch.manual_seed(0), dtype=torch.float64)
    )
    with pytest.raises(LogError, match="units of dq1 look like degrees per second") as info:
        check(log)
    assert "57.3 times" in str(info.value)


def test_position_in_degrees_velocity_not() -> None:
    log = uniform()
    log = log.replace(q=0.1 * log.q * DEGREES, dq=0.1 * log.dq)
    with pytest.raises(LogError, match="units of q1 look like degrees"):
        check(log)


@pytest.mark.parametrize(
    ("factor", "unit"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")]
)
@pytest.mark.parametrize("step", [0.001, 0.01])
def test_time_unit(factor: float, unit: str, step: float) -> None:
    log = uniform(samples=round(5 / step), step=step)
    with pytest.raises(LogError, match=f"t looks like {unit}"):
        check(log.replace(t=log.t * factor))


def test_time_counted_in_samples_or_far_too_slow() -> None:
    log = uniform()
    with pytest.raises(LogError, match=r"does not look like seconds.*dq disagrees"):
        check(log.replace(t=torch.arange(501.0, dtype=torch.float64)))
    with pytest.raises(LogError, match=r"does not look like seconds.*too long"):
        check(log.replace(t=torch.arange(501.0, dtype=torch.float64), dq=None))


def test_slow_log_with_fitting_velocity_passes() -> None:
    t = 0.6 * np.arange(200)
    q, dq = np.sin(0.2 * t), 0.2 * np.cos(0.2 * t)
    slow = Log(torch.from_numpy(t), torch.from_numpy(q[:, None]), torch.from_numpy(dq[:, None]))
    assert check(slow, n=1) == ()


@pytest.mark.parametrize("factor", [20.0, 0.05])
def test_velocity_off_by_another_factor(factor: float) -> None:
    """On all joints it is the clock; on one it may be that joint's sensor."""
    log = uniform()
    with pytest.raises(LogError, match=f"every measured velocity is {factor:.3g} times"):
        check(log.replace(dq=log.dq * factor))
    (warning,) = check(log.replace(dq=log.dq * torch.tensor([1.0, factor], dtype=torch.float64)))
    assert f"dq2 is {factor:.3g} times" in warning


def test_unrelated_and_opposite_velocity() -> None:
    log = uniform()
    noise = torch.randn(501, 2, generator=torch.manual_seed(0), dtype=torch.float64)
    assert "not the derivative of q" in check(log.replace(dq=noise))[0]
    with pytest.raises(LogError, match="dq1 has the opposite sign"):
        check(log.replace(dq=-log.dq))


def test_still_joint() -> None:
    q = uniform().q.clone()
    q[:, 1] = 0.5
    (warning,) = check(uniform(q=q, dq=None))
    assert warning.startswith("joint 2 never moves")


@pytest.mark.parametrize(("name", "column"), [("tau", "tau2"), ("current", "i2")])
def test_no_torque(name: str, column: str) -> None:
    log = uniform(**({} if name == "tau" else {"tau": None}))
    one = getattr(log, name).clone()
    one[:, 1] = 0.0
    (warning,) = check(log.replace(**{name: one}))
    assert f"{column} is zero" in warning
    with pytest.raises(LogError, match="all torques are zero"):
        check(log.replace(**{name: one * 0.0}))


def test_wrong_arguments() -> None:
    with pytest.raises(ValueError, match="prismatic"):
        check(uniform(), prismatic=[True])
    with pytest.raises(ValueError, match="position_limits"):
        check(uniform(), position_limits=torch.zeros(3, 2, dtype=torch.float64))


@given(
    seed=st.integers(0, 10_000),
    step=st.floats(0.001, 0.05),
    q_noise=st.floats(0, 1e-3),
    dq_noise=st.floats(0, 0.05),
)
def test_noise_and_jitter_never_misfire(
    seed: int, step: float, q_noise: float, dq_noise: float
) -> None:
    rng = np.random.default_rng(seed)
    t = np.cumsum(step * rng.uniform(0.2, 1.8, round(6 / step)))
    log = log_at(t[rng.random(len(t)) > 0.02])
    noise = torch.from_numpy(rng.normal(size=log.q.shape))
    assert check(log.replace(q=log.q + q_noise * noise, dq=log.dq + dq_noise * noise)) == ()
