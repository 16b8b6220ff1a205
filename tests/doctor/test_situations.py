"""What drivers, data sheets and forums say that logs are, and what the doctor says of each."""

import math

import pytest
import torch

from tests.doctor.synthetic import clean
from tests.doctor.test_kind import torques
from tests.marks import some
from torchid.doctor.examine import examine
from torchid.doctor.kind import holds_no_gravity
from torchid.errors import LogError
from torchid.log.checks import check_log

DEGREES = 180 / math.pi
TURN = 2 * math.pi
GAINS = torch.tensor([14.9, 13.3, 11.1, 10.6, 11.0, 11.5], dtype=torch.float64)
RATED = torch.tensor([40, 40, 30, 30, 10, 10, 5], dtype=torch.float64)


def arm(name="panda"):
    return clean(name, 0, nominal=True)


def changed(log, **signals):
    return log.replace(**signals)


def percent(robot, log):
    low, high = robot.limits.position.T
    return changed(log, q=200 * (log.q - low) / (high - low) - 100, dq=None)


def turned(log, angle):
    q = log.q.clone()
    q[:, 1] += angle
    return changed(log, q=q)


def sign_bit(x, bit):
    return torch.where(x < 0, bit - x, x)


def every_stamp_twice(log):
    t = log.t.clone()
    t[1::2] = t[0:-1:2]
    return changed(log, t=t)


# What is in the log: arm, change, the checks that are wrong or doubtful, and whether the copy that
# `mended` makes has the arm's own positions.
SITUATIONS = {
    "Kinova: 0 .. 360 degrees": ("panda", lambda r, x: changed(
        x, q=torch.remainder(x.q * DEGREES, 360), dq=x.dq * DEGREES),
        {"position jumps", "position unit", "zero of positions"}, True),
    "xArm: degrees, no velocity": ("panda", lambda r, x: changed(x, q=x.q * DEGREES, dq=None),
        {"position unit"}, True),
    "ODrive: turns, turns/s": ("panda", lambda r, x: changed(x, q=x.q / TURN, dq=x.dq / TURN),
        {"position unit, by torque"}, True),
    "Dynamixel X: counts, 0.229 rpm": ("panda", lambda r, x: changed(
        x, q=(x.q * 4096 / TURN + 2048).round(), dq=(x.dq / (0.229 * TURN / 60)).round()),
        {"position unit", "zero of positions"}, True),
    "Feetech STS: counts, counts/s": ("panda", lambda r, x: changed(
        x, q=(x.q * 4096 / TURN + 2048).round(), dq=(x.dq * 4096 / TURN).round()),
        {"position unit", "zero of positions"}, True),
    "RMD: 0.01 degrees, degrees/s": ("panda", lambda r, x: changed(
        x, q=(x.q * DEGREES * 100).round(), dq=(x.dq * DEGREES).round()), {"position unit"}, True),
    "a counter that runs the other way": ("panda", lambda r, x: changed(
        x, q=(2048 - x.q * 4096 / TURN).round(), dq=(-x.dq / (0.229 * TURN / 60)).round()),
        {"position unit", "zero of positions", "position sign"}, True),
    "CAN: int16 read as unsigned": ("panda", lambda r, x: changed(
        x, tau=torch.remainder((100 * x.tau).round(), 65536)),
        {"number format", "torque unit"}, True),
    "Feetech: bit 15 is the sign of a speed": ("panda", lambda r, x: changed(
        x, q=(x.q * 4096 / TURN + 2048).round(), dq=sign_bit((x.dq * 4096 / TURN).round(), 32768)),
        {"number format", "position unit", "zero of positions"}, True),
    "LeRobot: percent of the range": ("panda", percent, {"position unit"}, True),
    "packed 16 bit, unknown scale": ("panda", lambda r, x: changed(
        x, q=((x.q + 12.5) / 25 * 65535).round(), dq=((x.dq + 65) / 130 * 4095).round()),
        {"position unit"}, False),
    "a zero of another convention": ("panda", lambda r, x: turned(x, math.pi / 2),
        {"zero of positions"}, True),
    "int16 torque in mN m": ("panda", lambda r, x: changed(x, tau=(1000 * x.tau).round()),
        {"torque unit"}, True),
    "CiA 402: per mille of rated torque": ("panda", lambda r, x: changed(
        x, tau=(1000 * x.tau / RATED).round()), {"gain of a joint", "torque unit"}, True),
    "UR: actual currents": ("ur10e", lambda r, x: changed(x, tau=None, current=x.tau / GAINS),
        {"torque unit"}, True),
    "UR: currents named torque": ("ur10e", lambda r, x: changed(x, tau=x.tau / GAINS),
        {"torque unit"}, True),
    "KUKA FRI: torque of the other sign": ("kuka_lwr4", lambda r, x: changed(x, tau=-x.tau),
        {"torque sign"}, False),
    "RTDE: every stamp twice": ("panda", lambda r, x: every_stamp_twice(x), {"clock"}, True),
    "ROS 2: effort never written": ("panda", lambda r, x: changed(x, tau=0 * x.tau),
        {"torque columns"}, True),
}  # fmt: skip


@pytest.mark.parametrize("name", some(SITUATIONS, 2))
def test_a_situation_is_named_and_mended(name):
    arm_name, change, names, mends = SITUATIONS[name]
    robot, log = arm(arm_name)
    result = examine(robot, change(robot, log))
    said = {c.name for c in result.checks if c.verdict in ("wrong", "doubtful")}
    assert said == names
    mended = result.mended()
    if mends:
        own = log.q[: mended.samples]
        assert float((mended.q - own).abs().max()) < 0.02
        # Other commands read it.
        if mended.tau is not None and bool(mended.tau.any()):
            limits = robot.limits.position
            check_log(mended, n=robot.n, robot_name=robot.name, position_limits=limits)


@pytest.mark.slow
def test_positions_of_motors_before_their_gears():
    robot, log = arm()
    motors = changed(log, q=9.1 * log.q, dq=9.1 * log.dq, tau=log.tau / 9.1)
    result = examine(robot, motors)
    (unit,) = [c for c in result.checks if c.name == "position unit, by torque"]
    assert unit.estimate == pytest.approx(9.1, rel=0.01)
    assert "gears" in unit.evidence
    assert float((result.mended().q - log.q).abs().max()) < 0.03


@pytest.mark.slow
def test_torques_of_motors_before_their_gears_are_named_together():
    gears = torch.tensor([50, -100, 100, 50, 50, -30, 30], dtype=torch.float64)
    robot, log = arm()
    result = examine(robot, changed(log, tau=log.tau / gears))
    (unit,) = [c for c in result.checks if c.name == "torque unit"]
    assert "motors' torque before their gears, or currents" in unit.evidence
    factors = [float(x) for x in unit.fix.partition("*[")[2].partition("]")[0].split(",")]
    ratio = torch.tensor(factors, dtype=torch.float64) / gears
    # Masses are off by up to 40 %, and a joint's small gain is no fault.
    assert bool(((ratio > 0.4) & (ratio < 2.5)).all())


@pytest.mark.parametrize(
    ("name", "parts", "external"),
    [
        ("panda", (1.0, 1.0), True),  # Franka's tau_ext_hat_filtered
        pytest.param("panda", (1.0, 0.0), False, marks=pytest.mark.slow),  # Franka's tau_J_d
    ],
)
def test_torques_that_a_controller_gives(name, parts, external):
    robot, log = torques(name, gravity=parts[0], inertial=parts[1])
    wrong = [c for c in examine(robot, log, first=True).checks if c.verdict == "wrong"]
    assert [c.name == "torque kind" for c in wrong] == [external]
    assert [holds_no_gravity(c) for c in wrong] == [not external]


def test_efforts_that_are_no_numbers():
    robot, log = arm("3r")
    with pytest.raises(LogError, match="no row has a number in tau1"):
        examine(robot, changed(log, tau=log.tau * float("nan")))
