"""What explanations of a gap look like along a motion, beside all that is fitted with them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch

from torchid.design.columns import Columns, Model
from torchid.design.segments import Samples, Segment
from torchid.dynamics.regressor import regressor
from torchid.effects.base import Effect, Motion
from torchid.effects.registry import Valued
from torchid.excitation.fourier import FourierTrajectory
from torchid.identification.base_parameters import BaseParameters
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor

RATE = 40.0
"""[Hz] at which columns are evaluated before the filter: they jump."""

Group = tuple[Effect, ...]
"""Effects that share their coefficients: one, or the same one on every joint."""


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
    """Whitened samples along a trajectory, of what a diagnosis would fit there."""

    def __init__(self, setting: Setting, trajectory: FourierTrajectory):
        self._setting = setting
        motion = trajectory.sample(RATE)
        tau = torch.zeros_like(motion.q)
        segment = Segment("", RATE, RATE / 2, motion, tau, own_velocity=True)
        self._samples = Samples([segment], min(setting.cutoff, 0.22 * RATE))
        # What 2 band independent values a second of this noise are worth, at so many samples.
        per_sample = 2 * setting.band * self._samples.interval
        self._weight = per_sample**0.5 / setting.noise.clamp(min=1e-12)
        self._models: dict[Group, Columns] = {}
        self._fitted: dict[tuple[bool, Group], Tensor | None] = {}

    @property
    def cutoff(self) -> float:
        """Cut-off of the samples' filter [Hz]."""
        return self._samples.cutoff

    @property
    def motions(self) -> list[Motion]:
        """With the torque of the model."""
        return self._at(()).motions

    @cached_property
    def torque(self) -> Float[Tensor, "n R"]:
        """The model's own torque, joint by joint."""
        loads = [m.require("torque", "a comparison").T for m in self.motions]
        return self._samples.of(loads) * self._weight.unsqueeze(-1)

    def columns(self, group: Sequence[Effect], leaving: Group = ()) -> Float[Tensor, "R C"]:
        """Columns (rows, C) of effects that share their coefficients, joints and samples stacked.

        Args:
            group: the effects.
            leaving: accepted effects that the model is without: what scales with its torque must
                not contain what it stands for.
        """
        models = (self._at(leaving if "torque" in effect.needs else ()) for effect in group)
        columns = [at.on_all_joints(effect) for at, effect in zip(models, group, strict=True)]
        total = torch.stack(columns).sum(0)
        return (total * self._weight.unsqueeze(-1)).flatten(1).T

    def place(self, group: Group) -> int | None:
        """The joint whose torque alone effects change, if there is one."""
        places = {self._at(()).of(effect)[0] for effect in group}
        return places.pop() if len(places) == 1 else None

    def _at(self, leaving: Group) -> Columns:
        if leaving not in self._models:
            gone = {e.identity for e in leaving}
            kept = tuple(p for p in self._setting.given if p[0].identity not in gone)
            self._models[leaving] = Columns(Model(self._setting.robot, kept), self._samples)
        return self._models[leaving]

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
        y = regressor(self._setting.robot, *self.motions[0].state)
        y = y[..., list(base.independent[: base.n_rigid])].permute(2, 1, 0)
        y = (self._samples.of([y]) * self._weight.unsqueeze(-1)).flatten(1).T
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
    # 1e-6: of columns of length one: directions below it are rounding
    return q[:, s > 1e-6]


def without(x: Tensor, basis: Tensor | None) -> Tensor:
    """What orthonormal columns cannot explain of x (R,) or (R, C)."""
    return x if basis is None else x - basis @ (basis.T @ x)
