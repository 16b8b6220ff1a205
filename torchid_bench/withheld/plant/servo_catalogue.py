"""Every effect of a servo's drive that can be planted: like `catalogue`, for arms whose servos take
set-points. `s` is a size of about 1, `x` a number between 0 and 1 that says which variant."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from torchid_bench.withheld.plant.arms import Arm
from torchid_bench.withheld.plant.bodies import Array, Box
from torchid_bench.withheld.plant.catalogue import Kind, Plant, read_catalogue
from torchid_bench.withheld.plant.friction import Planted, with_plant
from torchid_bench.withheld.plant.model import Drive, Spring
from torchid_bench.withheld.plant.plan import EffectSpec, Plan
from torchid_bench.withheld.plant.servo import Moved, Servos


@dataclass(frozen=True)
class ServoScene:
    """An arm with plain servos, and how it moves without any effect.

    Attributes:
        arm: as described.
        plan: the arm with its servos.
        inertia: (n,) of joints with their rotors, in the middle [kg m^2].
        commands: (T, n) of each motion [rad].
        base: where they lead.
    """

    arm: Arm
    plan: Plan
    inertia: Array
    commands: list[Array]
    base: list[Moved]

    @property
    def servos(self) -> Servos:
        """Servos of the arm without effects."""
        assert self.plan.servos is not None
        return self.plan.servos

    def shown(self, values: Callable[[Moved], Array]) -> Array:
        """Something of all motions, one after the other."""
        return np.concatenate([values(m) for m in self.base])

    @property
    def torque(self) -> Array:
        """(n,) 99.9 % of the servos' torques [N m]."""
        return np.asarray(np.quantile(np.abs(self.shown(lambda m: m.torque)), 0.999, axis=0))

    def of(self, name: str) -> Array:
        """(n,) a number of the servos."""
        return self.servos.of(name, self.arm.n)

    def rates(self, order: int) -> Array:
        """(n,) 99.5 % of the speeds [rad/s] (1) or accelerations [rad/s^2] (2) of the motions."""
        size = np.abs(self.shown(lambda m: np.diff(m.q, order, axis=0)))
        return np.asarray(np.quantile(size, 0.995, axis=0)) * self.servos.rate_hz**order


Number = Callable[[ServoScene, int, float, float], float]
"""Of a scene, a joint, s and x."""


def _servo(**of: Number) -> Plant:
    """An effect that is numbers of the servos, on its joints or on all."""

    def plant(scene: ServoScene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
        assert plan.servos is not None
        joints = effect.joints or tuple(range(scene.arm.n))
        changed = {name: plan.servos.of(name, scene.arm.n).copy() for name in of}
        for name, value in of.items():
            for j in joints:
                changed[name][j] = value(scene, j, s, effect.draws["variant"])
        servos = replace(plan.servos, values={**plan.servos.values, **changed})
        numbers = {name: float(value[joints[0]]) for name, value in changed.items()}
        return replace(plan, servos=servos), numbers

    return plant


def _way(x: float) -> float:
    return 1.0 if x > 0.5 else -1.0


def _variant(effect: EffectSpec, s: float) -> dict[str, float]:
    """What a key says of an effect whose numbers are the arm's."""
    return {"size": s, **effect.draws}


def _stop(scene: ServoScene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """An end that one side of the motions reaches."""
    (j,) = effect.joints
    q = scene.shown(lambda m: m.q[:, j])
    middle, reach = np.median(q), min(0.18 * s, 0.7)
    low, high = q.min() - 1.0, q.max() + 1.0
    if effect.draws["variant"] > 0.5:
        high = q.max() - reach * (q.max() - middle)
    else:
        low = q.min() + reach * (middle - q.min())
    return with_plant(plan, stops={j: (float(low), float(high))}), _variant(effect, s)


def _floor(scene: ServoScene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """A plane that the tool reaches for a small part of the time."""
    share = min(0.02 * s * (1 + effect.draws["variant"]), 0.2)
    height = float(np.quantile(scene.shown(lambda m: m.tool), share))
    return with_plant(plan, floor=height), _variant(effect, s)


def _drive(
    stiff: Callable[[float, float], float], play: Callable[[float, float], float] | None = None
) -> Plant:
    """The rotor before a spring of so many times the servo's gain, with or without play, and the
    link behind it; the encoder is the rotor's."""

    def plant(scene: ServoScene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
        (j,), x = effect.joints, effect.draws["variant"]
        stiffness = stiff(s, x) * float(scene.of("kp")[j])
        link = (scene.inertia - scene.plan.plant.armature)[j]
        damping = 0.4 * float(np.sqrt(stiffness * link))
        drive = Drive(j, 0.0, stiffness, damping, play(s, x) if play else 0.0)
        return with_plant(plan, drives=(drive,)), _variant(effect, s)

    return plant


def _payload(scene: ServoScene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """A box at the tool, a share of the last link's mass."""
    body = Box(1.0, (0.06, 0.06, 0.06), scene.arm.tool).inertial()
    last = plan.plant.links[-1].body.mass
    factor = 0.4 * s * (1 + effect.draws["variant"]) * last / body.mass
    heavy = replace(body, mass=body.mass * factor, inertia=body.inertia * factor)
    return with_plant(plan, payload=heavy), {"mass": float(heavy.mass)}


def _cable(scene: ServoScene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """A spring that is at rest at one end of the motions."""
    (j,) = effect.joints
    q = scene.shown(lambda m: m.q[:, j])
    rest = float(q.min() if effect.draws["variant"] > 0.5 else q.max())
    spring = Spring(j, 0.05 * s * float(scene.of("kp")[j]), rest)
    return with_plant(plan, springs=(spring,)), _variant(effect, s)


def _effort(share: float) -> Number:
    """A torque that makes so many radians of position error."""
    return lambda scene, j, s, x: share * s * (0.7 + 0.6 * x) * float(scene.of("kp")[j])


# Of a servo's number on joint j in a scene c, by size and variant.
_PLANTS: dict[str, Plant] = {
    "command_delay": _servo(delay=lambda c, j, s, x: 1 / c.servos.rate_hz + s * (0.02 + 0.03 * x)),
    "set_point_profile": _servo(
        acceleration=lambda c, j, s, x: (0.3 + 0.4 * x) / s * float(c.rates(2)[j])
    ),
    "set_point_speed": _servo(speed=lambda c, j, s, x: (0.3 + 0.3 * x) / s * float(c.rates(1)[j])),
    "command_gain": _servo(
        scale=lambda c, j, s, x: 1 + s * _way(x) * (0.04 + 0.08 * abs(2 * x - 1))
    ),
    "derivative_gain": _servo(
        kd=lambda c, j, s, x: s * (0.4 + 0.6 * x) * float(c.plan.plant.damping[j])
    ),
    "saturation": _servo(clip=lambda c, j, s, x: (0.4 + 0.3 * x) / s * float(c.torque[j])),
    "dead_zone": _servo(dead_zone=lambda c, j, s, x: s * (0.004 + 0.008 * x)),
    "torque_offset": _servo(
        offset=lambda c, j, s, x: _way(x) * 0.012 * s * (1 + x) * float(c.of("kp")[j])
    ),
    "stribeck_friction": _servo(
        stiction=_effort(0.008), stribeck_speed=lambda c, j, s, x: 0.02 + 0.06 * x
    ),
    "load_dependent_friction": _servo(load_share=lambda c, j, s, x: s * (0.2 + 0.2 * x)),
    "motor_dependent_friction": _servo(motor_share=lambda c, j, s, x: s * (0.15 + 0.2 * x)),
    "load_dependent_stribeck": _servo(
        stiction_share=lambda c, j, s, x: s * (0.2 + 0.2 * x),
        stribeck_speed=lambda c, j, s, x: 0.1 + 0.4 * x,
    ),
    "end_stop": _stop,
    "plane_contact": _floor,
    "payload": _payload,
    "integral_action": _servo(integral=lambda c, j, s, x: s * (0.5 + x) * float(c.of("kp")[j])),
    "command_filter": _servo(lag=lambda c, j, s, x: s * (0.05 + 0.05 * x)),
    "backlash": _drive(lambda s, x: 20.0, lambda s, x: s * (0.02 + 0.03 * x)),
    "elasticity": _drive(lambda s, x: (2 + 2 * x) / s),
    "supply_sag": _servo(sag=lambda c, j, s, x: s * (0.2 + 0.3 * x) / c.torque.sum()),
    "fading_gain": _servo(fade=lambda c, j, s, x: min(s * (0.2 + 0.2 * x), 0.7)),
    "warming_friction": _servo(
        coulomb=lambda c, j, s, x: (1 + s) * float(c.of("coulomb")[j]),
        heating=lambda c, j, s, x: 0.5 + 0.4 * x,
    ),
    "nonlinear_gain": _servo(hardening=lambda c, j, s, x: s * (4.0 + 8.0 * x)),
    "cable": _cable,
    "dropped_commands": _servo(dropped=lambda c, j, s, x: min(s * (0.2 + 0.2 * x), 0.8)),
    "late_positions": _servo(late=lambda c, j, s, x: s * (0.02 + 0.04 * x)),
    "cogging": _servo(cogging=_effort(0.01), teeth=lambda c, j, s, x: round(8 + 16 * x)),
}

SERVO_KINDS = {
    name: Kind(plant=_PLANTS[name], **own)
    for name, own in read_catalogue("servo_catalogue.yaml").items()
}
"""By name, as servo_catalogue.yaml has them."""
