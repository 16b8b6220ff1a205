"""Clean logs of arms that are not quite as described, and faults to plant in them."""

import dataclasses
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import torch
import yaml

from torchid.doctor.examine import examine
from torchid.doctor.kind import holds_no_gravity

_BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


def _loaded(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, _BENCHMARKS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


log_faults = _loaded("log_faults")
clean = _loaded("log_clean").clean


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
