"""Exports without XML: the project's yaml, a table, C."""

from dataclasses import replace
from pathlib import Path

from torchid import __version__
from torchid.effects.base import Motion
from torchid.effects.registry import nominal_effects
from torchid.export.c_code import c_file
from torchid.export.checks import Comparison, check_c, compared
from torchid.export.draft import Draft, kept
from torchid.export.dynamics import Dynamics, described, records, robot_torque
from torchid.export.staging import staged
from torchid.export.tables import base_values, physical, read_values, table
from torchid.identification.validation import model_torque
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.robot.writer import robot_yaml

Written = tuple[Draft, tuple[Comparison, ...]]
READER = f"torchid {__version__}"


def write_yaml(dynamics: Dynamics, written: Robot, path: Path, motion: Motion) -> Written:
    """The robot's yaml, with its effects; read back and compared."""
    draft = Draft({path.name: robot_yaml(written).encode()}, tuple(nominal_effects(written)))
    with staged(path.parent, draft.files) as files:
        again = load_robot(files[path.name])
        found = compared(
            READER, "torque with all effects", motion, dynamics.torque(motion),
            robot_torque(again, motion),
        )  # fmt: skip
        return draft, kept([found])


def write_table(dynamics: Dynamics, path: Path, motion: Motion) -> Written:
    """A csv; its numbers are read back and compared."""
    effects = tuple(nominal_effects(dynamics.robot))
    draft = Draft({path.name: table(dynamics).encode()}, effects)
    with staged(path.parent, draft.files) as files:
        again = read_values(files[path.name].read_text(encoding="utf-8"))
        return draft, kept(_table_torque(dynamics, again, motion))


def _table_torque(dynamics: Dynamics, values: dict[str, float], motion: Motion) -> list[Comparison]:
    robot, expected = dynamics.robot, dynamics.torque(motion)
    if dynamics.base is not None:
        base, effects = dynamics.base.base, dynamics.base.effects
        read = base_values(values, base.names)
        torque = model_torque(robot, base, effects, read, motion)
        return [compared(READER, "torque of the base parameters", motion, expected, torque)]
    words = ("torque of m, m c, J (link frames)", "torque of m, c, I (centres of mass)")
    return [
        compared(READER, what, motion, expected, robot_torque(robot.with_parameters(p), motion))
        for what, p in zip(words, physical(values, robot.n), strict=True)
    ]


def write_c(dynamics: Dynamics, path: Path, motion: Motion) -> Written:
    """C source and header; compiled, run and compared, without the effects left out."""
    robot = dynamics.robot
    code = c_file(dynamics, path.stem)
    pairs = nominal_effects(robot)
    left = tuple(pair for pair in pairs if described(*pair, robot) in code.left_out)
    rest = tuple(pair for pair in pairs if pair not in left)
    files = {path.name: code.source.encode(), f"{path.stem}.h": code.header.encode()}
    expected = robot_torque(replace(robot, effects=records(rest)), motion)
    with staged(path.parent, files):
        found = kept([check_c(code, path.stem, motion, expected)])
    return Draft(files, in_file=rest, left_out=left), found
