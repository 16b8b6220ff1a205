"""Small problems of the diagnosis whose answer is known."""

import torch

from tests.gap.motions import motion_at, noises, passage_of, times
from torchid.effects.base import Coefficient, Motion
from torchid.effects.registry import KINDS, Valued, model_torque
from torchid.gap.bank import Bank
from torchid.gap.candidates import Evaluator
from torchid.gap.passages import Passage, Rows
from torchid.gap.prepare import sharp_direction
from torchid.gap.problem import Problem
from torchid.gap.task import Task, banks_of
from torchid.identification.base_parameters import base_parameters
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.typing import Tensor

CUTOFF = 8.0
NOISE = 0.05
PLAIN = Coefficient("c", "N m", False, "any number")
POSITIVE = Coefficient("c", "N m", True, "a positive number")


def random(*shape: int, seed: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def ar_noise(*shape: int, pole: float, seed: int) -> Tensor:
    """AR(1) of variance one along the last axis, from its stationary start on."""
    e = random(*shape, seed=seed)
    out = e.clone()
    for t in range(1, shape[-1]):
        out[..., t] = pole * out[..., t - 1] + (1 - pole**2) ** 0.5 * e[..., t]
    return out


def bank(
    columns: Tensor,
    place: int | None = 0,
    *,
    name: str = "cogging",
    coefficient: Coefficient = PLAIN,
    looks: float = 1.0,
) -> Bank:
    """A bank of these columns (S, C, R), whatever they are."""
    s, c, _ = columns.shape
    members = tuple((KINDS["cogging"](place or 0, float(k + 1)),) for k in range(s))  # type: ignore[call-arg]
    return Bank(name, place, members, columns, (coefficient,) * c, looks)


def problem(
    y: Tensor, banks: tuple[Bank, ...], *, whitened: bool = True, fixed=(), interval: float = 0.05
) -> Problem:
    """One trajectory of which every row counts."""
    n, count = y.shape
    keep = torch.ones(n, count, dtype=torch.bool)
    bounds = (slice(0, count),)
    return Problem(
        y, keep, n * count, banks, tuple(fixed), bounds, interval, lambda e, k: None, whitened
    )


def explicit_gain(x: Tensor, y: Tensor, model: Tensor | None = None) -> float:
    """Fall of the sum of squares when rows x (C, R) join a model (M, R): two least squares."""

    def loss(a: Tensor) -> float:
        if not len(a):
            return float(y.square().sum())
        # gelsd: the driver that knows about rank
        c = torch.linalg.lstsq(a.T, y.unsqueeze(1), driver="gelsd").solution
        return float((y.unsqueeze(1) - a.T @ c).square().sum())

    held = x[:0] if model is None else model
    return loss(held) - loss(torch.cat([held, x]))


def with_torque(
    motions: list[Motion], robot: Robot, effects: list[Valued], size: float = NOISE, seed: int = 0
) -> list[Passage]:
    """Passages whose torque is a robot's with effects, and white noise of this size."""
    passages = [passage_of(m, name=f"run{k}") for k, m in enumerate(motions)]
    passages = [
        passage_of(_sharp(p), model_torque(robot, effects, _sharp(p)), p.name) for p in passages
    ]
    noisy = zip(passages, noises(passages, seed, size=size), strict=True)
    return [passage_of(p.motion, p.tau + z, p.name) for p, z in noisy]


def _sharp(p: Passage) -> Motion:
    still = torch.zeros(p.n, dtype=torch.float64)
    return p.motion._replace(direction=sharp_direction(p, still))


def motions(count: int = 3, duration: float = 16.0) -> list[Motion]:
    """Different trajectories of the 3R, one after the other."""
    out = []
    for k in range(count):
        m = motion_at(times(duration), seed=k)
        out.append(m._replace(t=m.t + k * (duration + 1)))
    return out


class Case:
    """A search over effects on the 3R, rows in units of the noise.

    Args:
        real: what moves: a robot and its effects.
        names: effects that are searched over.
        robot: the model.
    """

    def __init__(
        self,
        effects: list[Valued],
        names: tuple[str, ...],
        *,
        real: Robot | None = None,
        robot: Robot | None = None,
        free: bool = False,
        inertial: bool = True,
        background: tuple[str, ...] = (),
        count: int = 3,
    ):
        arm = load_robot("3r")
        self.robot = arm if robot is None else robot
        passages = with_torque(motions(count), arm if real is None else real, effects)
        self.rows = Rows(passages, CUTOFF)
        self.keep = torch.ones(self.robot.n, len(self.rows), dtype=torch.bool)
        white = [z.T for z in noises(passages, seed=5, size=NOISE)]
        size = self.rows.apply(white).square().mean(-1).sqrt()
        self.evaluator = Evaluator(self.robot, (), self.rows, lambda x, j: x / size[j])
        self.task = Task(
            base=base_parameters(self.robot), names=names, background=background, free=free,
            inertial=inertial, own_velocity=False, age=False, whitened=True, most=10, alpha=0.01,
            seed=0,
        )  # fmt: skip
        self.banks = banks_of(self.evaluator, self.task)
