"""A log on its way through the doctor's table."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from torchid.doctor.check import Check
from torchid.doctor.repair import repaired
from torchid.log.checks import FOLLOWS
from torchid.log.model import Log
from torchid.log.movement import Agreement
from torchid.robot.model import JointType, Robot
from torchid.typing import Float, Tensor


@dataclass(frozen=True, eq=False)
class Case:
    """A log as the checks before have mended it.

    Attributes:
        robot, log: whose, and which.
        fixes: names of the choices to take.
        checks: those before.
    """

    robot: Robot
    log: Log
    fixes: Sequence[str] = ()
    checks: tuple[Check, ...] = ()

    @property
    def counts(self) -> bool:
        """Whether positions are counts of an unknown part of a turn, or in another unknown unit."""
        units = [c for c in self.checks if c.name == "position unit" and c.verdict == "wrong"]
        return any("COUNTS" in (c.fix or "") and not (c.choices and c.repairs) for c in units)

    @property
    def stopped(self) -> bool:
        """Whether the clock runs in no way, so that nothing else can be looked at."""
        return any(
            c.name == "clock" and c.verdict == "wrong" and not c.repairs for c in self.checks
        )

    @property
    def torque(self) -> Float[Tensor, "T n"] | None:
        """What a log has of the torque: itself, else the currents."""
        return self.log.tau if self.log.tau is not None else self.log.current

    @property
    def turning(self) -> list[int]:
        """Joints, from 0, that turn."""
        kinds = self.robot.joint_types
        return [k for k, kind in enumerate(kinds) if kind is JointType.REVOLUTE]

    @property
    def extent(self) -> Float[Tensor, " n"]:
        """How far each joint goes, in the unit of the positions."""
        return self.log.q.amax(0) - self.log.q.amin(0)

    @property
    def followers(self) -> list[Agreement]:
        """Agreements of joints whose velocities follow their positions, up to a unit."""
        return [a for a in self.log.agreements if a.correlation > FOLLOWS]

    def after(self, made: Check | Sequence[Check]) -> "Case":
        """With checks once more, and the log as they mend it."""
        every = (made,) if isinstance(made, Check) else tuple(made)
        log = repaired(self.log, [r for c in every for r in c.repairs])
        return replace(self, log=log, checks=(*self.checks, *every))
