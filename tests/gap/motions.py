"""Segments for the tests of the gap: known motion, known noise."""

import math
from collections.abc import Sequence

import torch
from scipy.signal import lfilter

from torchid.design.segments import Segment
from torchid.effects.base import Motion
from torchid.excitation.trajectories import random_trajectory
from torchid.robot.library import load_robot
from torchid.typing import Samples, Tensor

RATE = 250.0
BAND = 40.0
ROBOT = load_robot("3r")


def motion_at(t: Tensor, seed: int = 0, robot: str = "3r") -> Motion:
    """A random trajectory of 20 s whose period is longer, read at any times."""
    found = random_trajectory(load_robot(robot), seed, fill=True, w_f=0.09 * math.pi).at(t)
    return Motion(*found.state, t=t)


def segment_of(
    motion: Motion, tau: Tensor | None = None, name: str = "a", rate: float = RATE
) -> Segment:
    """As `segments_of` would make it of a log without noise."""
    torque = torch.zeros_like(motion.q) if tau is None else tau
    return Segment(name, rate, BAND, motion, torque, own_velocity=False)


def times(duration: float = 20.0, start: float = 0.0, rate: float = RATE) -> Tensor:
    return start + torch.arange(round(duration * rate), dtype=torch.float64) / rate


def noise(
    samples: int, n: int, generator: torch.Generator, hz: float | None = None, rate: float = RATE
) -> Samples:
    """Noise of standard deviation 1, white or AR(1) with this cut-off."""
    if hz is None:
        return torch.randn(samples, n, generator=generator, dtype=torch.float64)
    pole = float(torch.exp(torch.tensor(-2 * torch.pi * hz / rate)))
    white = torch.randn(samples + 2000, n, generator=generator, dtype=torch.float64)
    out = lfilter([(1 - pole**2) ** 0.5], [1, -pole], white.numpy(), axis=0)
    return torch.from_numpy(out)[2000:].contiguous()


def noises(
    segments: Sequence[Segment], seed: int, hz: float | None = None, size: float = 1.0
) -> list[Samples]:
    generator = torch.Generator().manual_seed(seed)
    return [size * noise(s.length, s.n, generator, hz, s.rate) for s in segments]
