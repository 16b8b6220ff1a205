"""Exports without XML: the project's yaml, a table, C."""

from dataclasses import replace
from pathlib import Path

import torch

from torchid import __version__
from torchid.effects.base import Motion
from torchid.effects.registry import nominal_effects
from torchid.export.c_code import c_file
from torchid.export.checks import Comparison, check_c, compared
from torchid.export.dynamics import Dynamics, records, robot_torque
from torchid.export.keeping import Draft, kept, staged
from torchid.export.tables import physical, read_values, table
from torchid.identification.model import model_torque
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.robot.writer import robot_yaml

Written = tuple[Draft, tuple[Comparison, ...]]
READER = f"torchid {__version__}"


def write_yaml(dynamics: Dynamics, written: Robot, path: Path, motion: Motion) -> Written:
    """The robot's yaml, with its effects; read back and compared."""
    draft = Draft({path.name: robot_yaml(written).encode()}, tuple(nominal_effects(written)))
    with staged(path.parent, draft.files) as files:
        torque = robot_torque(load_robot(files[path.name]), motion)
        what = "torque with all effects"
        return draft, kept([compared(READER, what, motion, dynamics.torque(motion), torque)])


def write_table(dynamics: Dynamics, path: Path, motion: Motion) -> Written:
    """A csv; its numbers are read back and compared."""
    robot, base = dynamics.robot, dynamics.base
    draft = Draft({path.name: table(dynamics).encode()}, tuple(nominal_effects(robot)))
    with staged(path.parent, draft.files) as files:
        values = read_values(files[path.name].read_text(encoding="utf-8"))
        if base is not None:
            read = torch.tensor([values[name] for name in base.base.names], dtype=torch.float64)
            torque = model_torque(robot, base.base, base.effects, read, motion)
            found = {"torque of the base parameters": torque}
        else:
            words = ("torque of m, m c, J (link frames)", "torque of m, c, I (centres of mass)")
            found = {
                what: robot_torque(robot.with_parameters(p), motion)
                for what, p in zip(words, physical(values, robot.n_links), strict=True)
            }
        expected = dynamics.torque(motion)
        return draft, kept(
            [compared(READER, what, motion, expected, torque) for what, torque in found.items()]
        )


def write_c(dynamics: Dynamics, path: Path, motion: Motion) -> Written:
    """C source and header; compiled, run and compared, without the effects left out."""
    robot = dynamics.robot
    code = c_file(dynamics, path.stem)
    rest = tuple(pair for pair in nominal_effects(robot) if pair not in code.left_out)
    files = {path.name: code.source.encode(), f"{path.stem}.h": code.header.encode()}
    expected = robot_torque(replace(robot, effects=records(rest)), motion)
    with staged(path.parent, files):
        found = kept([check_c(code, path.stem, motion, expected)])
    return Draft(files, in_file=rest, left_out=code.left_out), found
