"""What explanations of a gap look like along a motion, beside all that is fitted with them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch

from torchid.dynamics.regressor import regressor
from torchid.effects.base import Effect, JointEffect, Motion
from torchid.effects.registry import Valued, in_rounds, model_torque
from torchid.excitation.fourier import FourierTrajectory
from torchid.identification.base_parameters import BaseParameters
from torchid.log.filtering import ZeroPhaseFilter
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor

RATE = 40.0
"""[Hz] at which columns are evaluated before the filter: they jump."""

Group = tuple[Effect, ...]
"""Effects that share their coefficients: one, or the same one on every joint."""

ROUNDING = 1e-6
"""Of columns of length one: directions below it are rounding."""


@dataclass(frozen=True, eq=False)
class Setting:
    """What explanations are told apart on.

    Attributes:
        robot: the model, with parameters.
        given: effects that are in the model.
        base: base parameters.
        noise: (n,) standard deviation of the torque in `band` [N m; N].
        band: of the noise [Hz]: a second holds 2 band independent values.
        cutoff: of the fit's filter [Hz].
        free: whether base parameters are refitted whatever the explanation.
        fitted: effects whose coefficients are.
    """

    robot: Robot
    given: tuple[Valued, ...]
    base: BaseParameters
    noise: Float[Tensor, " n"]
    band: float
    cutoff: float
    free: bool = True
    fitted: tuple[Group, ...] = ()


class Rows:
    """Whitened rows along a trajectory.

    Columns are evaluated at 40 Hz, filtered as the fit does, and decimated by two.
    """

    def __init__(self, setting: Setting, trajectory: FourierTrajectory):
        self._setting = setting
        sampled = trajectory.sample(RATE)
        self._bare = Motion(*sampled.motion.state, t=sampled.t)
        # What 2 band independent values a second of this noise are worth, at RATE / 2 rows.
        per_row = 2 * setting.band / (RATE / 2)
        self._weight = per_row**0.5 / setting.noise.clamp(min=1e-12)
        self._filter = ZeroPhaseFilter(RATE, min(setting.cutoff, 0.22 * RATE))
        self._motions: dict[Group, Motion] = {}
        self._columns: dict[tuple[Effect, Group], Tensor] = {}
        self._fitted: dict[tuple[bool, Group], Tensor | None] = {}

    def motion(self, leaving: Group = ()) -> Motion:
        """With the torque of the model without the effects `leaving`: what scales with the torque
        must not contain what it stands for."""
        if leaving not in self._motions:
            first, _ = in_rounds(self._setting.given)
            gone = {(e.name, e.joints) for e in leaving}
            kept = [p for p in first if (p[0].name, p[0].joints) not in gone]
            load = model_torque(self._setting.robot, kept, self._bare)
            self._motions[leaving] = self._bare._replace(torque=load)
        return self._motions[leaving]

    @cached_property
    def torque(self) -> Float[Tensor, "n R"]:
        """The model's own torque, joint by joint."""
        return self._low(self.motion().require("torque", "a comparison").unsqueeze(-1))[0]

    def columns(self, group: Sequence[Effect], leaving: Group = ()) -> Float[Tensor, "R C"]:
        """Of effects that share their coefficients (rows, C), joints and instants stacked."""
        total = self._of(group[0], leaving)
        for effect in group[1:]:
            total = total + self._of(effect, leaving)
        return total

    def _of(self, effect: Effect, leaving: Group) -> Tensor:
        key = effect, leaving if "torque" in effect.needs else ()
        if key not in self._columns:
            self._columns[key] = self._evaluated(effect, self.motion(key[1])).flatten(1).T
        return self._columns[key]

    def _evaluated(self, effect: Effect, motion: Motion) -> Float[Tensor, "C n R"]:
        if not isinstance(effect, JointEffect):
            return self._low(effect.torque_columns(motion, self._setting.robot))
        own = self._low(effect.columns(motion).unsqueeze(1), effect.joint)
        out = own.new_zeros(own.shape[0], self._setting.robot.n, own.shape[-1])
        out[:, effect.joint] = own[:, 0]
        return out

    def _low(self, x: Float[Tensor, "T m C"], joint: int | None = None) -> Float[Tensor, "C m R"]:
        """Filtered, decimated and whitened signals of all joints, or of one."""
        low = self._filter.apply(x.permute(2, 1, 0).contiguous())[..., ::2]
        weight = self._weight if joint is None else self._weight[joint : joint + 1]
        return low * weight.unsqueeze(-1)

    def beside(self, x: Tensor, leaving: Group = (), *, base: bool = False) -> Tensor:
        """What all that is fitted cannot explain of a column (R,), or of several (R, C).

        Args:
            x: columns.
            leaving: accepted effects that are not fitted.
            base: whether base parameters are, also where the setting trusts them.
        """
        key = base or self._setting.free, leaving
        if key[0]:
            x = without(x, self._base)
        if key not in self._fitted:
            groups = [self.columns(g, leaving) for g in self._setting.fitted if g != leaving]
            joined = torch.cat(groups, 1) if groups else x.new_zeros(len(x), 0)
            self._fitted[key] = directions(without(joined, self._base) if key[0] else joined)
        return without(x, self._fitted[key])

    @property
    def base_columns(self) -> int:
        """Number of base parameters that fit noise where they are fitted for one explanation."""
        return 0 if self._setting.free else self._setting.base.n_rigid

    @cached_property
    def _base(self) -> Tensor:
        base = self._setting.base
        y = regressor(self._setting.robot, *self._bare.state)
        y = self._low(y[..., list(base.independent[: base.n_rigid])]).flatten(1).T
        size = torch.linalg.vector_norm(y, dim=0)
        q, r = torch.linalg.qr(y[:, size > 0] / size[size > 0])
        return q[:, r.diagonal().abs() > 1e-9]


def directions(columns: Float[Tensor, "R C"]) -> Float[Tensor, "R D"] | None:
    """Orthonormal columns that span these; None where they vanish."""
    size = torch.linalg.vector_norm(columns, dim=0)
    there = size > 1e-9
    if not bool(there.any()):
        return None
    q, s, _ = torch.linalg.svd(columns[:, there] / size[there], full_matrices=False)
    return q[:, s > ROUNDING]


def without(x: Tensor, basis: Tensor | None) -> Tensor:
    """What orthonormal columns cannot explain of x (R,) or (R, C)."""
    return x if basis is None else x - basis @ (basis.T @ x)
