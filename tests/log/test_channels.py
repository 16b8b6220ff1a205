"""What is seen of a channel at a look."""

import pytest
import torch

from torchid.log.channels import odd_channels
from torchid.log.model import Log

T = torch.arange(0, 10, 0.01, dtype=torch.float64)
Q = torch.stack([torch.sin(2 * T), torch.cos(3 * T)], 1)
TAU = torch.stack([3 * torch.cos(2 * T), -4 * torch.sin(3 * T) + 3], 1)


def log(tau=TAU, **more):
    return Log(T, Q, tau=tau, **more)


def test_a_plain_log_has_no_odd_channel():
    assert odd_channels(log(), torch.tensor([20.0, 20.0])) == []


@pytest.mark.parametrize(
    ("made", "joints", "said"),
    [
        (log(TAU.abs()), (0, 1), "sizes without a sign"),
        (log((100 * TAU).round()), (0, 1), "whole numbers"),
        (log(TAU * torch.tensor([1.0, 50.0])), (1,), "times the joint's limit"),
        (Log(T, Q, current=1e3 * TAU), (0, 1), "milliamperes"),
    ],
)
def test_what_no_sensor_gives_is_said(made, joints, said):
    (odd, *_) = [o for o in odd_channels(made, torch.tensor([20.0, 20.0])) if said in o.why]
    assert odd.joints == joints


def test_one_joint_may_hold_a_weight():
    tau = torch.stack([TAU[:, 0], TAU[:, 1] + 5], 1)
    assert odd_channels(log(tau)) == []


def test_two_runs_of_one_torque_are_copies():
    two = Log.concatenate([Log(T, Q, tau=TAU), Log(T, Q.flip(0), tau=TAU)])
    (odd,) = odd_channels(two)
    assert odd.joints == (0, 1)
    assert "the same values" in odd.why
    again = Log.concatenate([Log(T, Q, tau=TAU), Log(T, Q, tau=TAU)])
    assert odd_channels(again) == []
