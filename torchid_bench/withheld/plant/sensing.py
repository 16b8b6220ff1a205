"""Effects of what is measured: how each is planted at a scale."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import butter, sosfilt, sosfilt_zi

from torchid_bench.withheld.plant.bodies import Array
from torchid_bench.withheld.plant.friction import Planted
from torchid_bench.withheld.plant.plan import EffectSpec, Plan, Scene, Signals, Windows, sign

_KNEE = 0.02  # of the limit: width of the knee where a reading begins to clip


def gain(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """A joint's torque is read with a wrong scale."""
    joint, error = effect.joints[0], s * sign(effect.draws["direction"])
    return _reading(plan, joint, lambda x, t: x[:, joint] * (1 + error)), {"gain": error}


def crosstalk(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """A joint's torque sensor also reads some of another joint's torque."""
    joint, source = effect.joints[0], int(effect.draws["source"])
    share = s * sign(effect.draws["direction"])
    plan = _reading(plan, joint, lambda x, t: x[:, joint] + share * x[:, source])
    return plan, {"C": share, "source_joint": source + 1}


def delay(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """A joint's torque is read late."""
    joint = effect.joints[0]
    late = _reading(plan, joint, lambda x, t: np.interp(t - s, t, x[:, joint]))
    return late, {"delay": s}


def saturation(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """The reading of a joint's torque ends at a limit, 1 - s of its peak, with a soft knee.

    The motor's torque is not clipped: where a drive that clips reads its own current, the log and
    the motion agree and there is no gap.
    """
    joint = effect.joints[0]
    limit = (1 - s) * float(scene.peak[joint])
    half = _KNEE * limit

    def clipped(tau: Array, t: Array) -> Array:
        size = np.abs(tau[:, joint])
        over = np.clip(size - limit + half, 0.0, 2 * half)
        # Above limit + half nothing comes through; in the knee the slope falls from 1 to 0.
        inside = np.minimum(size, limit - half) + over - over**2 / (4 * half)
        return np.sign(tau[:, joint]) * inside

    return _reading(plan, joint, clipped), {"limit": limit}


def velocity_lag(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """The controller's velocities come through a causal second-order low-pass that is s late."""
    cutoff = np.sqrt(2) / (2 * np.pi * s)  # group delay of a Butterworth filter at low frequencies

    def lagging(signals: Signals) -> Signals:
        step = float(signals.t[1] - signals.t[0])
        sections = butter(2, min(cutoff, 0.45 / step), fs=1 / step, output="sos")
        begin = sosfilt_zi(sections)[..., None] * signals.dq[0]
        dq = sosfilt(sections, signals.dq, axis=0, zi=begin)[0]
        return replace(signals, dq=dq, ddq=np.gradient(dq, step, axis=0))

    plan = replace(plan, sensors=(*plan.sensors, lagging), own_velocity=True)
    return plan, {"lag": s, "cutoff_hz": float(cutoff)}


def encoder_offset(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """Encoder and controller take a joint for s less than where it is."""
    value = s * sign(effect.draws["direction"])
    offset = np.zeros(scene.n) if plan.offset is None else plan.offset.copy()
    offset[effect.joints[0]] += value
    return replace(plan, offset=offset), {"offset": value}


def dropped(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """The logger holds a joint's torque in windows of s seconds on average."""
    rng = np.random.default_rng(int(effect.draws["seed"]))
    windows = []
    for shape in scene.order:
        seconds = scene.shapes[shape].seconds
        count = max(1, round(effect.draws["rate"] * seconds))
        begins = np.sort(rng.uniform(0.5, seconds - 0.5, count))
        lengths = s * rng.uniform(0.5, 1.5, count)
        pairs = zip(begins.tolist(), (begins + lengths).tolist(), strict=True)
        windows.append(tuple(pairs))
    held = (*plan.held, Windows(effect.joints[0], tuple(windows)))
    parameters = {"rate": effect.draws["rate"], "mean_length": s}
    return replace(plan, held=held), parameters


def contact(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """The tool pushes with s newtons in a window, rising and falling like a half sine."""
    draws = effect.draws
    direction = np.array([draws["x"], draws["y"], draws["z"]])
    direction = direction / np.linalg.norm(direction)
    where = int(draws["trajectory"]) % len(scene.order)
    begin = draws["begin"] * scene.shapes[scene.order[where]].seconds
    ramp, seconds = 0.1, draws["seconds"]
    old = plan.push

    def push(t: Array, number: int) -> Array:
        force = np.zeros((len(t), 3)) if old is None else old(t, number)
        if number != where:
            return force
        inside = np.clip(np.minimum(t - begin, begin + seconds - t) / ramp, 0, 1)
        return force - np.sin(inside * np.pi / 2)[:, None] ** 2 * s * direction

    force = dict(zip(("fx", "fy", "fz"), (s * direction).tolist(), strict=True))
    start = scene.starts[where] + begin
    return replace(plan, push=push), {**force, "start": start, "stop": start + seconds}


def with_held_torque(tau: Array, t: Array, held: Sequence[Windows], number: int) -> Array:
    """Torque (T, n) of a trajectory of which joints are held at their last value before each of
    their windows; t (T,) begins anywhere [s]."""
    out, since = tau.copy(), t - t[0]
    for own in held:
        read = out[:, own.joint].copy()
        for begin, end in own.windows[number]:
            inside = np.flatnonzero((since >= begin) & (since < end))
            out[inside, own.joint] = read[inside[:1]]
    return out


def _reading(plan: Plan, joint: int, read: Callable[[Array, Array], Array]) -> Plan:
    """The plan with a joint's torque read as a function of all torques and of time."""

    def sensor(signals: Signals) -> Signals:
        tau = signals.tau.copy()
        tau[:, joint] = read(signals.tau, signals.t)
        return replace(signals, tau=tau)

    return replace(plan, sensors=(*plan.sensors, sensor))
