"""What the logger writes: samples of what the sensors read, with quantisation, noise and jitter."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from torchid_bench.withheld.plant.bodies import Array
from torchid_bench.withheld.plant.plan import Plan, Signals
from torchid_bench.withheld.plant.sensing import with_held_torque

FINEST = 48
"""Bits of an encoder that rounds nothing."""


@dataclass(frozen=True)
class Logger:
    """A logger.

    Attributes:
        rate_hz: samples a second.
        encoder_bits: of a turn.
        colour_hz: corner of the torque noise (first order); None for white noise.
        jitter: standard deviation of the stamps, in sampling intervals.
        own_velocity: whether it has velocities that are not differences of its positions.
        velocity_noise: of those [rad/s].
        clock: stamp of the first trajectory's beginning [s].
        seed: of noise and jitter.
        grows: by how much the torque noise is larger at the joint's RMS speed than at rest, as a
            share.
    """

    rate_hz: int
    encoder_bits: int
    colour_hz: float | None
    jitter: float
    own_velocity: bool
    velocity_noise: float
    clock: float
    seed: int
    grows: float = 0.0


def logged(
    logger: Logger, plan: Plan, readings: Sequence[Signals], noise_std: Array
) -> dict[str, Array]:
    """Columns of a log: t, q1.., dq1.. where there are own velocities, tau1.., traj.

    Args:
        logger: how it samples.
        plan: held torques.
        readings: noise-free, one a trajectory, on a grid that the rate divides.
        noise_std: (n,) of the torque [N m].
    """
    parts = []
    for number, reading in enumerate(readings):
        rng = np.random.default_rng([logger.seed, number])
        fine = (reading.t[-1] - reading.t[0]) / (len(reading.t) - 1)
        every = round(1 / logger.rate_hz / fine)
        t, q, dq, tau = (x[::every] for x in (reading.t, reading.q, reading.dq, reading.tau))
        # As large in all as it is said to be, whatever its share at speed.
        usual = np.sqrt((reading.dq**2).mean(0))
        size = 1 + logger.grows * np.abs(dq) / np.maximum(usual, 1e-9)
        size = noise_std * size / np.sqrt((size**2).mean(0))
        tau = tau + size * noise(rng, tau.shape, logger.rate_hz, logger.colour_hz)
        tau = with_held_torque(tau, t, plan.held, number)
        tick = 2 * np.pi / 2**logger.encoder_bits
        # Bounded, so that stamps never go backwards.
        jitter = np.clip(rng.standard_normal(len(t)) * logger.jitter, -0.4, 0.4) / logger.rate_hz
        columns = {"t": t + jitter + logger.clock} | _numbered("q", np.round(q / tick) * tick)
        speed_noise = logger.velocity_noise * rng.standard_normal(dq.shape)
        if logger.own_velocity or plan.own_velocity:
            columns |= _numbered("dq", dq + speed_noise)
        columns |= _numbered("tau", tau)
        parts.append(columns | {"traj": np.full(len(t), number, dtype=np.int64)})
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def noise(
    rng: np.random.Generator, shape: tuple[int, int], rate: float, corner: float | None
) -> Array:
    """Unit noise (T, n): white, or a stationary first-order process with a corner [Hz]."""
    white = rng.standard_normal(shape)
    if corner is None:
        return white
    keep = float(np.exp(-2 * np.pi * corner / rate))
    begin = keep * rng.standard_normal((1, shape[1]))
    return np.asarray(lfilter([np.sqrt(1 - keep**2)], [1.0, -keep], white, axis=0, zi=begin)[0])


def _numbered(prefix: str, values: Array) -> dict[str, Array]:
    return {f"{prefix}{k + 1}": values[:, k] for k in range(values.shape[1])}
