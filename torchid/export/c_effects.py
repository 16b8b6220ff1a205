"""Effects as C: those whose torque is a closed form of the present motion."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from torchid.effects.base import Effect
from torchid.effects.coupling import GearCoupling
from torchid.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from torchid.effects.friction_laws import (
    RESTING,
    AsymmetricFriction,
    LoadDependentFriction,
    PowerLawFriction,
    StribeckFriction,
)
from torchid.effects.gravity import EncoderOffset, TorqueCrosstalk, TorqueGain
from torchid.effects.periodic import Cogging
from torchid.effects.registry import Valued, in_rounds
from torchid.effects.rotor_inertia import RotorInertia
from torchid.effects.spring import JointSpring
from torchid.effects.transient import Saturation
from torchid.effects.variation import secant_at
from torchid.export.dynamics import described
from torchid.export.exact_text import number
from torchid.robot.model import Robot

Values = Sequence[float]


class EffectCode(NamedTuple):
    """Statements of all effects, and what could not be written.

    Attributes:
        first: effects of the motion alone.
        later: effects of the torque, `loaded`, that those and the rigid body need.
        left_out: in words, those that depend on the past, on time or on an arm that is otherwise.
        uses_rigid: whether a statement calls the rigid body's function.
    """

    first: list[str]
    later: list[str]
    left_out: list[tuple[Effect, str]]
    uses_rigid: bool


def effect_code(robot: Robot, effects: Sequence[Valued], rigid: str) -> EffectCode:
    """C statements that add the effects' torques to tau[].

    Args:
        robot: for units.
        effects: with coefficients.
        rigid: name of the C function of the rigid body's torque.
    """
    rounds: list[list[str]] = []
    left_out = []
    uses_rigid = False
    for pairs in in_rounds(effects):
        lines: list[str] = []
        for effect, values in pairs:
            words = described(effect, values, robot)
            if isinstance(effect, EncoderOffset):
                lines += [f"/* {words} */", *_encoder_offset(effect, values, rigid, robot.n)]
                uses_rigid = True
            elif type(effect) in _WRITERS:
                lines += [f"/* {words} */", *_WRITERS[type(effect)](effect, values)]
            else:
                left_out.append((effect, words))
        rounds.append(lines)
    return EffectCode(rounds[0], rounds[1], left_out, uses_rigid)


def _add(joint: int, expression: str) -> list[str]:
    return [f"tau[{joint}] += {expression};"]


def _viscous(e: ViscousFriction, v: Values) -> list[str]:
    return _add(e.joint, f"{number(v[0])} * dq[{e.joint}]")


def _coulomb(e: CoulombFriction, v: Values) -> list[str]:
    speed = f"dq[{e.joint}]"
    shape = f"sign({speed})" if e.smoothing == 0 else f"tanh({speed} / {number(e.smoothing)})"
    return _add(e.joint, f"{number(v[0])} * {shape}")


def _offset(e: TorqueOffset, v: Values) -> list[str]:
    return _add(e.joint, number(v[0]))


def _rotor(e: RotorInertia, v: Values) -> list[str]:
    return _add(e.joint, f"{number(v[0])} * ddq[{e.joint}]")


def _power(e: PowerLawFriction, v: Values) -> list[str]:
    speed = f"dq[{e.joint}]"
    return _add(e.joint, f"{number(v[0])} * sign({speed}) * pow(fabs({speed}), {number(e.a)})")


def _stribeck(e: StribeckFriction, v: Values) -> list[str]:
    speed = f"dq[{e.joint}]"
    decay = f"exp(-pow(fabs({speed} / {number(e.vs)}), {number(e.d)}))"
    return _add(e.joint, f"{number(v[0])} * {decay} * sign({speed})")


def _asymmetric(e: AsymmetricFriction, v: Values) -> list[str]:
    speed = f"fabs(dq[{e.joint}])"
    moves = f"({speed} >= {number(RESTING)} ? 1.0 : 0.0)"
    return _add(e.joint, f"{number(v[0])} * {moves} + {number(v[1])} * {speed}")


def _spring(e: JointSpring, v: Values) -> list[str]:
    q, k, c0 = f"q[{e.joint}]", number(v[0]), number(v[1])
    if e.curvature == 0:
        return _add(e.joint, f"{k} * {q} + {c0}")
    w = number(abs(e.curvature) ** 0.5)
    sine, cosine = ("sin", "cos") if e.curvature > 0 else ("sinh", "cosh")
    return _add(e.joint, f"{k} / {w} * {sine}({w} * {q}) + {c0} * {cosine}({w} * {q})")


def _cogging(e: Cogging, v: Values) -> list[str]:
    phase = f"{number(e.k)} * q[{e.joint}]"
    return _add(e.joint, f"{number(v[0])} * sin({phase}) + {number(v[1])} * cos({phase})")


def _coupling(e: GearCoupling, v: Values) -> list[str]:
    j, i, r = e.joint, e.source_joint, number(e.ratio)
    fvm, iam, fcm = (number(x) for x in v)
    motor = f"sign(dq[{j}] + {r} * dq[{i}])"
    on_j = f"{r} * ({fvm} * dq[{i}] + {iam} * ddq[{i}]) + {fcm} * ({motor} - sign(dq[{j}]))"
    on_i = f"{r} * ({fvm} * dq[{j}] + {iam} * ddq[{j}] + {fcm} * {motor})"
    return _add(j, on_j) + _add(i, on_i)


def _gain(e: TorqueGain, v: Values) -> list[str]:
    return _add(e.joint, f"{number(v[0])} * loaded[{e.joint}]")


def _crosstalk(e: TorqueCrosstalk, v: Values) -> list[str]:
    return _add(e.joint, f"{number(v[0])} * loaded[{e.source_joint}]")


def _load(e: LoadDependentFriction, v: Values) -> list[str]:
    return _add(e.joint, f"{number(v[0])} * fabs(loaded[{e.joint}]) * sign(dq[{e.joint}])")


def _saturation(e: Saturation, v: Values) -> list[str]:
    torque = f"loaded[{e.joint}]"
    excess = f"fmax(fabs({torque}) - {number(e.limit)}, 0.0)"
    return _add(e.joint, f"{number(-v[0])} * {excess} * sign({torque})")


def _encoder_offset(e: EncoderOffset, v: Values, rigid: str, n: int) -> list[str]:
    at = secant_at(e.at, 1e-6)
    return [
        f"for (i = 0; i < {n}; i++) moved[i] = q[i];",
        f"moved[{e.joint}] += {number(at)};",
        f"{rigid}(moved, dq, ddq, there);",
        f"{rigid}(q, dq, ddq, here);",
        f"for (i = 0; i < {n}; i++) tau[i] += {number(v[0] / at)} * (there[i] - here[i]);",
    ]


_WRITERS: dict[type, Callable[..., list[str]]] = {
    ViscousFriction: _viscous,
    CoulombFriction: _coulomb,
    TorqueOffset: _offset,
    RotorInertia: _rotor,
    PowerLawFriction: _power,
    StribeckFriction: _stribeck,
    AsymmetricFriction: _asymmetric,
    JointSpring: _spring,
    Cogging: _cogging,
    GearCoupling: _coupling,
    TorqueGain: _gain,
    TorqueCrosstalk: _crosstalk,
    LoadDependentFriction: _load,
    Saturation: _saturation,
}
