"""How well servos are known: by how much motions disagree, and by how much noise alone allows.

Per motion, the normal equations of every joint at the fitted servos tell where that motion pulls.
What the pulls of motions spread is the larger of two answers on most parameters (a sandwich
estimate, motions as clusters: Liang and Zeger 1986). A parameter that one motion alone tells has
no such spread: there what is left in the windows, alike within a second, is its noise.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchid.position.data import SMALL, PositionData
from torchid.position.fit import (
    TOGETHER,
    huber,
    prior_precision,
    sensitivities,
    weights,
)
from torchid.simulation.servo import INDEX, PARAMETERS, TORQUES, Servos
from torchid.simulation.servo_loop import Windows
from torchid.statistics.proportion import HALF_95
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
        square: (n,) mean square error [rad^2].
    """

    servos: Servos
    names: tuple[str, ...]
    mask: Tensor
    gram: Tensor
    pull: Tensor
    square: Tensor

    def deviations(self) -> Float[Tensor, "n K"]:
        """Standard deviations of the parameters, of logarithms where they are searched so."""
        both = self.mask[:, :, None] & self.mask[:, None, :]
        gram = self.gram.sum(0) + torch.diag(prior_precision(self.names))
        gram = torch.where(both, gram, torch.eye(len(self.names), dtype=gram.dtype))
        inverse = torch.linalg.inv(gram)
        pull = torch.where(self.mask, self.pull, 0.0)
        pull = pull - pull.mean(0)
        count = len(pull)
        spread = torch.einsum("mnk,mnl->nkl", pull, pull) * count / max(1, count - 1)
        to = self._to_values()
        out = []
        for covariance in (
            inverse @ spread @ inverse,
            inverse * (TOGETHER * self.square)[:, None, None],
        ):
            out.append((to @ covariance @ to.transpose(1, 2)).diagonal(dim1=1, dim2=2))
        largest = torch.maximum(*out).clamp(min=0).sqrt()
        return torch.where(self.mask, largest, 0.0)

    def _to_values(self) -> Float[Tensor, "n K K"]:
        """Changes of parameters by searched coordinates, in which torques are shares of kp."""
        size = len(self.names)
        out = torch.eye(size, dtype=self.gram.dtype).repeat(self.servos.n, 1, 1)
        gain, k = self.servos.of("kp"), self.names.index("kp")
        for row, name in enumerate(self.names):
            if name not in TORQUES or name == "kp":
                continue
            if PARAMETERS[INDEX[name]].kind == "log":
                out[:, row, k] = 1.0
            else:
                out[:, row, row] = gain / SMALL
                out[:, row, k] = self.servos.of(name)
        return out


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
    rows = float((windows.length * windows.weight).sum())
    return Equations(servos, names, mask, gram, pull, b.square().sum((0, 1)) / rows)


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
        factor = float(torch.tensor(HALF_95 * deviation).exp())
        return value / factor, value * factor
    low, high = value - HALF_95 * deviation, value + HALF_95 * deviation
    return (max(low, 0.0) if kind == "positive" else low), high
