"""Fields of a simulator's joints in the place of effects that have none there: the nearest ones.

The torque of such effects along a log is projected onto what the fields of its joint can say: by
least squares, and with the signs that simulators take (`scipy.optimize.lsq_linear`).
"""

import math
from dataclasses import replace
from itertools import chain, combinations

import torch
from scipy.optimize import lsq_linear

from torchid.design.columns import Columns
from torchid.design.segments import moving_samples
from torchid.effects.spring import JointSpring
from torchid.results.record import Joint, Part, Real
from torchid.simulation.loads import changes_measurement
from torchid.simulators.joint_dynamics import JointDynamics, Target, kinds_in, split
from torchid.typing import Float, Tensor

WORTH = 0.05
"""Share of the effects' RMS that a field must take away to be changed for them."""


class NearestFields(Part, frozen=True, kw_only=True):
    """What the fields of a joint say of its effects that have no field in a format.

    Attributes:
        to: format.
        joint: which.
        effects: names of those without a field.
        fields: of `JointDynamics` that change, and what they become [their units].
        made: RMS of the effects' torque along the log, while the joint moves [N m; N].
        lost: RMS of what the change of the fields leaves of it [N m; N].
    """

    to: Target
    joint: Joint
    effects: tuple[str, ...]
    fields: dict[str, float]
    made: Real
    lost: Real


def nearest_fields(columns: Columns, to: Target) -> tuple[NearestFields, ...]:
    """The nearest fields of every joint with effects that have none. Errors of the sensors and what
    happened once belong into no field; of bodies the links say all. A spring is changed, not added.

    Args:
        columns: of a robot with its effects along a log, in the band in which they are compared.
        to: format of the file.
    """
    joints, rest = split(columns.model.robot, to)
    torques: dict[str, Tensor] = {}
    for effect, values in rest:
        if not (effect.inertial or effect.event or effect.of_sensor
                or changes_measurement(effect)):  # fmt: skip
            torque = columns.torque(effect, values)
            torques[effect.name] = torques.get(effect.name, 0.0) + torque
    moving = moving_samples(columns.samples)
    out = []
    for j, held in enumerate(joints):
        felt = {name: x[j, moving[j]] for name, x in torques.items()}
        felt = {name: x for name, x in felt.items() if bool(x.any())}
        if not felt:
            continue
        torque = torch.stack(list(felt.values())).sum(0)
        span = {
            names: columns.on_all_joints(kind(j))[:, j, moving[j]]
            for kind, names in kinds_in(to).items()
            if kind is not JointSpring or held.stiffness
        }
        fields, left = _projected(torque, span, held)
        made, lost = (x * len(torque) ** -0.5 for x in (float(torque.norm()), left))
        names = tuple(felt)
        out.append(
            NearestFields(to=to, joint=j, effects=names, fields=fields, made=made, lost=lost)
        )
    return tuple(out)


def _projected(
    torque: Float[Tensor, " N"],
    span: dict[tuple[str, ...], Float[Tensor, "C N"]],
    held: JointDynamics,
) -> tuple[dict[str, float], float]:
    """Fields that change, with what they become, and the norm of what they leave of a torque.

    Args:
        torque: of the effects.
        span: columns of each effect that has fields, by their names.
        held: what the joint's fields are without it.
    """
    made = float(torque.norm())
    # The triangle has the columns' and the torque's inner products, and few rows.
    r = torch.linalg.qr(torch.cat([*span.values(), torque.unsqueeze(0)]).T).R
    names = [key for keys in span for key in keys]
    size = r.norm(dim=0).clamp(min=1e-12)
    free = ("offset", "quadratic")
    least = {key: -math.inf if key in free else -getattr(held, key) for key in names}
    if "stiffness" in least:  # a spring stays one
        least["stiffness"] *= 1 - WORTH
    best, fields, left = made, {}, made
    for some in chain.from_iterable(combinations(span, k + 1) for k in range(len(span))):
        keys = [key for own in some for key in own]
        at = [names.index(key) for key in keys]
        low = [least[key] * float(size[k]) for key, k in zip(keys, at, strict=True)]
        a, b = (r[:, at] / size[at]).numpy(), r[:, -1].numpy()
        found = lsq_linear(a, b, (low, math.inf), method="bvls")
        rest = math.sqrt(2 * found.cost)
        change = (found.x / size[at].numpy()).tolist()
        total = [getattr(held, key) + x for key, x in zip(keys, change, strict=True)]
        # At a bound of zero a sum may lie below it by rounding, which no simulator takes.
        values = {k: x if k in free else max(0.0, x) for k, x in zip(keys, total, strict=True)}
        if rest + WORTH * made * len(some) < best and replace(held, **values).resists:
            best, left, fields = rest + WORTH * made * len(some), rest, values
    return fields, left
