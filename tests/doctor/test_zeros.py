"""Zeros, whole turns, counts and the units of servos."""

import math
from dataclasses import replace
from unittest.mock import patch

import pytest
import torch

from tests.doctor.synthetic import clean
from torchid.doctor.examine import examine, signal_checks
from torchid.doctor.flag import columns_option
from torchid.doctor.hypothesis import Hypothesis, Judge
from torchid.doctor.moves import Move
from torchid.doctor.repair import Map, shifted
from torchid.doctor.samples import samples
from torchid.doctor.search import FoundFault, Search, rms, search
from torchid.log.checks import check_log
from torchid.log.readers import read_log, write_log

RPM = 2 * math.pi / 60
REGISTERS = {
    "Dynamixel X": (4096, 0.229 * RPM),
    "Dynamixel MX": (4096, 0.114 * RPM),
    "Dynamixel AX": (1228.8, 0.111 * RPM),
    "Feetech STS": (4096, 2 * math.pi / 4096),
}


def in_counts(log, counts, speed, zero):
    q = (log.q * counts / (2 * math.pi) + zero).round()
    return log.replace(q=q, dq=(log.dq / speed).round(), ddq=None)


@pytest.mark.parametrize("servo", REGISTERS)
def test_counts_and_speeds_of_servos_are_told_together(servo):
    robot, log = clean("panda", 0)
    counts, speed = REGISTERS[servo]
    # The middle of the turn is zero.
    zero = 2048 if counts == 4096 else 512
    # Where both middles keep within the limits, one is chosen (by torque, in an examination).
    name = "zero at half a turn" if counts == 4096 else "zero at 150 degrees"
    checks, mended = signal_checks(robot, in_counts(log, counts, speed, zero), [name])
    wrong = {c.name: c for c in checks if c.verdict == "wrong"}
    assert wrong.keys() == {"position unit", "zero of positions"}
    assert servo in wrong["position unit"].evidence
    assert torch.equal(mended.t, log.t)
    assert float((mended.q - log.q).abs().max()) < 4 / counts
    assert float((mended.dq - log.dq).abs().max()) < speed


@pytest.mark.parametrize("zero", [math.pi, math.radians(150)])
def test_torque_tells_the_zero_that_limits_do_not(zero):
    robot, log = clean("panda", 0)
    result = examine(robot, log.replace(q=log.q + zero), first=True)
    assert result.undecided == ()
    assert float((result.mended().q - log.q).abs().max()) < 1e-9


def test_counts_of_unknown_size_say_nothing_of_the_clock():
    robot, log = clean("panda", 0)
    odd = in_counts(log, 5000, 0.01234, 0)
    checks, mended = signal_checks(robot, odd)
    (unit,) = [c for c in checks if c.name == "position unit"]
    assert "rev/COUNTS" in unit.fix
    assert torch.equal(mended.t, log.t)
    assert torch.equal(mended.dq, odd.dq)


@pytest.mark.parametrize("unit", [1.0, 180 / math.pi], ids=["rad", "deg"])
def test_wrapped_angles_come_back_within_the_limits(unit, tmp_path):
    robot, log = clean("panda", 0)
    q = log.q.clone()
    q[:, [0, 2]] = torch.remainder(q[:, [0, 2]], 2 * math.pi)
    wrapped = log.replace(q=q * unit, dq=log.dq * unit, ddq=None)
    _, mended = signal_checks(robot, wrapped)
    assert float((mended.q - log.q).abs().max()) < 1e-9
    assert float((mended.dq - log.dq).abs().max()) < 1e-9
    check_log(mended, n=robot.n, robot_name=robot.name, position_limits=robot.limits.position)


def test_the_option_says_the_zero_of_counts(tmp_path):
    robot, log = clean("panda", 0)
    raw = in_counts(log, 4096, 0.229 * RPM, 2048)
    checks, mended = signal_checks(robot, raw)
    repairs = [r for c in checks for r in c.repairs]
    write_log(raw, tmp_path / "raw.parquet")
    names = {f"{key}{k + 1}" for key in ("q", "dq", "tau") for k in range(robot.n)}
    flag = columns_option(repairs, robot.n, names)
    assert " -2048" in flag
    read = read_log(tmp_path / "raw.parquet", columns=flag)
    torch.testing.assert_close(read.q, mended.q)
    torch.testing.assert_close(read.dq, mended.dq)


def test_a_position_a_little_beyond_its_limit_is_no_fault():
    robot, log = clean("panda", 0)
    limits = robot.limits.position
    q = log.q.clone()
    q[:, 3] += float(limits[3, 1] - q[:, 3].max()) + 0.1
    checks, _ = signal_checks(robot, log.replace(q=q))
    assert all(c.verdict == "fine" for c in checks if c.name == "zero of positions")


def test_angles_of_motors_are_not_degrees_where_those_leave_the_limits():
    robot, log = clean("panda", 0)
    gears = torch.tensor([100.0, -100, 100, 100, -50, 50, 50], dtype=torch.float64)
    motors = log.replace(q=gears * (log.q + 0.4), dq=gears * log.dq, ddq=None, tau=log.tau / gears)
    checks, mended = signal_checks(robot, motors)
    (unit,) = [c for c in checks if c.name == "position unit"]
    assert unit.verdict == "wrong"
    assert "as degrees leave the limits" in unit.evidence
    assert "GEAR" in unit.fix
    assert unit.repairs == ()
    assert torch.equal(mended.q, motors.q)
    # Where velocities say degrees, they are, limits or not.
    away = log.replace(q=180 / math.pi * (log.q + 1.5), ddq=None)
    (unit,) = [c for c in signal_checks(robot, away)[0] if c.name == "position unit"]
    assert unit.repairs


def test_limits_wider_than_two_turns_count():
    robot, log = clean("panda", 0)
    limits = robot.limits.position.clone()
    limits[0] = torch.tensor([-100.0, 100.0])
    wide = replace(robot, limits=replace(robot.limits, position=limits))
    q = log.q.clone()
    q[:, 0] += 28.0
    checks, mended = signal_checks(wide, log.replace(q=q))
    assert {c.name for c in checks if c.verdict in ("wrong", "doubtful")} == set()
    assert torch.equal(mended.q, q)


@pytest.mark.parametrize("spring", [True, False])
def test_a_zero_that_a_spring_explains_as_well_is_none(spring):
    """A cable bends on joint 7, or joint 4 has another zero: a search has ended with a zero, which
    leaves a tenth of the error."""
    robot, log = clean("panda", 0)
    joint, angle = (5, 0.0) if spring else (3, math.pi / 2)
    held, offsets = torch.zeros_like(log.q), [angle * (k == joint) for k in range(robot.n)]
    held[:, 6] = 5.0 * log.q[:, 6] * spring
    rows = samples(shifted(("q",), offsets).apply(log.replace(tau=log.tau + held)))
    judge, start = Judge(robot, rows), Hypothesis.literal(robot)
    turned = Map.of(robot.n, offsets=[-math.pi / 2 * (k == joint) for k in range(robot.n)])
    move, before = Move("zero", (joint,), start, turned), judge.held_out(start)
    zero = FoundFault(move, rms(before), rms(0.1 * before), 9.0, (8, 8), ())
    ended, plain = (
        Search(found, judge.score(start), share * before, ())
        for found, share in (((zero,), 0.1), ((), 1.0))
    )
    with patch("torchid.doctor.search._greedy", side_effect=[ended, plain]):
        assert search(judge, start) is (plain if spring else ended)
