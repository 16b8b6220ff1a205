"""Effects to plant in simulated arms: drawn at random and scaled to a multiple of the torque noise.

The size of an effect is the RMS, over all of a case's trajectories and below BAND, of the change it
makes to the gap (measured torque minus the nominal model's torque along the measured motion),
divided by the standard deviation of the joint's torque noise; of the joints the largest counts. A
contact is measured over its window alone. Sizes are set along the references, before anything is
simulated; what a controlled arm then does differs a little.
"""

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchid.dynamics.forward import mass_matrix
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Effect, JointEffect, ModelEffect, Motion
from torchid.effects.coupling import GearCoupling
from torchid.effects.friction import CoulombFriction, ViscousFriction
from torchid.effects.friction_laws import ThermalFrictionDrift
from torchid.effects.registry import KINDS, Valued, effect_torque, model_torque, nominal_effects
from torchid.effects.spring import JointSpring, stumpff
from torchid.effects.transient import Contact, Saturation
from torchid.log.filtering import ZeroPhaseFilter
from torchid.log.model import Log
from torchid.robot.inertia import InertialParameters, six
from torchid.robot.model import Robot
from torchid.simulation.loads import adds_torque, changes_measurement

RATE = 500.0
DURATION = 15.0

BAND = 20.0
COARSE = 4
"""Every k-th sample is enough to measure sizes below BAND."""

TRIES = 12
"""Places and shapes drawn until one reaches the size asked for; else the one that came closest."""

CAPS = {
    "torque_gain": 0.3,
    "torque_crosstalk": 0.3,
    "load_dependent_friction": 0.3,
    "encoder_offset": 0.15,
    "base_tilt": 0.15,
    "time_delay": 0.04,
    "filter_lag": 0.04,
    "backlash": 0.03,
}
"""Coefficients larger than these are no small error of a model any more."""


def generator(*parts: object) -> torch.Generator:
    """Random numbers that depend on what they are for alone."""
    text = "/".join(str(p) for p in parts)
    seed = int.from_bytes(hashlib.sha256(text.encode()).digest()[:7], "big")
    return torch.Generator().manual_seed(seed)


def uniform(g: torch.Generator, low: float, high: float) -> float:
    return low + (high - low) * float(torch.rand(1, generator=g, dtype=torch.float64))


def sign(g: torch.Generator) -> float:
    return 1.0 if uniform(g, 0, 1) < 0.5 else -1.0


def pick(g: torch.Generator, count: int) -> int:
    """One of so many; of none a ValueError."""
    if not count:
        raise ValueError("there is no place for it on this arm")
    return int(torch.randint(count, (1,), generator=g))


@dataclass(frozen=True, eq=False)
class Scene:
    """References of a case, and what the nominal model does along them.

    Attributes:
        robot: the nominal model.
        references: t, q, dq, ddq; one log a trajectory, stamps on the case's clock.
        starts: the clock at the first sample of each [s].
        motions: of each, coarser, with t from 0 and the nominal torque.
        noise: (n,) standard deviation of the torque noise [N m; N].
        rate: of the motions [Hz].
        band: below which sizes are measured [Hz].
        lasting: length of the shortest motion [s].
    """

    robot: Robot
    references: tuple[Log, ...]
    starts: tuple[float, ...]
    motions: tuple[Motion, ...]
    noise: Tensor
    rate: float = RATE / COARSE
    band: float = BAND
    lasting: float = DURATION

    @property
    def together(self) -> Motion:
        """All motions in one piece."""
        return Motion(
            *(None if x[0] is None else torch.cat(x) for x in zip(*self.motions, strict=True))
        )  # type: ignore[arg-type]

    @property
    def fast(self) -> Tensor:
        """(n,) 99 % speed."""
        return self.together.dq.abs().quantile(0.99, dim=0)

    @property
    def loaded(self) -> Tensor:
        """(n,) 99 % torque."""
        return self.together.require("torque", "a scene").abs().quantile(0.99, dim=0)


def on_clock(effects: Sequence[Valued], start: float, duration: float = DURATION) -> list[Valued]:
    """Effects of a trajectory whose own time begins when the case's clock is at `start`.

    1 - exp(-(t + s)/T) = (1 - a) + a (1 - exp(-t/T)) with a = exp(-s/T), so friction that has
    warmed up for a while is constant friction and a smaller drift.
    """
    out: list[Valued] = []
    for effect, values in effects:
        if isinstance(effect, ThermalFrictionDrift):
            kept = math.exp(-start / effect.T)
            viscous, coulomb = (x * (1 - kept) for x in values)
            out.append((effect, [x * kept for x in values]))
            out.append((ViscousFriction(effect.joint), [viscous]))
            out.append((CoulombFriction(effect.joint), [coulomb]))
        elif isinstance(effect, Contact) and effect.start is not None and effect.stop is not None:
            if effect.stop > start and effect.start < start + duration:
                moved = replace(effect, start=effect.start - start, stop=effect.stop - start)
                out.append((moved, values))
        else:
            out.append((effect, values))
    return out


def gap(scene: Scene, effects: Sequence[Valued]) -> list[Tensor]:
    """What effects add to the gap along the references (T, n), trajectory by trajectory."""
    robot, nominal = scene.robot, nominal_effects(scene.robot)
    out = []
    for motion, start in zip(scene.motions, scene.starts, strict=True):
        own = on_clock(effects, start, scene.lasting)
        arm = robot
        for effect, values in own:
            if isinstance(effect, ModelEffect):
                arm = effect.plant(arm, values)
        rigid = inverse_dynamics(arm, *motion.state)
        torques = [*nominal, *((e, v) for e, v in own if adds_torque(e) and not _is_body(e))]
        seen = motion._replace(torque=rigid + effect_torque(arm, torques, motion, rigid))
        for effect, values in own:
            if changes_measurement(effect):
                seen = effect.measured(seen, values, arm)  # type: ignore[attr-defined]
        out.append(seen.require("torque", "a gap") - model_torque(robot, nominal, seen))
    return out


def _is_body(effect: Effect) -> bool:
    return isinstance(effect, ModelEffect) and type(effect).plant is not ModelEffect.plant


def ratios(scene: Scene, effects: Sequence[Valued]) -> Tensor:
    """(n,) size of effects on every joint, see the module."""
    low = ZeroPhaseFilter(scene.rate, scene.band)
    every = torch.cat([low.apply(x.T).T for x in gap(scene, effects)])
    size = every.square().mean(0).sqrt() / scene.noise
    for effect, _ in effects:
        if isinstance(effect, Contact) and effect.start is not None and effect.stop is not None:
            size = size * math.sqrt(
                len(scene.motions) * scene.lasting / (effect.stop - effect.start)
            )
    return size


@dataclass(frozen=True)
class Sized:
    """An effect whose size is still free.

    Attributes:
        make: the effect of a size.
        most: largest size that makes sense.
        first: where to begin.
    """

    make: Callable[[float], Valued]
    most: float = math.inf
    first: float = 1.0


@dataclass(frozen=True)
class Planted:
    """An effect as planted.

    Attributes:
        effect, values: what.
        size: reached, in standard deviations of the noise.
        joints: whose torque it changes beyond the noise, from 0; its own joint always.
    """

    effect: Effect
    values: list[float]
    size: float
    joints: tuple[int, ...]

    @property
    def valued(self) -> Valued:
        return self.effect, self.values


def plant(
    scene: Scene,
    name: str,
    size: float,
    g: torch.Generator,
    joint: int | None = None,
    usual: float | None = None,
) -> Planted:
    """A random effect of this name, as large as asked for or as large as makes sense.

    Args:
        scene: where.
        name: which kind.
        size: asked for, in standard deviations of the noise.
        g: random numbers.
        joint: on which joint, from 0; a random one if None.
        usual: size for which place and shapes are drawn, so that effects of several sizes have
            them in common; `size` if None.
    """
    drawn_for = size if usual is None else usual
    best: tuple[float, Sized, Planted] | None = None
    for _ in range(TRIES):
        place = pick(g, scene.robot.n)
        sized = _sized(scene, name, g, place if joint is None else joint)
        if sized is None:
            continue
        scaled = _scaled(scene, sized, drawn_for)
        off = abs(math.log(scaled.size / drawn_for))
        if best is None or off < best[0]:
            best = off, sized, scaled
        if off < 0.1:
            break
    if best is None:
        raise ValueError(f"no place for {name} on {scene.robot.name}")
    return best[2] if drawn_for == size else _scaled(scene, best[1], size)


def _scaled(scene: Scene, sized: Sized, size: float) -> Planted:
    """In proportion, as most are linear in their size; by bisection where that leaps too far."""
    most = sized.most * max(1.0, size / 5.0)
    scale, low, high = min(sized.first, most), 0.0, math.inf
    for _ in range(12):
        effect, values = sized.make(scale)
        each = ratios(scene, [(effect, values)])
        reached = max(float(each.max()), 1e-9)
        if abs(reached / size - 1) < 0.03 or (scale >= most and reached < size):
            break
        low, high = (max(low, scale), high) if reached < size else (low, min(high, scale))
        wanted = scale * min(size / reached, 1e6)
        if not low < wanted < high:
            wanted = (low + high) / 2
        scale = min(wanted, most)
    felt = {int(k) for k in (each > 1).nonzero().flatten()}
    return Planted(effect, values, reached, tuple(sorted(felt | set(effect.joints))))


def _sized(scene: Scene, name: str, g: torch.Generator, joint: int) -> Sized | None:
    """A kind's effect on a joint (where it has one) with random shapes; None where it cannot be."""
    special = _SPECIAL.get(name)
    if special is not None:
        return special(scene, g, joint)
    kind = KINDS[name]
    if issubclass(kind, JointEffect):
        effect: Effect = kind(joint, **_shapes(scene, kind, g, joint))
    else:
        assert issubclass(kind, ModelEffect)
        places = [c for c in kind.candidates(scene.robot) if c.joints[:1] in ((), (joint,))]
        if not places:
            return None
        effect = places[pick(g, len(places))]
    return _linear(scene, effect, g)


def _linear(scene: Scene, effect: Effect, g: torch.Generator) -> Sized:
    """Random coefficients, each of which makes about as much torque as the others."""
    motions = [m._replace(age=torch.zeros_like(m.q)) for m in scene.motions]
    columns = torch.cat([effect.torque_columns(m, scene.robot) for m in motions])
    length = columns.square().mean(0).sqrt()
    length = (length / scene.noise.unsqueeze(1)).amax(0)
    signs = [1.0 if c.non_negative else sign(g) for c in effect.coefficients]
    values = [
        s * uniform(g, 0.5, 1.5) / float(x) if float(x) > 1e-9 * float(length.max()) else 0.0
        for s, x in zip(signs, length, strict=True)
    ]
    cap = CAPS.get(effect.name, math.inf) / max(1e-300, *(abs(v) for v in values))
    return _times(effect, values, cap)


def _times(effect: Effect, values: Sequence[float], most: float = math.inf) -> Sized:
    return Sized(lambda scale: (effect, [scale * v for v in values]), most)


def _shapes(
    scene: Scene, kind: type[JointEffect], g: torch.Generator, joint: int
) -> dict[str, float]:
    out = {}
    for shape in kind.shapes:
        scale = {"speed": scene.fast, "torque": scene.loaded}.get(shape.scale)
        unit = 1.0 if scale is None else float(scale[joint])
        low, high = min(shape.grid), max(shape.grid)
        if low > 0:
            out[shape.name] = unit * math.exp(uniform(g, math.log(low), math.log(high)))
        else:
            out[shape.name] = unit * uniform(g, low, high)
    return out


def _friction_of(scene: Scene, joint: int) -> tuple[float, float]:
    """Nominal viscous and Coulomb friction of a joint."""
    sizes = {
        (e.name, e.joints[0]): v[0] for e, v in nominal_effects(scene.robot) if len(e.joints) == 1
    }
    return sizes.get(("viscous_friction", joint), 0.0), sizes.get(("coulomb_friction", joint), 0.0)


def _power_law(scene: Scene, g: torch.Generator, joint: int) -> Sized | None:
    """Thinning lubricant only where friction is left to resist."""
    kind = KINDS["power_law_friction"]
    effect = kind(joint, **_shapes(scene, kind, g, joint))  # type: ignore[arg-type,call-arg]
    way = sign(g)
    viscous, coulomb = _friction_of(scene, joint)
    fast = 1.1 * float(scene.fast[joint])
    if way < 0 and coulomb > 0:
        return _times(effect, [-1.0], 0.8 * (coulomb + viscous * fast) / fast**effect.a)  # type: ignore[attr-defined]
    return _times(effect, [1.0])


def _thermal(scene: Scene, g: torch.Generator, joint: int) -> Sized | None:
    """Friction mostly falls, to a fifth of its cold value at most."""
    viscous, coulomb = _friction_of(scene, joint)
    kind = ThermalFrictionDrift
    effect = kind(joint, **_shapes(scene, kind, g, joint))
    shares = [uniform(g, 0.3, 1.0) for _ in range(2)]
    values = [-shares[0] * viscous, -shares[1] * coulomb]
    return _times(effect, values, 0.8 / max(shares)) if coulomb > 0 else None


def _asymmetric(scene: Scene, g: torch.Generator, joint: int) -> Sized | None:
    viscous, coulomb = _friction_of(scene, joint)
    shares = [uniform(g, 0.3, 1.0) for _ in range(2)]
    values = [sign(g) * shares[0] * coulomb, sign(g) * shares[1] * viscous]
    effect = KINDS["asymmetric_friction"](joint)  # type: ignore[call-arg]
    return _times(effect, values, 0.9 / max(shares)) if coulomb > 0 else None


def _coupled(scene: Scene, g: torch.Generator, joint: int) -> Sized | None:
    """A motor that turns with two joints has no more friction than either joint's own, which the
    nominal model knows, and half of the inertia with which the arm's would not be positive."""
    places = [c for c in GearCoupling.candidates(scene.robot) if c.joints[0] == joint]
    effect = places[pick(g, len(places))]
    own = [_friction_of(scene, j) for j in effect.joints]
    viscous, coulomb = (min(x) for x in zip(*own, strict=True))
    if min(viscous, coulomb) <= 0:
        return None
    per_unit = torch.zeros(scene.robot.n, scene.robot.n, dtype=torch.float64)
    i, j = effect.joints
    per_unit[i, j] = per_unit[j, i] = effect.ratio  # type: ignore[attr-defined]
    mass = mass_matrix(scene.robot, scene.together.q[::COARSE])
    half, info = torch.linalg.cholesky_ex(mass)
    if bool(info.any()):
        return None
    seen = torch.linalg.solve_triangular(half, per_unit.expand_as(mass), upper=False)
    seen = torch.linalg.solve_triangular(half, seen.mT, upper=False)
    inertia = 0.5 / float(-torch.linalg.eigvalsh(seen).min())
    shares = [uniform(g, 0.3, 1.0) for _ in range(3)]
    values = [a * b for a, b in zip(shares, (viscous, inertia, coulomb), strict=True)]
    return _times(effect, values, 1 / max(shares))


def _kinematic(scene: Scene, g: torch.Generator, joint: int) -> Sized | None:
    """Millimetres and milliradians; joint 1's translations make no torque."""
    shift = [0.0 if joint == 0 else sign(g) * uniform(g, 0.3, 1.0) * 5e-3 for _ in range(3)]
    turn = [sign(g) * uniform(g, 0.3, 1.0) * 1e-2 for _ in range(2)]
    return _times(KINDS["kinematic_error"](joint), [*shift, *turn], 10.0)  # type: ignore[call-arg]


def _elastic(scene: Scene, g: torch.Generator, joint: int) -> Sized | None:
    """As soft as twist and resonance allow; the inertia is that of the acceleration's torque."""
    m = scene.together
    torque, ddq = m.require("torque", "elasticity")[:, joint], m.ddq[:, joint]
    moved = torch.stack([ddq, m.q[:, joint].cos(), m.q[:, joint].sin(), torch.ones_like(ddq)], 1)
    inertia = abs(float(torch.linalg.lstsq(moved, torque.unsqueeze(1)).solution[0]))
    # 6.0 Hz: of an elastic joint; a softer one would not be quasi-static
    softest = 1 / (inertia * (2 * math.pi * 6.0) ** 2)
    # 0.04 rad: of an elastic joint, at its 99 % torque
    most = min(softest, 0.04 / float(scene.loaded[joint]))
    return Sized(lambda c: (KINDS["joint_elasticity"](joint), [c]), most, most)  # type: ignore[call-arg]


def _body(g: torch.Generator, offset: Tensor) -> Tensor:
    """Ten parameters of a box of one kilogram about a frame that its centre is off from."""
    sides = torch.tensor([uniform(g, 0.03, 0.15) for _ in range(3)], dtype=torch.float64)
    squares = sides.square() / 12
    principal = torch.diag(squares.sum() - squares)
    turned, _ = torch.linalg.qr(torch.randn(3, 3, generator=g, dtype=torch.float64))
    inertia = six(turned @ principal @ turned.T)
    mass = torch.ones(1, dtype=torch.float64)
    return InertialParameters.from_com(mass, offset.unsqueeze(0), inertia.unsqueeze(0)).pi[0]


def _within(g: torch.Generator, radius: float) -> Tensor:
    way = torch.randn(3, generator=g, dtype=torch.float64)
    return way / way.norm() * radius * uniform(g, 0, 1) ** (1 / 3)


def _payload(scene: Scene, g: torch.Generator, joint: int) -> Sized:
    # 0.15 m: farthest of the payload's centre of mass from the flange
    body = _body(g, _within(g, 0.15))
    # 5.0 kg: heaviest payload
    return _times(KINDS["payload"](), body.tolist(), 5.0)


def _link(scene: Scene, g: torch.Generator, joint: int) -> Sized:
    """Mass, centre and inertia of a link change together to those of another body.

    Where the nominal link is one that no body can be, mass is added instead.
    """
    own = InertialParameters(scene.robot.require_parameters("a draw").pi[joint].double())
    effect = KINDS["link_inertia"](joint)  # type: ignore[call-arg]
    mass = float(own.mass)
    extra = mass * _body(g, own.com + _within(g, 0.05))
    if float(own.consistency_margin()) <= 0:
        return _times(effect, extra.tolist(), 1.0)
    scale = uniform(g, 0.6, 1.5)
    other = InertialParameters.from_com(
        own.mass * scale, own.com + _within(g, 0.05), own.inertia_about_com * scale
    )
    change = other.pi - own.pi
    # Between two bodies every mixture is one; beyond the second, up to a limit.
    sizes = [s / 4 for s in range(4, 21)]
    good = [InertialParameters(own.pi + s * change).consistency_margin() > 0 for s in sizes]
    most = sizes[good.index(False) - 1] if False in good else sizes[-1]
    return _times(effect, change.tolist(), most)


def _spring(scene: Scene, g: torch.Generator, joint: int) -> Sized | None:
    """Towards a rest position within the travel; only a counterbalance may push."""
    effect = JointSpring(joint, **_shapes(scene, JointSpring, g, joint))
    rest = uniform(g, *(float(x) for x in scene.together.q[:, joint].aminmax()))
    c, s = (float(x) for x in stumpff(torch.tensor(effect.curvature * rest**2).double()))
    counterbalance = effect.ranges[0][0] < 0
    way = sign(g) if counterbalance else 1.0
    return _times(effect, [way * c, -way * rest * s]) if counterbalance or c > 0 else None


def _saturation(scene: Scene, g: torch.Generator, joint: int) -> Sized:
    """A hard clip; what is sized is how far below the largest torque it lies."""
    top = float(scene.together.require("torque", "a limit")[:, joint].abs().max())
    return Sized(lambda s: (Saturation(joint, top * (1 - s)), [1.0]), 0.7, 0.2)


def _contact(scene: Scene, g: torch.Generator, joint: int) -> Sized:
    length = uniform(g, 0.5, 2.0)
    k = pick(g, len(scene.starts))
    start = scene.starts[k] + uniform(g, 1.0, scene.lasting - 1.0 - length)
    force = torch.randn(3, generator=g, dtype=torch.float64)
    return _times(Contact(start, start + length), (force / force.norm()).tolist())


_SPECIAL: dict[str, Callable[[Scene, torch.Generator, int], Sized | None]] = {
    "power_law_friction": _power_law,
    "thermal_friction_drift": _thermal,
    "asymmetric_friction": _asymmetric,
    "gear_coupling": _coupled,
    "kinematic_error": _kinematic,
    "joint_elasticity": _elastic,
    "payload": _payload,
    "link_inertia": _link,
    "saturation": _saturation,
    "contact": _contact,
    "joint_spring": _spring,
}
