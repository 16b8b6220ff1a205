"""What a case is made of, between its description and its simulation."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from torchid_bench.withheld.plant.arms import Arm
from torchid_bench.withheld.plant.bodies import Array
from torchid_bench.withheld.plant.model import Plant
from torchid_bench.withheld.plant.servo import Servos


@dataclass(frozen=True)
class EffectSpec:
    """An effect to plant, its size not yet known.

    Attributes:
        name: torchid's name of the effect, or one outside of torchid's library.
        joints: from 0, what it is at; empty for the whole arm.
        draws: numbers that say which variant it is; free of units, as far as they can be.
    """

    name: str
    joints: tuple[int, ...]
    draws: Mapping[str, float]


@dataclass(frozen=True)
class Signals:
    """What sensors would read at every instant of one trajectory, if they had no noise.

    Attributes:
        t: (T,) [s], on the log's clock.
        q, dq, ddq, tau: (T, n).
    """

    t: Array
    q: Array
    dq: Array
    ddq: Array
    tau: Array


@dataclass
class Live:
    """A running simulation, as effects see it: MuJoCo's own memory.

    Attributes:
        q, dq: of all degrees of freedom, motors and links.
        applied: torque to add to them, zero at the beginning of every step.
        friction, damping: of MuJoCo's model, which an effect may change as it runs.
        motors: (n,) degrees of freedom of the motors.
        command, kp, kd: of the controllers, u = command - kp q - kd dq.
        t: (T,) [s], on the log's clock.
        step: [s].
    """

    q: Array
    dq: Array
    applied: Array
    friction: Array
    damping: Array
    motors: Array
    command: Array
    kp: Array
    kd: Array
    t: Array
    step: float


Act = Callable[[int], None]
"""What an effect does before step k."""

Law = Callable[[Live], Act]
"""An effect with a state, started anew with every trajectory."""

Sensor = Callable[[Signals], Signals]
"""What sensors make of the truth."""

Push = Callable[[Array, int], Array]
"""Force (T, 3) at the tool [N] at the times (T,) of a trajectory since its beginning."""


@dataclass(frozen=True)
class Windows:
    """Windows in which the logger holds a joint's torque.

    Attributes:
        joint: from 0.
        windows: (begin, end) [s] since the trajectory's beginning, one list a trajectory.
    """

    joint: int
    windows: tuple[tuple[tuple[float, float], ...], ...]


@dataclass(frozen=True)
class Plan:
    """An arm with its effects, ready to be simulated.

    Attributes:
        plant: the true arm.
        known_damping, known_friction: (n,) what the nominal model knows of friction.
        replaced: joints whose known friction some effect replaces by another form of it.
        laws, sensors, push, held: of the effects.
        offset: (n,) true position minus what encoder and controller take it for [rad].
        own_velocity: whether the log must have velocities of its own.
        servos: that move it; None where its controllers are told torques.
    """

    plant: Plant
    known_damping: Array
    known_friction: Array
    replaced: tuple[int, ...] = ()
    laws: tuple[Law, ...] = ()
    sensors: tuple[Sensor, ...] = ()
    push: Push | None = None
    held: tuple[Windows, ...] = ()
    offset: Array | None = None
    own_velocity: bool = False
    servos: Servos | None = None


class Moving(Protocol):
    """A motion: how long it lasts [s], and where it is."""

    @property
    def seconds(self) -> float:
        """How long it lasts [s]."""

    def state(self, t: Array) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration (T, n) at times (T,); at rest outside."""


@dataclass(frozen=True)
class Scene:
    """What effects need to know of the motion and the arm to choose sensible numbers.

    Attributes:
        arm: as described.
        shapes: the different motions.
        order: which of them each trajectory follows.
        starts: when each trajectory begins [s], on the log's clock.
        noise: (n,) standard deviation of the torque noise [N m].
        torque: (n,) RMS of the nominal torque along the reference [N m].
        peak: (n,) its largest [N m].
        speed: (n,) 99 % of |dq| [rad/s].
        moving_rms, brisk_rms: (n,) RMS of dq and of ddq.
        travel: (n, 2) extremes of q [rad].
        inertia: (n, 2) extremes of the diagonal of the links' mass matrix [kg m^2].
        free_inertia: (n,) least inertia that a joint's motor feels while the others are free.
        load: (n,) nominal RMS torque that the joint carries without friction [N m].
        kp, kd: (n,) gains of the controllers.
    """

    arm: Arm
    shapes: tuple[Moving, ...]
    order: tuple[int, ...]
    starts: tuple[float, ...]
    noise: Array
    torque: Array
    peak: Array
    speed: Array
    moving_rms: Array
    brisk_rms: Array
    travel: Array
    inertia: Array
    free_inertia: Array
    load: Array
    kp: Array
    kd: Array

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.arm.n

    def unit(self, joint: int, rms: float, level: float = 5.0) -> float:
        """Coefficient at which a column of that RMS is `level` times the joint's noise."""
        return float(level * self.noise[joint] / max(rms, 1e-9))


Parameters = dict[str, Any]
"""Of an effect, in physical units, for the key."""


def sign(value: float) -> float:
    """1 or -1."""
    return float(np.copysign(1.0, value))
