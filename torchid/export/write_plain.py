"""Exports without XML: the project's yaml, and C."""

from dataclasses import replace
from pathlib import Path

from torchid import __version__
from torchid.effects.base import Motion
from torchid.effects.registry import nominal_effects
from torchid.export.c_code import c_file
from torchid.export.checks import (
    Comparison,
    Draft,
    check_c,
    compared,
    require_agreement,
    staged_files,
)
from torchid.export.dynamics import Dynamics, records, robot_torque
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.robot.writer import robot_yaml

Written = tuple[Draft, tuple[Comparison, ...]]
READER = f"torchid {__version__}"


def read_back(
    dynamics: Dynamics, file: Path, motion: Motion, what: str = "torque with all effects"
) -> tuple[Comparison, ...]:
    """A robot's yaml against the result's own model.

    Raises:
        TorchidError: its torque is another one.
    """
    torque = robot_torque(load_robot(file), motion)
    return require_agreement([compared(READER, what, motion, dynamics.torque(motion), torque)])


def write_yaml(dynamics: Dynamics, written: Robot, path: Path, motion: Motion) -> Written:
    """The robot's yaml, with its effects; read back and compared."""
    draft = Draft({path.name: robot_yaml(written).encode()}, tuple(nominal_effects(written)))
    with staged_files(path.parent, draft.files) as files:
        return draft, read_back(dynamics, files[path.name], motion)


def write_c(dynamics: Dynamics, path: Path, motion: Motion) -> Written:
    """C source and header; compiled, run and compared, without the effects left out."""
    robot = dynamics.robot
    code = c_file(dynamics, path.stem)
    rest = tuple(pair for pair in nominal_effects(robot) if pair not in code.left_out)
    files = {path.name: code.source.encode(), f"{path.stem}.h": code.header.encode()}
    expected = robot_torque(replace(robot, effects=records(rest)), motion)
    with staged_files(path.parent, files):
        found = require_agreement([check_c(code, path.stem, motion, expected)])
    return Draft(files, in_file=rest, left_out=code.left_out), found
