"""How well servos are known: a jackknife over motions.

Per motion, the normal equations of every joint at the fitted servos tell what the fit would have
been without it: one Gauss-Newton step away, since a motion is a small part of the log.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchid.position.data import PositionData
from torchid.position.fit import (
    LONGEST,
    absolute,
    huber,
    moved,
    prior_precision,
    searched,
    sensitivities,
    weights,
)
from torchid.simulation.servo import INDEX, PARAMETERS, Servos
from torchid.simulation.servo_loop import Windows
from torchid.typing import Float, Int

FOLDS = 5


@dataclass(frozen=True, eq=False)
class Equations:
    """Normal equations of every joint and motion, at one set of servos.

    Attributes:
        servos: where they hold.
        names: the K parameters.
        mask: (n, K) where each is free.
        gram: (m, n, K, K), pull: (m, n, K) of motions.
    """

    servos: Servos
    names: tuple[str, ...]
    mask: Tensor
    gram: Tensor
    pull: Tensor

    def step(self, left_out: Tensor) -> Tensor:
        """(n, K) from the servos to those fitted without some motions (m,)."""
        keep = ~left_out
        gram = self.gram[keep].sum(0) + torch.diag(prior_precision(self.names))
        both = self.mask[:, :, None] & self.mask[:, None, :]
        gram = torch.where(both, gram, torch.eye(len(self.names), dtype=gram.dtype))
        # The whole fit stands where its pull is zero; only what leaves moves it.
        pull = -self.pull[left_out].sum(0)
        step = -torch.linalg.solve(gram, torch.where(self.mask, pull, 0.0)[..., None])[..., 0]
        return step.clamp(-LONGEST, LONGEST)

    def deviations(self) -> Float[Tensor, "n K"]:
        """Standard deviations of the parameters, of logarithms where they are searched so: a
        jackknife over motions."""
        count = len(self.pull)
        at = [INDEX[name] for name in self.names]
        there = searched(self.servos).repeat(count, 1, 1)
        for m in range(count):
            there[m][:, at] += self.step(torch.arange(count) == m)
        found = absolute(moved(self.servos, there))[..., at]
        spread = (found - found.mean(0)).square().sum(0)
        return torch.where(self.mask, ((count - 1) / count * spread).sqrt(), 0.0)


def equations(
    data: PositionData, servos: Servos, free: Mapping[str, Tensor], windows: Windows
) -> Equations:
    """Normal equations by motion; Huber's weights bound what a rare event can do."""
    names = tuple(free)
    s = sensitivities(data, servos, names, windows)
    w = weights(s.residual, windows)
    a = s.slope * w.sqrt()[..., None]
    b = s.residual * w.sqrt()
    motions = int(windows.motion.max()) + 1
    shape = (motions, data.robot.n)
    gram = torch.zeros(*shape, len(names), len(names), dtype=a.dtype)
    gram.index_add_(0, windows.motion, torch.einsum("lwnk,lwnj->wnkj", a, a))
    pull = torch.zeros(*shape, len(names), dtype=a.dtype)
    pull.index_add_(0, windows.motion, torch.einsum("lwnk,lwn->wnk", a, b))
    mask = torch.stack([free[name] for name in names], 1)
    return Equations(servos, names, mask, gram, pull)


def folds_of(motions: int, count: int = FOLDS) -> Int[Tensor, " m"]:
    """Which fold each motion is in: every fifth, so that like ones that were driven one after the
    other are apart."""
    return torch.arange(motions) % min(count, motions)


def motion_losses(error: Float[Tensor, "L W n"], windows: Windows) -> Float[Tensor, "m n"]:
    """Huber's loss of every motion and joint [rad^2]."""
    own = huber(error) * windows.weight[:, None]
    out = torch.zeros(int(windows.motion.max()) + 1, own.shape[1], dtype=own.dtype)
    return out.index_add_(0, windows.motion, own)


def each_window(servos: Mapping[int, Servos], owner: Tensor) -> Servos:
    """Servos of every window (W, 1, n, K), from those of the fold that it is in."""
    first = next(iter(servos.values()))
    joint = torch.stack([servos[k].joint for k in owner.tolist()])[:, None]
    plane = torch.stack([servos[k].plane for k in owner.tolist()])[:, None]
    return replace(first, joint=joint, plane=plane)


def value_interval(name: str, value: float, deviation: float) -> tuple[float, float]:
    """95 % interval of a parameter from the deviation of its searched coordinate."""
    kind = PARAMETERS[INDEX[name]].kind
    if kind == "log":
        factor = float(torch.tensor(1.96 * deviation).exp())
        return value / factor, value * factor
    low, high = value - 1.96 * deviation, value + 1.96 * deviation
    return (max(low, 0.0) if kind == "positive" else low), high
