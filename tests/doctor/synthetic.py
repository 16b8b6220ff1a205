"""Clean logs of arms that are not quite as described, and faults to plant in them."""

import dataclasses

import torch
import yaml

from torchid.doctor.examine import examine
from torchid.doctor.kind import holds_no_gravity
from torchid_bench.benchmarks import log_faults
from torchid_bench.benchmarks.log_clean import clean

__all__ = ["clean", "log_faults", "mounted", "settled"]


def settled(result):
    """The examination once every choice has been made for the first that is offered."""
    names = [c.choices[0].name for c in result.undecided]
    return examine(result.robot, result.log, names) if names else result


def mounted(result):
    """The examined robot with the gravity that the examination says."""
    robot = result.robot
    for check in result.checks:
        if check.name == "gravity" and check.verdict in ("wrong", "doubtful"):
            if holds_no_gravity(check):
                gravity = [0.0, 0.0, 0.0]
            else:
                gravity = yaml.safe_load(check.fix.partition(" in ")[0])["gravity"]
            robot = dataclasses.replace(robot, gravity=torch.tensor(gravity).double())
    return robot
