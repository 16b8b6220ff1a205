"""A corrected file of a simulator, and what it is worth on a log, of torques or of positions."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from torchid.export.dynamics import Dynamics
from torchid.export.export import Export, Format, export_dynamics, stem_of
from torchid.export.projection import Projection, Target
from torchid.export.record import (
    BodiesRecord,
    CorrectionRecord,
    Errors,
    Forward,
    JudgedRecord,
    UnsaidRow,
)
from torchid.export.write_actuator import Package
from torchid.gap.settings import GapSettings
from torchid.log.model import Log
from torchid.position.model import ServoArm
from torchid.results.record import Result
from torchid.results.words import number_list
from torchid.robot.model import Robot


@dataclass(frozen=True, eq=False)
class CorrectionRequest:
    """What a correction is asked for; see `torchid.export.correct.correct`."""

    robot: Robot
    log: Log
    to: Target
    folder: Path
    name: str | None
    held_out: Log | None
    settings: GapSettings
    with_effects: bool | Package
    keep: Sequence[Path]
    plain: bool = False

    @property
    def stem(self) -> str:
        """Of the files' names."""
        return f"{stem_of(self.robot)}_corrected" if self.name is None else self.name

    def write(
        self, dynamics: Dynamics, title: str, to: Format | None = None, ending: str = ""
    ) -> Export:
        """Write dynamics under a title: in the correction's format, or another one."""
        return export_dynamics(
            replace(dynamics, title=title), to or self.to, self.folder, f"{self.stem}{ending}",
            nominal=self.robot, geometry="none", seed=self.settings.seed, keep=self.keep,
        )  # fmt: skip


def without_field(beside: Sequence[str]) -> str:
    """The end of a title that names what a file has no field for."""
    return f"; no field for {', '.join(beside)}" if beside else ""


CLAIMED = 1.15
"""Error in the engine over the claimed one from which a warning says so; beside 1 % or 1 mrad."""


class Judged(Errors, frozen=True, eq=False, kw_only=True):
    """Errors of each joint on a log.

    Attributes:
        unit: `%`, or of position errors.
        held_out: what the errors are on: names of held-out logs, `parts that were not fitted`, or
            `the log that was fitted`.
        by: the engine that runs the file.
        band: [Hz]; None of positions.
        forward: by horizon, of torques; on the log that was fitted where no other is given.
    """

    unit: str
    held_out: str
    by: str
    band: float | None = None
    forward: tuple[Forward, ...] = ()

    @property
    def worse_than_claimed(self) -> list[str]:
        """A sentence for each joint whose error in the engine is not what the file says."""
        worse = (self.engine > CLAIMED * self.claim) & (self.engine > self.claim + 1)
        of = "% of the torque" if self.unit == "%" else self.unit
        return [
            f"joint {j + 1}: {self.by} leaves {float(self.engine[j]):.1f} {of}, and the file's own "
            f"numbers {float(self.claim[j]):.1f}"
            for j in worse.nonzero().flatten().tolist()
        ]


@dataclass(frozen=True, eq=False)
class Correction(Result):
    """A corrected file.

    Attributes:
        nominal: the robot as given.
        judged: what the file is worth.
        exports: what was written: the file, and the one with effects beside it.
        warnings: sentences for the user.
        projection: what is in the file, of a correction by torques.
        servos: that are in it, of a correction by positions.
        no_field: parameters of servos that are not in it, with joints from 0.
        beside: other files that were written.
    """

    nominal: Robot
    judged: Judged
    exports: tuple[Export, ...]
    warnings: tuple[str, ...]
    projection: Projection | None = None
    servos: ServoArm | None = None
    no_field: dict[str, tuple[int, ...]] = field(default_factory=dict)
    beside: tuple[Path, ...] = ()

    def __repr__(self) -> str:
        return f"Correction('{self.nominal.name}', {', '.join(map(str, self.files))})"

    @property
    def files(self) -> tuple[Path, ...]:
        """What was written."""
        return (*(file for one in self.exports for file in one.files), *self.beside)

    @cached_property
    def record(self) -> CorrectionRecord:
        """As the JSON has it."""
        return correction_record(self)


def of_joints(joints: Sequence[int]) -> str:
    """Which joints something is of; nothing where it is of none in particular."""
    return f" of joint {number_list(joints)}" if joints else ""


def correction_record(done: Correction) -> CorrectionRecord:
    """A correction as its JSON has it."""
    judged, projection = done.judged, done.projection
    errors: dict[str, Any] = {
        "torque_error_percent" if judged.unit == "%" else "position_error_mrad": Errors.of(judged)
    }
    own: dict[str, Any] = {
        "servos_without": tuple(UnsaidRow(parameter=k, joints=j) for k, j in done.no_field.items())
    }
    if projection is not None:
        given = projection.robot.require_parameters("a correction")
        bodies = BodiesRecord.of(projection, given, fields=projection.robot.effects)
        own = {"no_field": projection.kept, "bodies": bodies}
    return CorrectionRecord(
        robot=done.nominal.name,
        to=done.exports[0].format,
        judged=JudgedRecord.of(judged, **errors, forward=judged.forward),
        **own,
        exports=tuple(one.record for one in done.exports),
        warnings=done.warnings,
    )
