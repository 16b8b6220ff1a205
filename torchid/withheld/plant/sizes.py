"""How large an effect is: what it changes in the gap, in standard deviations of the noise."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
from scipy.ndimage import uniform_filter1d

from torchid.errors import TorchidError
from torchid.withheld.plant.bodies import Array
from torchid.withheld.plant.catalogue import kind_named
from torchid.withheld.plant.plan import EffectSpec, Parameters, Plan, Scene, Signals
from torchid.withheld.plant.scene import Nominal, dry, low_passed, rms
from torchid.withheld.plant.sensing import hold
from torchid.withheld.plant.simulate import Trace, simulated

COARSE = 5e-4
"""Step of the simulations that find a scale [s]."""

_GRID = 0.004  # seconds between the instants of a gap
_CLOSE = 0.12  # a scale is found when the size is that close to the wanted one, as a share
_TRIES = 6  # simulations that look for a scale


@dataclass(frozen=True)
class Sized:
    """An effect at the scale that was found.

    Attributes:
        scale: of the effect.
        parameters: in physical units.
        size: (n,) RMS of what it changes in the gap, in standard deviations of the noise.
    """

    scale: float
    parameters: Parameters
    size: Array


def readings(plan: Plan, traces: Sequence[Trace]) -> list[Signals]:
    """What sensors without noise read, but for held torques, one a trajectory."""
    return [reduce(lambda x, sensor: sensor(x), plan.sensors, trace.truth) for trace in traces]


def gaps(plan: Plan, nominal: Nominal, traces: Sequence[Trace]) -> list[Array]:
    """Noise-free torque minus the nominal model's along the measured motion, below 20 Hz (T, n).

    Where the arm has the very dry friction that the nominal model knows, its actual torque is taken
    out; where an effect replaces it, Fc sign(dq), and at rest, where the sign says nothing, what
    resists, up to Fc.
    """
    out = []
    pairs = zip(traces, readings(plan, traces), strict=True)
    for number, (trace, reading) in enumerate(pairs):
        fine = float(reading.t[1] - reading.t[0])
        every = max(1, round(_GRID / fine))
        tau = hold(reading.tau, reading.t, plan.held, number)
        # One row of so many, of triangular means, which hold back what would be folded.
        tau, q, dq, ddq, friction, resistance = (
            uniform_filter1d(uniform_filter1d(x, every, axis=0), every, axis=0)[::every]
            for x in (tau, reading.q, reading.dq, reading.ddq, trace.friction, trace.resistance)
        )
        known = friction.copy()
        for joint in plan.replaced:
            direction, limit = dry(dq[:, joint]), plan.known_friction[joint]
            sticks = np.clip(resistance[:, joint], -limit, limit)
            known[:, joint] = limit * direction + (1 - np.abs(direction)) * sticks
        gap = tau - nominal.rigid(q, dq, ddq) - plan.known_damping * dq - known
        out.append(low_passed(gap, fine * every))
    return out


def size_of(scene: Scene, plan: Plan, nominal: Nominal, traces: Sequence[Trace]) -> Array:
    """RMS (n,) of the gap below 20 Hz, in standard deviations of the noise."""
    return rms(gaps(plan, nominal, traces)) / scene.noise


def planted(scene: Scene, plan: Plan, effect: EffectSpec, scale: float) -> tuple[Plan, Parameters]:
    """The plan with an effect at a scale."""
    return kind_named(effect.name).plant(scene, plan, effect, scale)


def sized(scene: Scene, base: Plan, nominal: Nominal, effect: EffectSpec, level: float) -> Sized:
    """The scale at which an effect alone has a wanted size, or the largest that it may have.

    Size grows about in proportion to the scale; where it does not, the last two tries say how.

    Args:
        scene, base, nominal: the arm without effects.
        effect: to plant.
        level: wanted size, the largest of all joints.

    Raises:
        TorchidError: the arm bears the effect at no size that was tried.
    """
    kind = kind_named(effect.name)
    largest = kind.largest(scene, effect)
    scale = min(largest, kind.usual(scene, effect) * level / 5.0)
    still: list[Trace] = []
    tried: list[Sized] = []
    for _ in range(_TRIES):
        plan, parameters = planted(scene, base, effect, scale)
        if kind.sensing:
            still = still or simulated(scene, base, nominal, COARSE)
            traces = still
        else:
            try:
                traces = simulated(scene, plan, nominal, COARSE)
            except TorchidError:
                # More than the controllers bear.
                largest = scale = 0.5 * scale
                continue
        size = size_of(scene, plan, nominal, traces)
        tried.append(Sized(scale, parameters, size))
        if abs(size.max() / level - 1) < _CLOSE:
            break
        following = _next(tried, level, largest)
        if abs(following / scale - 1) < 0.01:
            break
        scale = following
    if not tried:
        raise TorchidError(f"{effect.name} is more than the arm bears at any size.")
    return min(tried, key=lambda s: abs(np.log(s.size.max() / level)))


def _next(tried: Sequence[Sized], level: float, largest: float) -> float:
    """The next scale to try."""
    scales = [s.scale for s in tried[-2:]]
    sizes = [max(float(s.size.max()), 1e-6) for s in tried[-2:]]
    slope = 1.0
    if len(tried) > 1:
        rise = np.log(sizes[1] / sizes[0]) / np.log(scales[1] / scales[0])
        slope = float(np.clip(rise, 0.4, 3.0))
    step = float(np.clip((level / sizes[-1]) ** (1 / slope), 0.02, 30.0))
    return min(largest, scales[-1] * step)
