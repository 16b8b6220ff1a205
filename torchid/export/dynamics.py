"""What is exported: the dynamics that a result of the program carries, as one robot."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import torch

from torchid.effects.base import Effect, Motion
from torchid.effects.registry import Valued, carrying, model_torque, nominal_effects
from torchid.errors import TorchidError
from torchid.identification.values import BaseValues
from torchid.position.model import ServoArm
from torchid.robot.inertia import PARAMETERS_PER_LINK, InertialParameters
from torchid.robot.model import JointType, Robot
from torchid.robot.origin import same_places
from torchid.typing import Float, Joints, Tensor

STATES = 200
"""Random states at which an export is compared with the result's own model."""

Kind = Literal["base parameters", "set", "robot"]


@dataclass(frozen=True, eq=False)
class Dynamics:
    """The dynamics of a result.

    Attributes:
        robot: its parameters and effects are the result's, and its torque is the result's model.
            Of base parameters, the independent ones carry the values and the others are zero.
        kind: what the result holds.
        title: the same in words, with the file it is from.
        base: the base parameters, of an identification.
        warnings: sentences for the user.
        arm: with servos, whose damping, dry friction and armature are effects of the robot; None
            where no servos are known.
        late: (n,) by how much their commands are late by being held [s]; None for not at all.
        set_points: as in `torchid.export.servo_mjcf.write_servos`.
    """

    robot: Robot
    kind: Kind
    title: str
    base: BaseValues | None = None
    warnings: tuple[str, ...] = ()
    arm: ServoArm | None = None
    late: Float[Tensor, " n"] | None = None
    set_points: bool = False

    def torque(self, motion: Motion) -> Joints:
        """Torque (..., n) [N m; N] of the result's own model."""
        return robot_torque(self.robot, motion)


def require_same_arm(corrected: Robot, robot: Robot, what: str) -> None:
    """Raise TorchidError for what (`result is`) is of another arm than the robot."""
    same = (corrected.n, corrected.n_links) == (robot.n, robot.n_links)
    if not same or not bool(same_places(corrected, robot).all()):
        raise TorchidError(
            f"the {what} of another arm.",
            got=f"'{corrected.name}', {corrected.n} joints",
            expected=f"'{robot.name}', {robot.n} joints in the same places",
        )


def in_places_of(robot: Robot, file: Robot) -> Robot:
    """The robot with its links where another file of the same arm has them, rounded otherwise."""
    return replace(robot, before=file.before, after=file.after)


def robot_torque(robot: Robot, motion: Motion) -> Joints:
    """Torque (..., n) [N m; N] of a robot's parameters with all its effects."""
    return model_torque(robot, nominal_effects(robot), motion)


def of_base(robot: Robot, values: BaseValues, title: str | None = None) -> Dynamics:
    """The dynamics of identified base parameters; `title` says for people what they are."""
    unknown = [n for n, k in zip(values.base.names, values.known.tolist(), strict=True) if not k]
    warnings = (f"not determined by the log, and 0 here: {', '.join(unknown)}",) if unknown else ()
    title = f"{len(values.base)} identified base parameters" if title is None else title
    full = torch.zeros(len(values.base.parameter_names), dtype=torch.float64)
    full[list(values.base.independent)] = values.values
    return Dynamics(_with(robot, values, full), "base parameters", title, values, warnings)


def nearest_representative(robot: Robot, values: BaseValues) -> Robot:
    """The robot with the parameters nearest to its own (Euclidean; to zero where it has none) that
    have exactly these base parameters, x = x0 + G' (G G')^-1 (beta - G x0)."""
    grouping = values.base.grouping
    start = torch.zeros(grouping.shape[1], dtype=torch.float64)
    if robot.parameters is not None:
        start[: PARAMETERS_PER_LINK * robot.n_links] = robot.parameters.to_paper_order().double()
    change = torch.linalg.lstsq(grouping, values.values - grouping @ start, driver="gelsd").solution
    return _with(robot, values, start + change)


def _with(robot: Robot, values: BaseValues, full: Float[Tensor, " P"]) -> Robot:
    """The robot with a full vector of parameters and coefficients (the paper's order)."""
    rigid = PARAMETERS_PER_LINK * robot.n_links
    coefficients = full[rigid:].split([len(e.coefficients) for e in values.effects])
    records = [e.record(c.tolist()) for e, c in zip(values.effects, coefficients, strict=True)]
    parameters = InertialParameters.from_paper_order(full[:rigid])
    return replace(
        robot.with_parameters(parameters), effects=tuple(records), knowledge=values.knowledge
    )


def folded_robot(robot: Robot) -> Robot:
    """The robot with effects that are bodies (a payload, links' missing inertia) put into its
    parameters, where no other effect is taken from the model's own."""
    pairs = nominal_effects(robot)
    bodies = [(e, values) for e, values in pairs if e.inertial]
    others = [(e, values) for e, values in pairs if not e.inertial]
    if not bodies or any("robot" in effect.needs for effect, _ in others):
        return robot
    return replace(carrying(robot, bodies), effects=records(others))


def records(pairs: Sequence[Valued]) -> tuple[Mapping[str, Any], ...]:
    """Effects as a robot's description lists them."""
    return tuple(effect.record(values) for effect, values in pairs)


def effect_text(effect: Effect, values: Sequence[float], robot: Robot) -> str:
    """`joint 2: stribeck_friction Fs = 1.2 N m, vs = 0.1 rad/s` with all digits."""
    record = effect.record(values)
    prismatic = bool(effect.joints) and all(
        robot.joint_types[j] is JointType.PRISMATIC for j in effect.joints
    )
    units = {c.name: c.unit_for(prismatic) for c in effect.coefficients}
    units |= {s.name: s.unit for s in effect.shapes}
    # Fields that are left at their defaults and are no shapes, such as smoothing, say nothing.
    silent = {f.name for f in fields(effect) if record.get(f.name) == f.default} - set(units)
    own = [
        f"{key} = {value!r}{' ' + units[key] if units.get(key, '1') != '1' else ''}"
        for key, value in record.items()
        if key not in ("effect", "joint") and key not in silent
    ]
    place = f"joint {record['joint']}: " if "joint" in record else ""
    return f"{place}{effect.name} {', '.join(own)}"


def random_states(robot: Robot, seed: int, count: int = STATES) -> Motion:
    """Random states (count, n) within the robot's limits, for comparisons.

    Positions within +-pi (or +-1 m), velocities within +-2, accelerations within +-5 where a limit
    is not known; the instants are 10 ms apart, for effects that need time.
    """
    generator = torch.Generator().manual_seed(seed)
    revolute = torch.tensor([kind is JointType.REVOLUTE for kind in robot.joint_types])
    free = {
        "position": torch.where(revolute, torch.pi, torch.ones(robot.n, dtype=torch.float64)),
        "velocity": torch.full((robot.n,), 2.0, dtype=torch.float64),
        "acceleration": torch.full((robot.n,), 5.0, dtype=torch.float64),
    }
    signals = []
    for name, size in free.items():
        known = getattr(robot.limits, name)
        span = torch.stack([-size, size], -1)
        if known is not None:
            span = torch.where(torch.isfinite(known).all(-1, keepdim=True), known, span)
        share = torch.rand(count, robot.n, generator=generator, dtype=torch.float64)
        signals.append(span[:, 0] + share * (span[:, 1] - span[:, 0]))
    q, dq, ddq = signals
    return Motion(q, dq, ddq, t=torch.arange(count, dtype=torch.float64) * 0.01)
