"""Effects of the library to plant along measured motions: drawn at random, and scaled to a multiple
of what the model leaves.

The size of an effect is the RMS, over all motions and below a band, of the change it makes to the
gap (measured torque minus the nominal model's along the measured motion), over what the model
leaves on the joint; of the joints the largest counts. A contact is measured over its window alone.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Effect, JointEffect, ModelEffect, Motion
from torchid.effects.inertia import LinkInertia, Payload
from torchid.effects.parameters import travel
from torchid.effects.periodic import Wave
from torchid.effects.registry import KINDS, effect_torque, model_torque, nominal_effects
from torchid.effects.spring import JointSpring
from torchid.effects.transient import Contact
from torchid.gap.data import prepare
from torchid.log.filtering import ZeroPhaseFilter
from torchid.log.model import Log
from torchid.robot.inertia import InertialParameters, six
from torchid.robot.model import Robot
from torchid.simulation.loads import adds_torque, changes_measurement

TRIES = 8
"""Draws, of which the first cause of the size asked for is taken, else the closest."""

CAPS = {
    "torque_gain": 0.3,
    "torque_crosstalk": 0.3,
    "load_dependent_friction": 0.3,
    "encoder_offset": 0.15,
    "filter_lag": 0.04,
    "backlash": 0.03,
    "saturation": 1.0,
    "payload": 5.0,
    "link_inertia": 5.0,
}
"""Coefficients larger than these are no small error of a model any more."""

Key = dict[str, Any]
"""What was planted: `name` of an effect or a form, `joints` it is located at and those that it is
`felt_by`, from 1, its `size`; its `record` as in a robot's yaml, or names that are `acceptable`."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Where effects are drawn.

    Attributes:
        robot: the model.
        motions: measured, on one clock, with the model's torque.
        noise: (n,) what the model leaves [N m; N].
        rate: of the motions [Hz].
        band: below which sizes are measured [Hz].
    """

    robot: Robot
    motions: tuple[Motion, ...]
    noise: Tensor
    rate: float = 125.0
    band: float = 8.0

    @classmethod
    def of(cls, robot: Robot, log: Log, noise: Sequence[float], finest: float) -> "Scene":
        """The motions of a log, at a rate below `finest` [Hz]."""
        segments = prepare(robot, log, None).segments
        step = max(1, round(segments[0].rate / finest))
        motions = []
        for s in segments:
            motion = s.motion.every(step)._replace(direction=None, age=None)
            torque = model_torque(robot, nominal_effects(robot), motion)
            motions.append(motion._replace(torque=torque))
        rate = segments[0].rate / step
        # 8.0: band in which sizes are measured [Hz]
        band, left = min(8.0, 0.4 * rate), torch.tensor(noise, dtype=torch.float64)
        return cls(robot, tuple(motions), left, rate, band)


def gap(scene: Scene, effect: Effect, values: Sequence[float]) -> list[Tensor]:
    """What an effect adds to the gap (T, n), motion by motion."""
    robot, nominal = scene.robot, nominal_effects(scene.robot)
    out = []
    for motion in scene.motions:
        arm = effect.plant(robot, values) if isinstance(effect, ModelEffect) else robot
        rigid = inverse_dynamics(arm, *motion.state)
        torques = [*nominal, *([(effect, values)] if adds_torque(effect) else ())]
        seen = motion._replace(torque=rigid + effect_torque(arm, torques, motion, rigid))
        if changes_measurement(effect):
            seen = effect.measured(seen, values, arm)
        out.append(seen.require("torque", "a gap") - model_torque(robot, nominal, seen))
    return out


@dataclass(frozen=True)
class Planted:
    """An effect as planted.

    Attributes:
        effect, values: what.
        size: see the module.
        joints: whose torque it changes by more than the model leaves, from 0; its own always.
    """

    effect: Effect
    values: list[float]
    size: float
    joints: tuple[int, ...]

    @classmethod
    def of(cls, scene: Scene, effect: Effect, values: Sequence[float]) -> "Planted":
        """An effect with its size."""
        low = ZeroPhaseFilter(scene.rate, scene.band)
        every = torch.cat([low.apply(x.T).T for x in gap(scene, effect, values)])
        each = every.square().mean(0).sqrt() / scene.noise
        if isinstance(effect, Contact) and effect.start is not None and effect.stop is not None:
            each = each * math.sqrt(len(every) / scene.rate / (effect.stop - effect.start))
        felt = {int(k) for k in (each > 1).nonzero().flatten()} | set(effect.joints)
        return cls(effect, list(values), float(each.max()), tuple(sorted(felt)))

    @property
    def key(self) -> Key:
        """As in a file."""
        return {
            "name": self.effect.name,
            "joints": [j + 1 for j in self.effect.joints],
            "felt_by": [j + 1 for j in self.joints],
            "size": self.size,
            "record": self.effect.record(self.values),
        }


def drawn(
    scene: Scene, name: str, size: float, rng: np.random.Generator, joint: int
) -> Planted | None:
    """An effect of this name on a joint, from 0, about as large as asked for, or as large as makes
    sense; None where there is none."""
    best: Planted | None = None
    least = math.inf
    for _ in range(TRIES):
        one = _scaled(scene, name, size, rng, joint)
        if one is None or not well_posed(scene, one):
            continue
        if (off := abs(math.log(one.size / size))) < least:
            best, least = one, off
        if least < 0.1:
            break
    return best


def well_posed(scene: Scene, planted: Planted) -> bool:
    """Whether what was drawn is a cause: it shows, no spring pushes away from its rest
    position, and the joint passes through a period of a wave once at least."""
    effect = planted.effect
    # 0.5: size below which an effect is none, over what the model leaves
    if not planted.size > 0.5 or not any(planted.values):
        return False
    if isinstance(effect, JointSpring):
        return planted.values[0] > 0
    if isinstance(effect, Wave):
        return effect.k * travel(scene.motions, effect.joint) >= 2 * math.pi
    return True


def _scaled(
    scene: Scene, name: str, size: float, rng: np.random.Generator, joint: int
) -> Planted | None:
    """Random shapes and coefficients, and these in proportion to the size that they make; None
    where there is no place for the effect on this arm."""
    kind = KINDS[name]
    if issubclass(kind, JointEffect):
        effect: Effect = kind(joint, **_shapes(scene, kind, rng, joint))
    elif issubclass(kind, Contact):
        effect = _contact(scene, rng)
    else:
        assert issubclass(kind, ModelEffect)
        places = [c for c in kind.candidates(scene.robot) if c.joints[:1] in ((), (joint,))]
        if not places:
            return None
        effect = places[rng.integers(len(places))]
    body = isinstance(effect, Payload | LinkInertia)
    values = _body(rng) if body else _coefficients(scene, effect, rng)
    most = CAPS.get(name, math.inf) / max(1e-300, *(abs(v) for v in values))
    scale, out = min(1.0, most), None
    # 4: most effects are linear, and those of a phase nearly so
    for _ in range(4):
        out = Planted.of(scene, effect, [scale * v for v in values])
        if abs(out.size / size - 1) < 0.03 or (scale >= most and out.size < size):
            break
        scale = min(most, scale * size / max(out.size, 1e-9))
    return out


def _coefficients(scene: Scene, effect: Effect, rng: np.random.Generator) -> list[float]:
    """Random coefficients, each of which makes about as much torque as the others; friction that is
    added resists."""
    motions = [m._replace(age=torch.zeros_like(m.q)) for m in scene.motions]
    columns = torch.cat([effect.torque_columns(m, scene.robot) for m in motions])
    length = (columns.square().mean(0).sqrt() / scene.noise.unsqueeze(1)).amax(0).tolist()
    resists = effect.branch == "friction"
    signs = [
        1.0 if resists or c.non_negative else rng.choice([-1.0, 1.0]) for c in effect.coefficients
    ]
    return [
        float(s * rng.uniform(0.5, 1.5) / x) if x > 1e-9 * max(length) else 0.0
        for s, x in zip(signs, length, strict=True)
    ]


def _shapes(
    scene: Scene, kind: type[JointEffect], rng: np.random.Generator, joint: int
) -> dict[str, float]:
    """Within the grid's ends, in ratios where these are positive."""
    out = {}
    for shape in kind.shapes:
        low, high = min(shape.grid), max(shape.grid)
        drawn = rng.uniform(low, high) if low <= 0 else low * (high / low) ** rng.uniform()
        out[shape.name] = shape.size(scene.motions, joint) * drawn
    return out


def _contact(scene: Scene, rng: np.random.Generator) -> Contact:
    """A window of half a second to two, in one of the motions."""
    t = scene.motions[rng.integers(len(scene.motions))].require("t", "a contact")
    length = rng.uniform(0.5, 2.0)
    start = rng.uniform(float(t[0]) + 1.0, float(t[-1]) - 1.0 - length)
    return Contact(start, start + length)


def _body(rng: np.random.Generator) -> list[float]:
    """Ten parameters of a box of one kilogram, 15 cm at most from its link's frame."""
    way = rng.standard_normal(3)
    centre = 0.15 * rng.uniform() ** (1 / 3) * way / np.linalg.norm(way)
    squares = rng.uniform(0.03, 0.15, 3) ** 2 / 12
    turned = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    inertia = six(torch.from_numpy(turned * (squares.sum() - squares) @ turned.T))
    mass = torch.ones(1, dtype=torch.float64)
    body = InertialParameters.from_com(mass, torch.from_numpy(centre)[None], inertia[None])
    return body.pi[0].tolist()
