"""What a log's rate allows before it is cut into segments: its bands, and the direction of motion.

Columns that jump are evaluated in the wide band, from the sharpest direction of motion that is not
yet noise; they are fitted in the narrow one.
"""

import math
from collections.abc import Sequence

import torch

from torchid.design.motion import HARDLY, Measurement, direction, fast_speed
from torchid.design.segments import Samples, Segment, widened
from torchid.dynamics.forward import mass_matrix
from torchid.errors import LogError
from torchid.log.model import Log
from torchid.robot.model import Robot
from torchid.statistics.robust import robust_std, white_variance
from torchid.typing import Float, Tensor

CUTOFF = 8.0
"""Default cut-off [Hz]. Higher ones let in columns that differentiate again (elasticity, backlash)
and share the encoder's noise with the residual."""

WIDE_BAND = 40.0
"""Band [Hz] of the motion from which columns are computed, at the default cut-off."""

ATTENUATED = 0.01
"""Share of the torque's variance that may be noise of the positions, twice differentiated. Noise in
a column shrinks its coefficient by its share: here by 1 %, which is no torque worth a name."""


DWELL = 0.2
"""Time below the reversal speed from which a joint counts as dwelling [s]."""


def position_noise(log: Log, robot: Robot) -> Float[Tensor, " n"]:
    """Noise that the positions bring into the model's torque, which differentiates them twice.

    It is taken to be white at the level S that the positions' spectra end with. Through M(q) its
    variance below a frequency f is S M^2 (2 pi)^4 f^5 / 5.

    Args:
        log: on a uniform grid.
        robot: whose inertia it is; of one without parameters nothing is known, and zero returned.

    Returns:
        (n,) standard deviation below 1 Hz; it grows with f^2.5 [N m; N].
    """
    if robot.parameters is None:
        return torch.zeros(robot.n, dtype=torch.float64)
    level = log.noise_density.clone()
    # A base goes far while its noise is small: what its spectrum ends with is leakage.
    for k in robot.free:
        noise = (
            (rows.stop - rows.start) / log.samples * white_variance([log.q[rows, k]]) * 2 / rate
            for rows, rate in zip(log.slices(), log.rates, strict=True)
        )
        level[k] = sum(map(float, noise))
    # Inertia in some postures.
    mass = mass_matrix(robot, log.q[:: max(1, log.samples // 50)].double()).square().mean(0)
    return ((mass @ level) * (2 * math.pi) ** 4 / 5).sqrt()


def resolved(log: Log, noise: Float[Tensor, " n"], free: Sequence[int] = ()) -> float:
    """Highest frequency [Hz] up to which the log resolves the model's torque on every joint that
    slides: below it, `position_noise` makes up no more than `ATTENUATED` of the torque's variance.

    Args:
        log: on a uniform grid, with torque.
        noise: (n,) of the positions, below 1 Hz [N m; N].
        free: coordinates (from 0) that no motor drives: there is no torque to be resolved.
    """
    # How much of the time each joint moves, over steps that its noise does not reach.
    moving, least = torch.zeros_like(noise), log.moving_speed
    for rows, rate in zip(log.slices(), log.rates, strict=True):
        q, step = log.q[rows], max(1, round(DWELL * rate))
        moving += ((q[step:] - q[:-step]).abs() > least * step / rate).sum(0) / log.samples
    slides = (moving >= HARDLY) & (noise > 0)
    slides[list(free)] = False
    if log.tau is None or not bool((slides := slides & log.tau.any(0)).any()):
        return math.inf
    highest = (ATTENUATED * log.tau.double().var(0) / noise.square()) ** 0.2
    # 2.0: cut-off below which little is left of a motion [Hz], whatever the positions' noise
    return max(2.0, float(highest[slides].min()))


def bands(log: Log, cutoff: float | None, highest: float = math.inf) -> tuple[float, float]:
    """Cut-off and wide band [Hz] that the log allows: by default 8 Hz or what positions resolve,
    if that is less, and five times as much.

    Raises:
        LogError: trajectories at different rates, or a cut-off that the log cannot hold.
    """
    rates = log.rates
    rate = min(rates)
    # 0.02: relative difference of two sampling rates that count as one
    if max(rates) > (1 + 0.02) * rate:
        listed = ", ".join(f"{n} {r:.4g} Hz" for n, r in zip(log.names, rates, strict=True))
        raise LogError(
            "the logs have different sampling rates.",
            got=listed,
            expected="one rate",
            hint="diagnose them one by one, or resample them to the lowest rate",
        )
    chosen = min(CUTOFF, rate / 6, highest) if cutoff is None else cutoff
    if chosen > 0.4 * rate:
        raise LogError(
            "the cut-off is outside the log's band.",
            got=f"{chosen:g} Hz",
            expected=f"below {0.4 * rate:.4g} Hz at {rate:.4g} Hz",
        )
    return chosen, min(max(WIDE_BAND / CUTOFF * chosen, 20.0), 0.4 * rate)


def sharp_direction(s: Segment, threshold: Float[Tensor, " n"]) -> Float[Tensor, "T n"]:
    """Direction of motion (T, n), from -1 to 1.

    Where a joint turns without stopping, the mean of its sign over a sampling interval, which puts
    the reversal between two samples where it belongs; where it dwells (slower than the threshold
    for more than `DWELL`), the direction it came from: velocity noise is no motion.
    """
    dq, ddq = s.motion.dq, s.motion.ddq
    turning = (dq / (ddq.abs() * 0.5 / s.rate).clamp(min=1e-12)).clamp(-1, 1)
    slow = (dq.abs() < threshold).double()
    inner = 1 - widened(1 - slow, 0.5 * DWELL * s.rate)
    dwells = widened(inner, 0.5 * DWELL * s.rate) > 0.5
    return torch.where(dwells, direction(dq, threshold).to(dq), turning)


def reversal_speed(measured: list[Measurement]) -> Float[Tensor, " n"]:
    """Speed (n,) that is neither noise nor much of the joint's own: four standard deviations of
    the velocity's noise, taken from its fastest changes, or 0.4 % of its 99 % speed."""
    speed = fast_speed(measured)
    # A long trajectory's beginning has as much noise as the rest.
    # 1_000_000: samples of a trajectory that tell the noise of its velocity
    begun = [m.motion.part(slice(0, 1_000_000)) for m in measured]
    rough = torch.cat([motion.dq.diff(dim=0).diff(dim=0) for motion in begun])
    noise = robust_std(rough.T) / math.sqrt(6.0)
    # 0.004: speed at which a reversal counts, as a fraction of the joint's 99 % speed; noise can
    # raise it
    return torch.maximum(0.004 * speed, torch.minimum(4 * noise, 0.05 * speed))


def report_band(samples: Samples, wanted: float) -> float:
    """Band of the report [Hz]: wider than the fit's, as far as the segments go."""
    return max(samples.cutoff, min(wanted, 0.8 * samples.segments[0].band))
