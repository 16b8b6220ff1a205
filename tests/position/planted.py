"""Logs of a servo arm with known servos, by our own simulator (which MuJoCo checks elsewhere)."""

import math

import torch

from tests.arms import arm
from torchid.effects.servo import INDEX
from torchid.log.model import Log
from torchid.robot.model import Robot
from torchid.simulation.replay import replayed
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import Tracks, windows_of

DT = 0.02
COUNT = 2 * math.pi / 4096
"""Of a small servo's encoder [rad]."""


def commands(n: int, motions: int, seconds: float, seed: int) -> Tracks:
    """Slow sweeps with holds, steps, and faster sines, in turn."""
    g = torch.Generator().manual_seed(seed)

    def uniform(*shape: int) -> torch.Tensor:
        return torch.rand(shape, generator=g, dtype=torch.float64)

    samples = round(seconds / DT)
    t = DT * torch.arange(samples, dtype=torch.float64)[:, None]
    parts = []
    for m in range(motions):
        u = (1.2 * (uniform(n) - 0.5)).expand(samples, n)
        if m % 3 == 0:
            w = 2 * math.pi * (0.05 + 0.15 * uniform(n))
            wave = (1 - (w * t).cos()) * (0.3 + 0.3 * uniform(n))
            u = u + torch.where((t / 3).floor() % 2 == 0, wave, wave[0]).cummax(0).values
        elif m % 3 == 1:
            held = (t[:, 0] / 1.5).floor().long()
            u = u + 0.4 * (uniform(int(held[-1]) + 1, n) - 0.5)[held]
        else:
            for _ in range(3):
                w = 2 * math.pi * (0.1 + 1.0 * uniform(n))
                u = u + (1 - (w * t).cos()) * (0.05 + 0.1 * uniform(n))
        parts.append(u)
    first = samples * torch.arange(motions)
    return Tracks(torch.cat(parts), first, first + samples - 1, DT)


def true_servos(n: int, **extra: tuple[int, float]) -> Servos:
    """Servos of the arm `3r`'s size; extra: parameter -> (joint from 1, value)."""
    servos = Servos.neutral(
        n, kp=260.0, damping=22.0, armature=0.8, delay=0.02, coulomb=1.5, offset=0.5
    )
    # The first turns about the vertical, where any constant torque is a cause.
    servos.joint[0, INDEX["offset"]] = 0.0
    for name, (joint, value) in extra.items():
        servos.joint[joint - 1, INDEX[name]] = value
    return servos


def planted(
    servos: Servos,
    *,
    motions: int = 6,
    seconds: float = 16.0,
    seed: int = 1,
    robot: Robot | None = None,
) -> Log:
    """What an arm, `3r` if none is given, logs with these servos: t, u, and q in encoder counts."""
    robot = robot or arm("3r")
    tracks = commands(robot.n, motions, seconds, seed)
    start = tracks.u[tracks.first]
    whole = windows_of(tracks, None)
    q = replayed(robot, servos, tracks, whole, start, torch.zeros_like(start))
    samples = len(tracks.u) // motions
    return Log(
        t=(DT * torch.arange(samples, dtype=torch.float64)).repeat(motions),
        q=(q / COUNT).round() * COUNT,
        u=tracks.u,
        trajectory=torch.arange(motions).repeat_interleave(samples),
        source="planted",
    )


def robot() -> Robot:
    """The arm of the logs."""
    return arm("3r")
