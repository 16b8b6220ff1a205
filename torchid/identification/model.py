"""What an identified model can do, just computed or read back from its file."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import torch

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Effect, JointEffect, Motion
from torchid.effects.registry import Valued, in_rounds
from torchid.errors import TorchidError
from torchid.identification.base_parameters import BaseParameters
from torchid.results.record import Col, Ends, Part, face
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.statistics.jackknife import student_quantile
from torchid.tensors import joint_signals
from torchid.typing import Bool, Float, Joints, Numbers, Tensor

if TYPE_CHECKING:
    from torchid.excitation.design import InformedDesign


class BaseParameter(Part, frozen=True, kw_only=True):
    """A base parameter; what was not estimated has neither std nor interval."""

    name: Annotated[str, Col()]
    unit: str
    value: Annotated[float, Col("value ± std", spread="std", unit_of="unit")]
    std: float | None
    relative_std_percent: Annotated[float | None, Col("std, % of value")]
    ci95: Annotated[Ends | None, Col("95 % interval", ".4g")]
    estimated: Annotated[bool, Col()]


class Blocks:
    """Standard deviations from `blocks` blocks of a log."""

    __slots__ = ()

    if TYPE_CHECKING:

        @property
        def blocks(self) -> int:
            """How many blocks the standard deviations are of."""

    def quantile(self, level: float = 0.95) -> float:
        """Half-width of a two-sided interval in standard deviations (Student, K - 1)."""
        return quantile(self.blocks, level)


def quantile(blocks: int, level: float = 0.95) -> float:
    """Half-width of a two-sided interval in standard deviations from K blocks (Student, K - 1)."""
    return float(student_quantile(level, torch.tensor([blocks - 1.0])))


class IdentifiedModel:
    """Base parameters with their covariance: `Identification`, and what its file is read as."""

    __slots__ = ()

    if TYPE_CHECKING:

        @property
        def record(self) -> Any:
            """As the JSON has it."""

        @property
        def model(self) -> Robot | None:
            """The robot; None in older files."""

        @property
        def base(self) -> BaseParameters:
            """The base parameters' structure."""

        @property
        def placed(self) -> tuple[Effect, ...]:
            """Linear effects, in the order of their coefficients."""

        @property
        def values(self) -> Float[Tensor, " B"]:
            """In the order of `base.names`."""

        @property
        def covariance(self) -> Float[Tensor, "B B"]:
            """Covariance of the values."""

        @property
        def free(self) -> Bool[Tensor, " B"]:
            """(B,) estimated; the others are 0."""

        @property
        def undetermined(self) -> tuple[str, ...]:
            """Names of those that the log does not tell."""

        @property
        def uncertainty(self) -> Blocks:
            """How the standard deviations were made."""

    @property
    def _robot(self) -> Robot:
        """The robot.

        Raises:
            TorchidError: a file of an older torchid, which does not hold it.
        """
        if self.model is None:
            raise TorchidError(
                "this identification does not hold its robot.",
                got="a file of an older torchid, without `model`",
                expected="the robot in the file",
                hint="write it again: torchid identify ROBOT LOG... --json FILE",
            )
        return self.model

    def next_motion(self, robot: Robot | None = None, **settings: Any) -> "InformedDesign":
        """The motion after which the parameters are known best; see `excite_for`."""
        return face("excite_for")(self.record, robot, **settings)

    @property
    def std(self) -> Float[Tensor, " B"]:
        """Standard deviations (B,); 0 for parameters that are not free."""
        return self.covariance.diagonal().clamp(min=0).sqrt()

    @property
    def relative_std_percent(self) -> Float[Tensor, " B"]:
        """100 std / |value| (B,); nan for parameters that are not free."""
        return 100 * self.std / self.values.abs()

    @property
    def estimates(self) -> tuple[BaseParameter, ...]:
        """Each with its deviation and interval: rigid ones, then coefficients of effects."""
        each = zip(
            self.base.names, self.base.units, self.values.tolist(), self.std.tolist(),
            self.relative_std_percent.tolist(), self.interval().tolist(), self.free.tolist(),
            strict=True,
        )  # fmt: skip
        return tuple(
            BaseParameter(
                name=name,
                unit=unit,
                value=value,
                std=std if free else None,
                relative_std_percent=relative if free and math.isfinite(relative) else None,
                ci95=(low, high) if free else None,
                estimated=free,
            )
            for name, unit, value, std, relative, (low, high), free in each
        )

    def interval(self, level: float = 0.95) -> Float[Tensor, "B 2"]:
        """Confidence intervals (B, 2) of the given level, by Student's quantile.

        Raises:
            TorchidError: the level does not lie between 0 and 1.
        """
        if not 0 < level < 1:
            raise TorchidError("a confidence level lies between 0 and 1.", got=level, expected=0.95)
        half = self.uncertainty.quantile(level) * self.std
        return torch.stack([self.values - half, self.values + half], -1)

    def predict(
        self,
        q: Numbers,
        dq: Numbers,
        ddq: Numbers,
        t: Sequence[float] | np.ndarray | Tensor | None = None,
    ) -> Joints:
        """Joint torques (..., n) [N m; N] of the identified model, from tensors or arrays.

        The direction of motion is the sign of dq here; on logs, `validation.predict` uses the
        direction with hysteresis, as the fit does.

        Args:
            q, dq, ddq: (..., n) [rad, rad/s, rad/s^2; m for prismatic joints]; (T, n) along a
                trajectory where an effect remembers its past (presliding_hysteresis).
            t: (...,) [s] since the log began, which friction that warms up needs.

        Raises:
            TorchidError: not numbers of all joints, or no time or trajectory where an effect needs
                one.
        """
        state = joint_signals(self._robot.n, q=q, dq=dq, ddq=ddq)
        values = self.values.to(state[0])
        for effect in self.placed:
            if "t" in effect.needs and t is None:
                raise TorchidError(f"{effect.name} needs the time.", expected="predict(.., t=..)")
            if getattr(effect, "memory", False) and state[0].ndim < 2:
                raise TorchidError(
                    f"{effect.name} depends on the past.",
                    got=tuple(state[0].shape),
                    expected=f"a trajectory (T, {self._robot.n})",
                )
        when = None if t is None else torch.as_tensor(t).to(state[0])
        motion = Motion(state[0], state[1], state[2], t=when)
        return model_torque(self._robot, self.base, self.placed, values, motion)

    def residual(self, q: Numbers, dq: Numbers, ddq: Numbers, tau: Numbers) -> Joints:
        """Measured minus predicted torque (..., n)."""
        return joint_signals(self._robot.n, tau=tau)[0] - self.predict(q, dq, ddq)

    def combination(self, weights: Float[Tensor, " P"]) -> tuple[float, float]:
        """Value and standard deviation of a linear combination of all parameters.

        Args:
            weights: (P,) over `base.parameter_names`.

        Raises:
            TorchidError: the torque, or this log, does not determine this combination.
        """
        row = weights[list(self.base.independent)]
        if not torch.allclose(row @ self.base.grouping, weights, atol=1e-8):
            raise TorchidError("the torque does not determine this combination of parameters.")
        used = [name for name, w in zip(self.base.names, row.tolist(), strict=True) if w != 0]
        unknown = sorted(set(used) & set(self.undetermined))
        if unknown:
            raise TorchidError("this log does not determine this combination.", got=unknown)
        return float(row @ self.values), float((row @ self.covariance @ row).clamp(min=0).sqrt())


def full_set(
    base: BaseParameters, effects: Sequence[Effect], values: Float[Tensor, " B"]
) -> tuple[InertialParameters, list[Valued]]:
    """One of the full sets with these base parameters, that in which the independent parameters
    carry their values and the dependent ones are zero; and the effects with their coefficients."""
    full = values.new_zeros(len(base.parameter_names))
    full[list(base.independent)] = values
    rigid, rest = full.tensor_split([base.n_rigid_parameters])
    parts = rest.split([len(e.coefficients) for e in effects])
    valued = [(e, x.tolist()) for e, x in zip(effects, parts, strict=True)]
    return InertialParameters.from_paper_order(rigid), valued


def model_torque(
    robot: Robot,
    base: BaseParameters,
    effects: Sequence[Effect],
    values: Float[Tensor, " B"],
    motion: Motion,
    *,
    load_only: bool = False,
) -> Float[Tensor, "*batch n"]:
    """Torque (..., n) of base parameters and effects.

    Args:
        robot, base, effects, values: the model; the values (B,) are those of `base`.
        motion: states (..., n).
        load_only: whether to leave out effects of the torque. The rest is the load that they see.
    """
    parameters, valued = full_set(base, effects, values)
    first, later = in_rounds(valued)
    tau = inverse_dynamics(robot, *motion.state, parameters)
    for effect, own in first:
        if isinstance(effect, JointEffect):
            tau[..., effect.joint] += effect.torque(motion, own)
        else:
            tau = tau + effect.all_torques(motion, own, robot)
    if load_only or not later:
        return tau
    loaded = motion._replace(torque=tau)
    return tau + sum(effect.all_torques(loaded, own, robot) for effect, own in later)
