"""What the doctor says about commands."""

import pytest
import torch

from torchid.doctor.case import Case
from torchid.doctor.examine import examine
from torchid.doctor.first import WrongLogError, ask_first
from torchid.doctor.flag import columns_option
from torchid.doctor.velocity import check_channel_units, check_command_unit, check_commands
from torchid.log.model import Log
from torchid.robot.library import load_robot

STEP = 0.02
NAMES = {f"{key}{k}" for key in ("q", "u") for k in (1, 2, 3)}


def late(samples: int, share: float = 1.0) -> Log:
    """Three joints that follow their commands so many samples late; the second by a share."""
    t = STEP * torch.arange(1500, dtype=torch.float64)
    rates = torch.tensor([0.9, 1.3, 1.7], dtype=torch.float64)
    u = 0.6 * (t[:, None] * rates).sin()
    q = 0.6 * ((t - samples * STEP)[:, None] * rates).sin()
    dq = 0.6 * rates * ((t - samples * STEP)[:, None] * rates).cos()
    return Log(t, q * torch.tensor([1.0, share, 1.0]).double(), dq=dq, u=u)


@pytest.mark.parametrize("samples", [0, 3, 10])
def test_the_lag_of_every_joint_is_told(samples):
    (check,) = check_commands(Case(load_robot("3r"), late(samples)))
    assert check.verdict == "fine"
    assert check.estimate == pytest.approx([samples * STEP] * 3, abs=1e-9)


def test_a_channel_in_another_unit_is_told():
    robot = load_robot("3r")
    case = Case(robot, late(2, share=0.4))
    (check,) = check_commands(case)
    assert check.verdict == "doubtful"
    assert "joint 2 makes 0.40" in check.evidence
    (units,) = check_channel_units(case)
    assert units.joints == (1,)
    assert units.estimate == pytest.approx([2.5], rel=0.01)
    (fine,) = check_channel_units(Case(robot, late(2)))
    assert fine.verdict == "fine"


def test_the_doctor_does_not_ask_a_log_of_commands_for_torque():
    found = examine(load_robot("3r"), late(2))
    by_name = {c.name: c for c in found.checks}
    assert by_name["torque columns"].verdict == "cannot tell"
    assert by_name["commands"].verdict == "fine"


COUNT = 2 * torch.pi / 4096
DEGREES = 180 / torch.pi


@pytest.mark.parametrize(
    ("u", "q", "words", "option"),
    [
        (DEGREES, 1, "commands look like degrees, q1.. like radians", "u=u{j} deg"),
        (1, DEGREES, "positions look like degrees, u1.. like radians", "q=q{j} deg"),
        (1e3, 1, "commands look like milliradians", "u=u{j} mrad"),
        (1 / COUNT, 1, "commands look like counts of an encoder, 4096 a turn", "u=u{j} *"),
    ],
)
def test_commands_in_another_unit_than_positions(u, q, words, option):
    robot, log = load_robot("3r"), late(2)
    other = log.replace(u=u * log.u, q=q * log.q, dq=None)
    found = examine(robot, other)
    (check,) = [c for c in found.checks if c.name == "command unit"]
    assert check.evidence.startswith(words)
    assert (columns_option(check.repairs, 3, NAMES) or "").startswith(option)
    mended = found.mended()
    torch.testing.assert_close(mended.u, log.u)
    torch.testing.assert_close(mended.q, log.q)
    with pytest.raises(WrongLogError, match="command unit"):
        ask_first(robot, other)


@pytest.mark.parametrize("factor", [0.5, 2.3])
def test_a_gain_is_no_unit(factor):
    """A servo that makes half of its command is a finding, not a fault of the log."""
    log = late(2)
    (check,) = check_command_unit(Case(load_robot("3r"), log.replace(u=factor * log.u)))
    assert check.verdict == "fine"
