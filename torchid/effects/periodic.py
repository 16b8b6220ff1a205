"""Torque that repeats along the joint's travel."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchid.digits import number
from torchid.effects.base import Coefficient, Columns, Example, JointEffect, Motion
from torchid.effects.c_text import add
from torchid.effects.parameters import Shape, travel
from torchid.typing import Float, Joints


@dataclass(frozen=True)
class Wave(JointEffect):
    """An effect with one wave number k along the joint's own position, in sine and cosine.

    Over a travel L two waves are alike to sinc((k - k') L/2). So wave numbers half a period apart
    over the travel, pi/L, leave no wave further than pi/(2 L) from the grid, where it still has
    90 % of the wave there; a period apart they would leave it 64 %, and the search would go past
    it. The spacing does not depend on k: a shorter grid is one that ends at a lower wave number.

    Class attributes:
        first: wave number the grid begins at, in half periods over the travel.
        most: wave numbers of the grid.
        c_wave: the torque as C, of the `wave` and the number of the `joint`.

    Attributes:
        k: wave number [1/rad; 1/m], periods of the wave times 2 pi a unit of travel.
    """

    k: float = 12.0

    first: ClassVar[int]
    most: ClassVar[int]
    c_wave: ClassVar[str] = "{wave}"

    @classmethod
    def grid(cls, motions: Sequence[Motion], joint: int, cutoff: float) -> Float[Tensor, "S 1"]:
        """Wave numbers that the motions resolve: half a period apart over the joint's travel, up to
        where the wave leaves the band at half the usual speed; none on a joint that rests."""
        along = travel(motions, joint)
        if along < 1e-3:
            return torch.empty(0, 1, dtype=torch.float64)
        step = math.pi / along
        speed = torch.cat([m.dq[:, joint] for m in motions]).abs().median()
        highest = 2 * math.pi * cutoff / max(1e-6, 0.5 * float(speed))
        count = max(0, min(cls.most, int(highest / step) - cls.first + 1))
        return (step * (cls.first + torch.arange(count, dtype=torch.float64))).unsqueeze(-1)

    def finer(
        self, motions: Sequence[Motion], level: int, cutoff: float
    ) -> Float[Tensor, "S 1"] | None:
        """Wave numbers around its own, within half a period over the travel, a third of it, ..."""
        grid = self.grid(motions, self.joint, cutoff).flatten()
        step = float(grid[1] - grid[0]) if len(grid) > 1 else 1.0
        return self.shapes[0].around(self.k, level, 1.0, step).unsqueeze(-1)

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Columns:
        """sin kq and cos kq of every joint, times the carrier; shapes: k."""
        phase = shapes[0] * motion.q
        wave = torch.stack((torch.sin(phase), torch.cos(phase)), -1)
        carrier = cls.carrier(motion)
        return wave if carrier is None else carrier.unsqueeze(-1) * wave

    @property
    def of_speed(self) -> bool:
        """Never: it is a curve of the position."""
        return False

    @classmethod
    def carrier(cls, motion: Motion) -> Joints | None:
        """What the wave is a share of (..., n); None for a wave that is torque itself."""
        return None

    def c_code(self, values: Sequence[float]) -> list[str]:
        """The equation as C."""
        phase = f"{number(self.k)} * q[{self.joint}]"
        wave = f"{number(values[0])} * sin({phase}) + {number(values[1])} * cos({phase})"
        return add(self.joint, self.c_wave.format(wave=wave, joint=self.joint))


def _amplitudes(unit: str, meaning: str, largest: float = math.inf) -> tuple[Coefficient, ...]:
    """The coefficients of a wave's sine and cosine."""
    waves = {"a_s": "sine", "a_c": "cosine"}.items()
    return tuple(Coefficient(a, unit, False, meaning.format(w), largest) for a, w in waves)


def _wave_number(
    low: float,
    high: float,
    grid: tuple[float, ...],
    meaning: str = "wave number along the position",
) -> tuple[Shape, ...]:
    """The one shape of a wave, refined in differences."""
    return (Shape("k", "1/rad", low, high, grid, meaning, logarithmic=False),)


@dataclass(frozen=True)
class Cogging(Wave):
    """A ripple along the position: a_s sin kq + a_c cos kq.

    k is a count of poles, teeth or slots a turn of the joint: gear ratio times pole pairs, twice
    the gear ratio for a harmonic drive's wave generator, and their multiples. Two wave numbers
    closer than 2 pi / travel cannot be told apart, so k is refined in differences. At k = 1 it
    equals `joint_spring` of a counterbalance; so its grid begins at one and a half periods.

    Attributes:
        k: wave number [1/rad; 1/m], periods of the ripple times 2 pi a unit of travel.
    """

    name = "cogging"
    family = "periodic"
    branch = "transmission"
    over_position = True
    coefficients = _amplitudes("N m", "amplitude of the ripple's {}")
    shapes = _wave_number(
        0.5, 1000.0, (2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 60.0)
    )
    first = 3
    most = 120
    gloss = "torque that ripples over position"
    meaning = (
        "Magnets pull towards slots, and gear teeth mesh unevenly: torque ripples with position."
    )
    equation = "a_s sin(k q) + a_c cos(k q)"
    signature = "a line in the residual's spectrum over the angle"
    experiment = "run the joint at two constant slow speeds"
    remedy = (
        "Add the ripple as a table over position, or cancel it by the drive's cogging compensation."
    )
    source = (
        "Holtz and Springob 1996, Identification and compensation of torque ripple in "
        "high-precision permanent magnet motor drives (IEEE Trans. Ind. Electron. 43)"
    )
    example = Example((0.6, 0.3), "position")


@dataclass(frozen=True)
class MotorRipple(Wave):
    """A ripple of the motor's torque constant: tau (a_s sin kq + a_c cos kq).

    The motor gives a little more torque at some angles of its rotor than at others, in proportion
    to the torque asked of it, so the ripple is large where the joint carries much and nothing where
    it carries nothing. k is the gear ratio times a harmonic of the motor's turn: the first of a
    current sensor's offset or an eccentric rotor, twice the pole pairs of unequal phase gains, six
    times the pole pairs of harmonics in the flux.

    The grid ends 20 periods over the travel: a motor of a higher ratio shows on a short travel, or
    is to be given by its wave number.

    Attributes:
        k: wave number [1/rad; 1/m], gear ratio times harmonic.
    """

    name = "motor_ripple"
    family = "periodic"
    branch = "transmission"
    needs = frozenset({"torque"})
    coefficients = _amplitudes("1", "ripple's {}, as a share of the torque", 0.5)
    shapes = _wave_number(
        0.5, 1000.0, (4.0, 8.0, 16.0, 30.0, 50.0, 80.0, 100.0), "gear ratio times harmonic"
    )
    first = 3
    most = 40
    c_wave = "loaded[{joint}] * ({wave})"
    meaning = (
        "The motor's torque constant varies along its turn, so torque ripples in proportion to the "
        "load."
    )
    equation = "tau (a_s sin(k q) + a_c cos(k q))"
    signature = "a line in the residual's spectrum over the angle, as high as the joint's torque"
    experiment = "run the joint at a constant slow speed with and without a load"
    remedy = (
        "Scale the simulator's torque by 1 plus the ripple over the angle, or calibrate the "
        "drive's current sensors and commutation."
    )
    source = (
        "Jahns and Soong 1996, Pulsating torque minimization techniques for permanent magnet AC "
        "motor drives: a review (IEEE Trans. Ind. Electron. 43)"
    )
    example = Example((0.05, 0.02), "position", {"k": 30.0})

    @classmethod
    def carrier(cls, motion: Motion) -> Joints:
        """The model's torque."""
        return motion.require("torque", cls.name)


@dataclass(frozen=True)
class PositionDependentFriction(Wave):
    """Dry friction that is uneven along the turn: sgn(dq) (a_s sin kq + a_c cos kq).

    An eccentric gear or a bent shaft presses harder at some angles than at others, once or a few
    times a turn of the joint or of a stage of its gear. Added to `coulomb_friction`, which is its
    mean: less than a period over the travel has a mean of its own and would stand for it, so the
    grid begins at a whole one. Unlike a ripple it turns with the direction of motion, so low wave
    numbers are not mistaken for gravity or a spring.

    Attributes:
        k: wave number [1/rad; 1/m]; 1 is once a turn of the joint.
    """

    k: float = 1.0

    name = "position_dependent_friction"
    family = "sign"
    branch = "friction"
    detail = "varies with position"
    jumps = True
    coefficients = _amplitudes("N m", "unevenness of the friction, {}")
    shapes = _wave_number(0.1, 100.0, (0.5, 1.0, 2.0, 3.0, 4.0, 6.0))
    first = 2
    most = 12
    c_wave = "sign(dq[{joint}]) * ({wave})"
    meaning = (
        "Eccentric gears and bent shafts press harder at some angles, so friction is uneven along "
        "the turn."
    )
    equation = "sgn(dq) (a_s sin(k q) + a_c cos(k q))"
    signature = "a step at reversals whose height depends on where the joint turns"
    experiment = "run the joint slowly along its whole travel, there and back"
    remedy = (
        "Make the simulator's dry friction a table over position, or align and regrease the gear."
    )
    source = (
        "Armstrong-Helouvry 1991, Control of Machines with Friction (position-dependent friction "
        "of the PUMA 560's gears)"
    )
    example = Example((0.8, 0.5), "position", {"k": 3.0})

    def finer(
        self, motions: Sequence[Motion], level: int, cutoff: float
    ) -> Float[Tensor, "S 1"] | None:
        """As of waves, none with less than a period over the travel."""
        near, grid = super().finer(motions, level, cutoff), self.grid(motions, self.joint, cutoff)
        return (
            near if near is None or not len(grid) else near.clamp(min=min(self.k, float(grid[0])))
        )

    @classmethod
    def carrier(cls, motion: Motion) -> Joints:
        """The direction of motion."""
        return motion.sign
