"""Effects of some instants only: torque that clips, contact, and samples that were held."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import torch
from torch import Tensor

from torchid.digits import number
from torchid.effects.base import (
    Coefficient,
    Columns,
    Effect,
    Example,
    JointEffect,
    ModelEffect,
    Motion,
    Shape,
)
from torchid.effects.c_text import add
from torchid.effects.instants import interval, shifted
from torchid.effects.variation import ArmCoefficient, OneJointEffect, needed, on_joint, with_joint
from torchid.robot.jacobian import point_of_link, tool_jacobian
from torchid.robot.model import Robot
from torchid.typing import Float

RAMP = 0.05
"""Seconds in which a contact force comes and goes."""


@dataclass(frozen=True)
class Saturation(JointEffect):
    """The measured torque clips at a limit; 1 for a hard clip, less where only some is lost.

    Attributes:
        limit: where it clips [N m or N].
    """

    limit: float

    name = "saturation"
    family = "transient"
    branch = "sensing"
    needs = frozenset({"torque"})
    coefficients = (
        Coefficient(
            "clip", "1", True, "share of the torque beyond the limit that is lost, 0 to 1", 1.2
        ),
    )
    shapes = (
        Shape(
            "limit",
            "N m",
            0.1,
            1.2,
            (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98),
            "torque beyond which the reading clips",
            scale="torque",
        ),
    )
    meaning = "The torque sensor, or the drive's current reading, ends at a limit."
    equation = "-clip max(|tau| - limit, 0) sgn(tau)"
    signature = "peaks of the torque are missing"
    experiment = "repeat the motion at half the torque"
    beyond = experiment
    remedy = "Leave out samples at the limit, or keep the torque below it."
    source = "Khalil 2002, Nonlinear Systems, section 1.2.7 (saturation)"
    example = Example((1.0,), "time", {"limit": 40.0})
    by_motion = False

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Columns:
        """Minus the excess over the limit, -(|tau| - limit)+ sign(tau)."""
        (limit,) = shapes
        torque = motion.require("torque", cls.name)
        excess = (torque.abs() - limit).clamp(min=0)
        return -(excess * torch.sign(torque)).unsqueeze(-1)

    def measured(
        self, motion: Motion, values: Sequence[float], robot: Robot | None = None
    ) -> Motion:
        """The joint's torque, clipped."""
        torque = motion.require("torque", self.name)
        return motion._replace(torque=torque + self.torque_columns(motion)[..., 0] * values[0])

    def c_code(self, values: Sequence[float]) -> list[str]:
        """The equation as C."""
        torque = f"loaded[{self.joint}]"
        excess = f"fmax(fabs({torque}) - {number(self.limit)}, 0.0)"
        return add(self.joint, f"{number(-values[0])} * {excess} * sign({torque})")


@dataclass(frozen=True)
class DriveSaturation(Saturation):
    """Above a knee only a part of the motor's current becomes torque: iron saturates, or a drive
    limits the torque that it does not measure. The log says more than acts.

    Attributes:
        limit: torque at the knee [N m or N].
    """

    name = "drive_saturation"
    coefficients = (
        Coefficient(
            "excess", "1", True, "torque logged beyond the knee over torque that acts, less 1", 10.0
        ),
    )
    meaning = "Above a knee the current's torque constant falls, so the log says more than acts."
    equation = "excess max(|tau| - limit, 0) sgn(tau)"
    signature = "peaks of the logged torque are too high"
    remedy = "Keep the torque below the knee, or use a torque curve of the current."
    source = (
        "Vas 1990, Vector Control of AC Machines (magnetic saturation); Khalil 2002, Nonlinear "
        "Systems, section 1.2.7"
    )

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Columns:
        """The excess over the knee, (|tau| - limit)+ sign(tau)."""
        return -super().formula(motion, *shapes)

    def c_code(self, values: Sequence[float]) -> list[str]:
        """The equation as C."""
        return super().c_code([-values[0]])


@dataclass(frozen=True)
class Contact(ModelEffect):
    """The tool, or a link, pushes on something with a constant force, all the time or in a window.

    Torque J' F, which comes and goes within 0.05 s at the ends of the window. The force is the one
    that the arm exerts; the surroundings push back with its opposite. A joint behind the link feels
    nothing of it, and that tells where on the arm it is (Haddadin et al. 2017, section V).

    Attributes:
        start, stop: window [s] on the motion's clock; None where it has no such end.
        tip: the end of the robot that pushes, or the link, by its name; None for the only end.
        along: where on that link: 0 at its own joint, 1 at the next one; None for an end.
    """

    start: float | None = None
    stop: float | None = None
    tip: str | None = None
    along: float | None = None

    name = "contact"
    family = "transient"
    branch = "surroundings"
    needs = frozenset({"robot", "t"})
    coefficients = tuple(
        ArmCoefficient(
            f"f{a}", "N", False, f"force of the arm on its surroundings, base {a}", 2000.0
        )
        for a in "xyz"
    )
    meaning = "The tool or a link touches or drags something, or a cable pulls at it."
    equation = "J(q)' (fx, fy, fz) between start and stop"
    signature = "on all joints at once, in a window of time, in proportion to the tool's lever arms"
    experiment = "repeat the motion away from obstacles"
    beyond = experiment
    remedy = "Exclude this window of the log, and clear the path."
    source = (
        "Haddadin, De Luca and Albu-Schaeffer 2017, Robot collisions: a survey on detection, "
        "isolation, and identification, IEEE Trans. Robotics 33(6), eq. 5"
    )
    example = Example((0.0, 0.0, -30.0), "time", {"start": 4.0, "stop": 5.0})
    event = True
    windowed = True
    by_motion = False

    def torque_columns(self, motion: Motion, robot: Robot | None = None) -> Columns:
        """J' of the position of the point that pushes, in the window (T, n, 3)."""
        arm, tip = needed(robot, self.name), self.tip
        point = tip if self.along is None else point_of_link(arm, tip or "", self.along)
        columns = tool_jacobian(arm, motion.q, point)[..., :3, :].mT
        if self.start is None and self.stop is None:
            return columns
        return columns * self.window(motion.require("t", self.name))[:, None, None].to(columns)

    @property
    def identity(self) -> tuple[str, tuple[int, ...]]:
        """Name and second of its start: contacts at different times are different."""
        name = self.name if self.tip is None else f"{self.name} of {self.tip}"
        return name, () if self.start is None else (round(self.start),)

    @property
    def lasting(self) -> "Contact":
        """This push without a window."""
        return replace(self, start=None, stop=None)

    @property
    def span(self) -> tuple[float, float] | None:
        """The contact's window [s], where it has both ends."""
        return None if self.start is None or self.stop is None else (self.start, self.stop)

    @property
    def point(self) -> str:
        """`at 40% of the way along 'link_4', `; empty of an arm's only end."""
        place = "" if self.along is None else f"{self.along:.0%} of the way along "
        return "" if self.tip is None else f"at {place}'{self.tip}', "

    def around(self, level: int, interval: float) -> "list[Contact]":
        """Contacts whose window begins and ends a little earlier or later, or that act a little
        further along their link, ever less so with `level`: a fifth of the window at 0, but at
        least an interval, half of that at 1, ..., and a quarter of the link. One that lasts has no
        ends to move.

        Args:
            level: from 0.
            interval: between samples [s].
        """
        if self.start is None or self.stop is None:
            return []
        step = max(interval, 0.2 * (self.stop - self.start)) / 2**level
        ends = (
            (self.start + a * step, self.stop + b * step) for a, b in product((-1, 0, 1), repeat=2)
        )
        out = [replace(self, start=start, stop=stop) for start, stop in ends if stop > start]
        if self.along is not None:
            places = (self.along + sign * 0.25 / 2**level for sign in (-1, 1))
            out += [replace(self, along=a) for a in places if 0 <= a <= 1]
        return out

    @classmethod
    def candidates(cls, robot: Robot) -> list[Effect]:
        """One an end of the robot."""
        one = len(robot.ends) == 1
        return [cls(tip=None if one else end.name) for end in robot.ends]

    @classmethod
    def links(cls, robot: Robot) -> "list[Contact]":
        """One at the middle of every link before those with ends that so many joints move that the
        force on it can be known."""
        last = {end.link for end in robot.ends}
        # 3: joints that must move a link for the three components of a force on it to show
        return [
            cls(tip=name, along=0.5)
            for i, name in enumerate(robot.link_names)
            if i not in last and len({robot.drives[k].coordinate for k in robot.ancestors(i)}) >= 3
        ]

    def window(self, t: Float[Tensor, " T"]) -> Float[Tensor, " T"]:
        """1 inside, 0 outside, smooth (3 u^2 - 2 u^3) within."""
        inside = torch.ones_like(t)
        if self.start is not None:
            inside = inside * ((t - self.start) / RAMP).clamp(0, 1)
        if self.stop is not None:
            inside = torch.minimum(inside, ((self.stop - t) / RAMP).clamp(0, 1))
        return inside**2 * (3 - 2 * inside)


@dataclass(frozen=True)
class DroppedSamples(OneJointEffect):
    """Samples of a joint's torque were lost, and the last one was held in their place.

    Attributes:
        rate: windows in which the torque is held, a second; for simulation.
        length: of such a window [s]; for simulation.
        seed: of the windows; for simulation.
    """

    rate: float = 1.0
    length: float = 0.05
    seed: int = 0

    name = "dropped_samples"
    family = "transient"
    branch = "sensing"
    of_sensor = True
    needs = frozenset({"torque", "t", "age"})
    jumps = True
    after_noise = True
    coefficients = (
        Coefficient("hold", "1", True, "share of the torque that was held, 0 to 1", 1.2),
    )
    meaning = "The logger repeats old torques while new ones are lost."
    equation = "hold (tau_j(t - age) - tau_j(t))"
    signature = "short windows in which the torque stands still"
    experiment = "repeat the motion and compare the two logs"
    beyond = experiment
    remedy = "Leave the repeated samples out, and repair the logger's link."
    source = (
        "Schenato 2009, To zero or to hold control inputs with lossy links?, IEEE Trans. Automatic "
        "Control 54(5)"
    )
    example = Example((1.0,), "time", {"rate": 2.0, "length": 0.3})
    event = True
    by_motion = False

    def torque_columns(self, motion: Motion, robot: Robot | None = None) -> Columns:
        """tau(t - age) - tau(t) of the joint's own torque (T, n, 1)."""
        torque, t = motion.require("torque", self.name), motion.require("t", self.name)
        if motion.age is None:  # nothing was held
            return torch.zeros(*torque.shape, 1, dtype=torque.dtype, device=torque.device)
        age = motion.age[:, self.joint, None]
        own = torque[:, self.joint, None]
        return on_joint((shifted(own, t, -age) - own)[:, 0], self.joint, torque.shape[1])

    def measured(
        self, motion: Motion, values: Sequence[float], robot: Robot | None = None
    ) -> Motion:
        """The joint's torque held in windows at random, and its age.

        Exact copies of the sample held, as a logger makes them: after the noise, if there is any.
        """
        torque, t = motion.require("torque", self.name), motion.require("t", self.name)
        own = self._age(t).to(torque)
        index = torch.arange(len(t)) - torch.round(own / interval(t)).long()
        held = torque[:, self.joint][index]
        if values[0] != 1.0:
            held = torque[:, self.joint] + values[0] * (held - torque[:, self.joint])
        age = torch.zeros_like(torque) if motion.age is None else motion.age
        out = torque.clone()
        out[:, self.joint] = held
        return motion._replace(torque=out, age=with_joint(age, self.joint, own))

    def _age(self, t: Float[Tensor, " T"]) -> Float[Tensor, " T"]:
        """Seconds since the window began, 0 outside of one."""
        step, total = interval(t), t.shape[0]
        g = torch.Generator().manual_seed(self.seed)
        chance = torch.rand(total, generator=g, dtype=torch.float64)
        index = torch.arange(total)
        starts = torch.where(chance < self.rate * step, index, torch.full_like(index, -total))
        since = index - starts.cummax(0).values if total else index
        return torch.where(since <= round(self.length / step), since, 0).to(torch.float64) * step
