"""How wide to randomise a simulator: what a randomisation holds, of torques or of servos."""

import json
import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.special import ndtri

from torchid.effects.base import Effect
from torchid.effects.friction import CoulombFriction, ViscousFriction
from torchid.effects.inertia import RotorInertia
from torchid.effects.registry import Valued
from torchid.effects.servo import NAMES
from torchid.effects.spring import JointSpring
from torchid.errors import TorchidError
from torchid.export.dynamics import records
from torchid.export.export import stem_of
from torchid.export.record import RandomisationRecord, RangeRow, ResidualBand
from torchid.export.write_randomised import isaaclab, mjlab, ranges_csv, servo_csv
from torchid.files import atomic_write, require_name
from torchid.results.record import Result
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import JointType, Robot
from torchid.simulation.servo import Servos
from torchid.typing import Float, Tensor

FIELDS: dict[str, tuple[type[Effect], int]] = {
    "damping": (ViscousFriction, 0),
    "friction": (CoulombFriction, 0),
    "armature": (RotorInertia, 0),
    "stiffness": (JointSpring, 0),
    "offset": (JointSpring, 1),
}
"""What files say of a joint, and the coefficient whose unit it has (see `Effect.attributes`)."""


@dataclass(frozen=True, eq=False)
class Draws:
    """D draws of a robot.

    Attributes:
        pi: (D, n, 10) bodies, all of them feasible.
        effects: per draw, with coefficients drawn and physical signs.
        nearest: how many draws belong to no body and have the nearest one; then none is drawn anew.
        anew: share of the points that no body has, and that were drawn anew.
    """

    pi: Float[Tensor, "D n 10"]
    effects: tuple[tuple[Valued, ...], ...]
    nearest: int
    anew: float


@dataclass(frozen=True, eq=False)
class Randomisation(Result):
    """How wide to randomise.

    Attributes:
        name: of the robot.
        level: share of what is drawn that lies in a range.
        draws: of the robot's bodies and effects; of positions its servos (D, n, K), whose plane is
            that of the answer.
        ranges: per field of a joint or a link, and per coefficient without a field, of which the
            draws differ.
        robot: the centre: the diagnosed robot with bodies; of positions the robot that was given.
        joint_names: of the robot, or numbers.
        residual: torque that stays unexplained, joint by joint.
        warnings: sentences for the user.
    """

    name: str
    level: float
    draws: Draws | Servos
    ranges: tuple[RangeRow, ...]
    robot: Robot | None
    joint_names: tuple[str, ...]
    residual: tuple[ResidualBand, ...] = ()
    warnings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"Randomisation('{self.name}', {len(self)} draws, {len(self.ranges)} ranges)"

    def __len__(self) -> int:
        drawn = self.draws
        return len(drawn.joint if isinstance(drawn, Servos) else drawn.pi)

    @cached_property
    def record(self) -> RandomisationRecord:
        """As the JSON has it."""
        return RandomisationRecord.of(self, robot=self.name, draws=len(self))

    def write(self, folder: Path | str, name: str | None = None) -> list[Path]:
        """Write NAME_ranges.csv, NAME_draws.npz, NAME_mjlab.py and NAME_isaaclab.py; of servos
        NAME_ranges.csv and NAME_servo_draws.npz, for `torchid.simulators.servo.drawn_servos`.

        Args:
            folder: made if need be.
            name: without suffix; the robot's own by default.

        Returns:
            The files.

        Raises:
            TorchidError: a name with a folder in it, or a file that cannot be written.
        """
        servos, robot = self.draws, self.robot
        given = self.name if robot is None or isinstance(servos, Servos) else stem_of(robot)
        stem = given if name is None else name
        require_name(stem)
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        if isinstance(servos, Servos):
            arrays: dict[str, Any] = {
                "joint_names": np.array(self.joint_names),
                "parameters": np.array(NAMES),
                "values": servos.joint.numpy(),
            }
            draws, texts = "servo_draws.npz", {"ranges.csv": servo_csv(self.record)}
        else:
            robots = [json.dumps([dict(r) for r in self.one(k).effects]) for k in range(len(self))]
            arrays = {**_plain_draws(self), "effects": np.array(robots)}
            draws, texts = (
                "draws.npz",
                {
                    "ranges.csv": ranges_csv(self.record, self.joint_names),
                    "mjlab.py": mjlab(self.record, stem, self.joint_names),
                    "isaaclab.py": isaaclab(self.record, stem, self.joint_names),
                },
            )
        files = [folder / f"{stem}_{ending}" for ending in (draws, *texts)]
        with atomic_write(files[0], "wb") as stream:
            np.savez_compressed(stream, **arrays)
        for file, text in zip(files[1:], texts.values(), strict=True):
            with atomic_write(file) as stream:
                stream.write(text)
        return files[::-1] if isinstance(servos, Servos) else files

    def one(self, k: int) -> Robot:
        """The robot of a draw, with its effects.

        Raises:
            TorchidError: draws of servos.
        """
        if self.robot is None or isinstance(self.draws, Servos):
            raise TorchidError("these are draws of servos.", hint="`draws.joint[k]`")
        robot = self.robot.with_parameters(InertialParameters(self.draws.pi[k]))
        return replace(robot, effects=records(self.draws.effects[k]))


def range_row(
    field: str, name: str, unit: str, drawn: Tensor, level: float, centre: float, why: str
) -> RangeRow:
    """The range that holds a share of draws (D,)."""
    tail = torch.tensor([(1 - level) / 2, (1 + level) / 2], dtype=torch.float64)
    low, high = drawn.quantile(tail).tolist()
    return RangeRow(field=field, name=name, unit=unit, low=low, high=high, centre=centre, why=why)


def sobol_points(count: int, width: int, seed: int) -> np.ndarray:
    """Points (count, width) that fill the unit cube evenly."""
    from scipy.stats import qmc

    sobol = qmc.Sobol(width, rng=np.random.default_rng(seed))
    return np.asarray(sobol.random_base2(math.ceil(math.log2(count)))[:count])


def normal_points(points: np.ndarray) -> Tensor:
    """The same of independent standard normal numbers."""
    return torch.from_numpy(ndtri(points.clip(1e-12, 1 - 1e-12)))


def drawn_values(
    every: Draws, centre: Robot
) -> tuple[dict[str, Float[Tensor, "D n"]], list[tuple[str, str, Float[Tensor, " D"]]]]:
    """Fields of joints (D, n), and coefficients without a field: name, unit, (D,)."""
    count, n = len(every.pi), centre.n
    fields = {name: torch.zeros(count, n, dtype=torch.float64) for name in FIELDS}
    beside: dict[str, tuple[str, Tensor]] = {}
    for d, pairs in enumerate(every.effects):
        for effect, values in pairs:
            added = effect.attributes(values)
            if added is not None:
                for key, value in added.items():
                    fields[key][d, effect.joints[0]] += value
                continue
            sliding = all(centre.joint_types[j] is JointType.PRISMATIC for j in effect.joints)
            prismatic = bool(effect.joints) and sliding
            for c, name, value in zip(
                effect.coefficients, effect.coefficient_names(), values, strict=True
            ):
                full = f"{effect.name} {name}"
                unit = c.unit_for(prismatic)
                beside.setdefault(full, (unit, torch.zeros(count, dtype=torch.float64)))
                beside[full][1][d] += value
    return fields, [(name, unit, x) for name, (unit, x) in beside.items()]


def _plain_draws(done: Randomisation) -> dict[str, Any]:
    """The arrays of draws.npz; see `Randomisation.write`."""
    drawn, robot = done.draws, done.robot
    assert isinstance(drawn, Draws)
    assert robot is not None
    bodies = InertialParameters(drawn.pi)
    fields, beside = drawn_values(drawn, robot)
    return {
        "joint_names": np.array(robot.joint_names),
        "link_names": np.array(robot.link_names),
        "mass": bodies.mass.numpy(),
        "com": bodies.com.numpy(),
        "inertia_about_com": bodies.inertia_about_com.numpy(),
        **{name: x.numpy() for name, x in fields.items()},
        "coefficient_names": np.array([name for name, _, _ in beside], dtype=str),
        "coefficients": np.stack([x.numpy() for *_, x in beside], 1)
        if beside
        else np.zeros((len(done), 0)),
        "residual": np.array([[band.low, band.high] for band in done.residual]),
        "residual_unexplained_rms": np.array([band.unexplained for band in done.residual]),
        "residual_correlation_s": np.array([band.correlation for band in done.residual]),
    }
