"""Faults that need no dynamics to be seen: clock, units, velocities, torque by itself."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.doctor.synthetic import clean, log_faults
from torchid.doctor.examine import MODEL_CHECKS, examine, signal_checks
from torchid.doctor.first import WrongLogError, ask_first
from torchid.doctor.repair import repaired
from torchid.log.filtering import low_passed
from torchid.log.model import Log
from torchid.robot.model import JointType

SEEN = (
    "q in degrees", "q and dq in degrees", "q in encoder counts", "dq in deg/s", "dq in rpm",
    "dq of a joint negated", "dq of two joints exchanged", "dq 60 ms late",
    "dq low-passed, 60 ms", "t in ms", "t in us", "t in ns", "t 2.5 times too slow",
    "repeated stamps", "clock set back", "clock jumps ahead", "stamps rounded",
    "stamps late at random", "dropouts", "held samples", "NaN", "angle wrapped", "tau clipped",
    "tau in coarse steps", "tau of a joint zero", "a joint stands still",
)  # fmt: skip
NOT_MENDED = ("dropouts", "tau clipped", "tau in coarse steps", "tau of a joint zero",
              "a joint stands still")  # fmt: skip


def planted(fault, name, seed):
    robot, log = clean(name, seed)
    return log_faults.FAULTS[fault](robot, log, np.random.default_rng(seed))


@pytest.mark.parametrize("name", ["3r", "kuka_lwr4", "ur10e"])
@pytest.mark.parametrize("fault", SEEN)
def test_a_planted_fault_is_named_and_mended(fault, name):
    for seed in range(2):
        case = planted(fault, name, seed)
        checks, mended = signal_checks(case.robot, case.log)
        assert case.found(tuple(checks)), [c for c in checks if c.verdict != "fine"]
        others = {c.name for c in checks if c.verdict in ("wrong", "doubtful")} - set(case.names)
        assert others <= {"stamps"}
        if fault not in NOT_MENDED:
            again, _ = signal_checks(case.robot, mended)
            assert all(c.verdict == "fine" for c in again), [
                c for c in again if c.verdict != "fine"
            ]


@pytest.mark.parametrize("name", ["3r", "kuka_lwr4", "ur10e", "panda"])
def test_clean_logs_are_fine(name):
    for seed in range(5):
        checks, mended = signal_checks(*clean(name, seed))
        assert all(c.verdict == "fine" for c in checks), [c for c in checks if c.verdict != "fine"]
        assert torch.equal(mended.q, clean(name, seed)[1].q)


def test_torque_that_comes_at_a_lower_rate_is_not_clipped():
    robot, log = clean("3r", 0)
    assert log.tau is not None
    short = log.select(torch.arange(log.samples) < 400)
    slow = torch.arange(400) // 5 * 5
    checks, _ = signal_checks(robot, short.replace(tau=short.tau[slow]))
    assert {c.name for c in checks if c.verdict != "fine"} <= {"held samples"}


def test_gaps_are_counted():
    robot, log = clean("3r", 0)
    for count, text in ((1, "1 gap of more"), (2, "2 gaps of more")):
        keep = torch.ones(log.samples, dtype=torch.bool)
        for k in range(count):
            keep[200 * (k + 1) : 200 * (k + 1) + 5] = False
        checks, _ = signal_checks(robot, log.select(keep))
        (found,) = [c for c in checks if c.name == "dropouts"]
        assert found.evidence.startswith(text)


def test_the_log_that_was_given_stays_as_it_was():
    case = planted("q in degrees", "3r", 0)
    copies = {name: signal.clone() for name, signal in case.log.signals.items()}
    checks, _ = signal_checks(case.robot, case.log)
    repaired(case.log, [r for c in checks for r in c.repairs])
    assert all(torch.equal(case.log.signals[name], copy) for name, copy in copies.items())


def test_mended_positions_are_those_before_the_fault():
    robot, log = clean("3r", 1)
    case = planted("q and dq in degrees", "3r", 1)
    _, mended = signal_checks(robot, case.log)
    assert torch.allclose(mended.q, log.q)
    assert mended.dq is not None
    assert log.dq is not None
    assert torch.allclose(mended.dq, log.dq)


def test_without_velocities_units_are_told_from_ranges_and_steps():
    robot, log = clean("3r", 0)
    bare = log.replace(dq=None, t=log.t * 1e3, q=log.q * 180 / torch.pi)
    checks, mended = signal_checks(robot, bare)
    assert {c.name for c in checks if c.verdict == "wrong"} == {"time unit", "position unit"}
    assert torch.allclose(mended.q, log.q)
    assert torch.allclose(mended.t, log.t)


def test_two_faults_at_once():
    robot, log = clean("3r", 0)
    assert log.dq is not None
    both = log.replace(t=log.t * 1e6, dq=log.dq[:, [1, 0, 2]] * 30 / torch.pi * 1e-6)
    checks, mended = signal_checks(robot, both.replace(dq=both.dq * 1e6))
    assert {c.name for c in checks if c.verdict == "wrong"} >= {"velocity"}
    again, _ = signal_checks(robot, mended)
    assert all(c.verdict == "fine" for c in again)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("gears", [False, True])
def test_torque_clipped_at_slow_peaks_is_seen(seed, gears):
    robot, log = clean("3r", seed, gears=gears)
    for k in range(robot.n):
        case = log_faults.FAULTS["tau clipped"](robot, log, np.random.default_rng(k))
        checks, _ = signal_checks(case.robot, case.log)
        assert case.found(tuple(checks)), [c for c in checks if c.name == "saturation"]


def test_a_clock_that_starts_again_elsewhere_is_a_new_run():
    robot, first = clean("3r", 0)
    second = clean("3r", 1)[1]
    joined = Log.concatenate([first, second])
    log = joined.replace(trajectory=torch.zeros(joined.samples, dtype=torch.long), names=())
    checks, mended = signal_checks(robot, log)
    assert [c.name for c in checks if c.verdict != "fine"] == ["clock"]
    assert torch.equal(mended.t, log.t)
    assert torch.equal(mended.trajectory.diff(), joined.trajectory.diff())
    assert mended.dq is not None


def named(log):
    checks, _ = signal_checks(clean("3r", 0)[0], log)
    return {c.name: c for c in checks if c.verdict != "fine"}


def at(log, t):
    """The log at other times, on straight lines between its samples."""
    own = log.t.numpy()
    signals = {
        name: torch.from_numpy(np.stack([np.interp(t, own, x) for x in values.numpy().T], 1))
        for name, values in log.signals.items()
    }
    rows = torch.zeros(len(t), dtype=torch.int64)
    return log.replace(t=torch.from_numpy(t), trajectory=rows, **signals)


def test_torque_resampled_from_a_lower_rate_is_seen():
    _, log = clean("3r", 0)
    t = log.t.numpy()
    rate = (len(t) - 1) / (t[-1] - t[0])
    slow = at(log, np.arange(t[0], t[-1], 4.7 / rate))
    fast = at(slow, np.arange(slow.t[0], slow.t[-1], 1 / rate))
    assert "lower rate" in named(fast)["content"].evidence
    assert "content" not in named(log)


def test_torque_without_any_noise_was_filtered():
    _, log = clean("3r", 0)
    t = log.t.numpy()
    rate = (len(t) - 1) / (t[-1] - t[0])
    smooth = log.replace(tau=low_passed(log.tau.T, rate, 0.04 * rate).T)
    found = named(smooth)["content"]
    assert "not even noise" in found.evidence
    # Above the cut-off: a filter passes some of what is beyond.
    assert 0.04 * rate < found.estimate < 0.3 * rate


def test_steps_of_very_different_length_are_not_fine():
    _, log = clean("3r", 0)
    rng = np.random.default_rng(0)
    steps = rng.choice([0.02, 0.055], 600, p=[0.6, 0.4])
    t = log.t.numpy()[0] + np.cumsum(steps)
    t = t[t < log.t.numpy()[-1]]
    found = named(at(log, t))
    assert found["stamps"].verdict == "doubtful"
    assert found["stamps"].estimate > 2


@pytest.mark.parametrize("also_velocity", [False, True])
def test_millimetres_of_a_sliding_joint(also_velocity):
    robot, log = clean("3r", 0)
    assert log.dq is not None
    sliding = replace(robot, joint_types=(JointType.PRISMATIC, *robot.joint_types[1:]))
    scale = torch.tensor([1000.0, 1.0, 1.0], dtype=log.q.dtype)
    wrong = log.replace(q=log.q * scale, dq=log.dq * scale if also_velocity else log.dq)
    checks, mended = signal_checks(sliding, wrong)
    (found,) = [c for c in checks if c.verdict != "fine"]
    assert (found.name, found.joints) == ("position unit", (0,))
    assert "millimetres" in found.evidence
    assert torch.allclose(mended.q, log.q)
    assert mended.dq is not None
    assert torch.allclose(mended.dq, log.dq)


def test_a_dead_velocity_names_its_joint():
    robot, log = clean("3r", 0)
    dq = log.dq.clone()
    dq[:, 2] = 0.0
    checks, mended = signal_checks(robot, log.replace(dq=dq))
    (wrong,) = [c for c in checks if c.verdict != "fine"]
    assert (wrong.name, wrong.joints) == ("velocity", (2,))
    assert wrong.fix == "dq3 = the derivative of q3"
    assert torch.equal(mended.dq[:, :2], log.dq[:, :2])
    error = (mended.dq - log.dq)[1:-1, 2]
    assert float(error.std()) < 0.1 * float(log.dq[:, 2].std())


def test_a_run_without_a_joints_torque_contradicts_the_others():
    robot, log = clean("3r", 0)
    every = Log.concatenate([log, log])
    tau = every.tau.clone()
    tau[every.slices()[1], 1] = 1.7
    checks, _ = signal_checks(robot, every.replace(tau=tau))
    (wrong,) = [c for c in checks if c.verdict != "fine"]
    assert (wrong.name, wrong.joints) == ("runs", (1,))
    with pytest.raises(WrongLogError, match="contradicts the others"):
        ask_first(robot, every.replace(tau=tau))


@pytest.mark.parametrize("left", [0.0, 1e-308])
def test_what_a_driver_leaves_is_no_torque(left):
    robot, log = clean("3r", 0)
    empty = log.replace(tau=torch.full_like(log.tau, left) * torch.sign(log.tau))
    result = examine(robot, empty)
    (columns,) = [c for c in result.checks if c.name == "torque columns"]
    assert columns.verdict == "wrong"
    assert "tau=none" in columns.fix
    assert {c.verdict for c in result.checks if c.name in MODEL_CHECKS} == {"cannot tell"}


def test_currents_without_gains_ask_for_gains():
    robot, log = clean("ur10e", 1, nominal=True)
    gains = torch.tensor([14.9, 13.3, 11.1, 10.6, 11.0, 11.5], dtype=torch.float64)
    result = examine(robot, log.replace(tau=None, current=0.1 * log.tau / gains), first=True)
    (unit,) = [c for c in result.checks if c.name == "torque unit"]
    assert "--gain" in unit.fix
    assert "gravity" not in {c.name for c in result.checks if c.verdict == "wrong"}
    assert not {c.name for c in result.checks} & {"torque kind"}
    assert ask_first(robot, result.log).short == ""
