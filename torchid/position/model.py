"""A robot with its servos, as one file too."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import yaml

from torchid.effects.servo import INDEX, NAMES
from torchid.errors import TorchidError
from torchid.files import atomic_write
from torchid.robot.library import as_robot
from torchid.robot.model import Robot, RobotLike
from torchid.robot.writer import robot_yaml
from torchid.robot.yaml_file import read_yaml
from torchid.robot.yaml_values import parsed_yaml
from torchid.simulation.servo import Servos
from torchid.tensors import as_tensor
from torchid.typing import Float, Tensor

KEY, RATIOS = "servos", "ratios_to_kp_alone"


@dataclass(frozen=True, eq=False)
class ServoArm:
    """A robot with its position servos: what moves when it is commanded.

    Attributes:
        robot: with inertial parameters.
        servos: one set.
        scale: (n,) radians (m) of the model per unit of the logs, 1 but where a log has a joint in
            another unit.
        std: (n, K) standard deviations of the servos' values, of logarithms where they are searched
            so; NaN of what is not known; None where nothing is.
        unanchored: joints (from 0) whose torques are right in their ratios to kp alone: neither a
            load nor a gain that is known tells their scale.

    >>> import torchid
    >>> arm = ServoArm.of(torchid.load_robot("3r"), kp=260.0, damping=22.0, armature=0.8)
    >>> arm.servos.of("kp").tolist()
    [260.0, 260.0, 260.0]
    """

    robot: Robot
    servos: Servos
    scale: Float[Tensor, " n"]
    std: Float[Tensor, "n K"] | None = None
    unanchored: tuple[int, ...] = ()

    def __repr__(self) -> str:
        return f"ServoArm('{self.robot.name}')"

    @classmethod
    def of(
        cls, robot: RobotLike, **values: float | Sequence[float] | np.ndarray | Tensor
    ) -> "ServoArm":
        """An arm with these servos.

        Args:
            robot: with inertial parameters.
            values: of `torchid.effects.servo.PARAMETERS` by name, as kp [N m/rad]: one of all
                joints, or n; those that are not given have no effect.

        Raises:
            TorchidError: no such parameter, or not a number for every joint.
        """
        robot = as_robot(robot)
        servos = Servos.neutral(robot.n)
        for name, value in values.items():
            if name not in NAMES:
                raise TorchidError("a servo has no such parameter.", got=name, available=NAMES)
            each = as_tensor(value, name)
            if each.shape not in ((), (robot.n,)) or bool(each.isnan().any()):
                raise TorchidError(
                    f"values of '{name}' do not fit the joints.",
                    got=value,
                    expected=f"a number, or {robot.n}",
                )
            servos.joint[:, INDEX[name]] = each
        return cls(robot, servos, torch.ones(robot.n, dtype=torch.float64))

    @classmethod
    def read(cls, path: str | Path) -> "ServoArm":
        """A robot's yaml with servos, as `write` and `torchid gap --save-model` make it.

        Raises:
            TorchidError: the file has no servos, or servos of another robot.
            RobotError: it is no robot's yaml.
        """
        path = Path(path)
        if path.suffix.lower() not in (".yaml", ".yml"):
            raise TorchidError(
                f"'{path}' has no servos.", expected="a .yaml that `torchid gap --save-model` wrote"
            )
        robot, data = read_yaml(path), parsed_yaml(path).get(KEY)
        if not isinstance(data, dict):
            raise TorchidError(
                f"'{path}' has no servos.",
                expected=f"a block `{KEY}`, as `torchid gap --save-model` writes it",
            )
        scale = data.get("log_scale", [1.0] * robot.n)
        servos, std = Servos.from_record(data, robot.n, str(path)), None
        if isinstance(data.get("std"), list) and len(data["std"]) == robot.n:
            rows = [[float(one.get(name, math.nan)) for name in NAMES] for one in data["std"]]
            std = torch.tensor(rows, dtype=torch.float64)
        if not isinstance(scale, list) or len(scale) != robot.n or not all(s > 0 for s in scale):
            raise TorchidError(
                f"'{path}': log_scale is wrong.", got=scale, expected=f"{robot.n} > 0"
            )
        free = data.get(RATIOS, [])
        if not isinstance(free, list) or not set(free) <= set(range(1, robot.n + 1)):
            raise TorchidError(f"'{path}': {RATIOS} is wrong.", got=free, expected="joints, from 1")
        scale = torch.tensor(scale, dtype=torch.float64)
        return cls(robot, servos, scale, std, tuple(j - 1 for j in free))

    @classmethod
    def of_file(cls, name: str | Path) -> "ServoArm | None":
        """The same of whatever names a robot; None where that has no servos of a fit."""
        path = Path(name)
        if path.suffix.lower() not in (".yaml", ".yml") or not path.is_file():
            return None
        data = parsed_yaml(path)
        fitted = isinstance(data, dict) and isinstance(data.get(KEY), dict)
        return cls.read(path) if fitted else None

    @property
    def yaml(self) -> str:
        """What `write` writes."""
        block = {**self.servos.record(), "log_scale": self.scale.tolist()}
        if self.unanchored:
            block[RATIOS] = [j + 1 for j in self.unanchored]
        if self.std is not None:
            rows = (zip(NAMES, row, strict=True) for row in self.std.tolist())
            block["std"] = [{k: v for k, v in row if math.isfinite(v)} for row in rows]
        return robot_yaml(self.robot) + yaml.safe_dump({KEY: block}, sort_keys=False, width=200)

    def write(self, path: str | Path) -> None:
        """The robot's yaml with its servos, whole or not at all.

        Args:
            path: the file, *.yaml.

        Raises:
            TorchidError: the file cannot be written.
        """
        with atomic_write(Path(path)) as file:
            file.write(self.yaml)
