"""Laws that act beyond a limit show before a fit; what comes once, or is friction, is none."""

import pytest
import torch

from tests.doctor.synthetic import clean
from tests.marks import quick_first
from torchid.doctor.examine import examine
from torchid.robot.chain import tool_jacobian
from torchid.robot.model import tool_pose


def stop(robot, log):
    """On the second joint, stiffer with depth."""
    depth = (log.q[:, 1] - torch.quantile(log.q[:, 1], 0.85)).clamp(min=0)
    return torch.stack([depth + 3 * depth**2 if j == 1 else 0 * depth for j in range(log.n)], -1)


def knee(robot, log):
    """Of the second joint, bent softly."""
    tau = log.tau[:, 1]
    limit = 0.6 * torch.quantile(tau.abs(), 0.99)
    excess = torch.nn.functional.softplus((tau.abs() - limit) / (0.1 * limit)) * tau.sign()
    return torch.stack([excess if j == 1 else 0 * excess for j in range(log.n)], -1)


def table(robot, log):
    """Below the tool, with the force of a sphere in contact (Hertz)."""
    height = tool_pose(robot, log.q)[:, 2, 3]
    depth = (torch.quantile(height, 0.15) - height).clamp(min=0)
    return -tool_jacobian(robot, log.q)[:, 2] * depth[:, None] ** 1.5


def planted(robot, log, law, share):
    torque = law(robot, log)
    worst = torque.square().mean(0).sqrt() / log.tau.std(0)
    return log.replace(tau=log.tau + share / worst.max() * torque)


def found(robot, log):
    return [c for c in examine(robot, log).checks if c.name == "limits"]


@pytest.mark.parametrize("law", quick_first([stop, knee, table], 1), ids=lambda law: law.__name__)
@pytest.mark.parametrize("name", ["3r", pytest.param("ur10e", marks=pytest.mark.nightly)])
def test_a_law_beyond_a_limit_is_found_at_its_place(name, law):
    robot, log = clean(name, 2, duration=40.0)
    (check,) = found(robot, planted(robot, log, law, 0.3))
    words = {stop: "as at a stop", knee: "as if the drive saturated", table: "as at a plane"}
    assert words[law] in check.evidence
    assert check.verdict == "doubtful"
    if law is not table:
        assert 1 in check.joints
    assert check.fix is not None
    assert not check.repairs


@pytest.mark.slow
def test_what_comes_once_is_no_law():
    robot, log = clean("3r", 2, duration=40.0)
    torque = torch.zeros_like(log.tau)
    torque[1000:1150] = 0.5 * log.tau.std(0)
    assert not found(robot, log.replace(tau=log.tau + torque))


@pytest.mark.nightly
def test_friction_that_grows_with_load_is_no_knee():
    robot, log = clean("ur10e", 2, duration=40.0)
    load = 0.3 * log.tau[:, 1].abs() * log.dq[:, 1].sign()
    torque = torch.stack([load if j == 1 else 0 * load for j in range(log.n)], -1)
    assert not found(robot, log.replace(tau=log.tau + torque))


@pytest.mark.slow
@pytest.mark.parametrize("gears", [False, True], ids=["plain", "gears"])
@pytest.mark.parametrize("name", ["3r", pytest.param("kuka_lwr4", marks=pytest.mark.nightly)])
def test_a_clean_log_has_none(name, gears):
    robot, log = clean(name, 1, gears=gears)
    assert not found(robot, log)
