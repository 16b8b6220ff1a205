"""What draws of a robot are made from: a diagnosis, or a model that says how sure it is."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from scipy.special import ndtri

from torchid.effects.inertia import LinkInertia
from torchid.effects.registry import nominal_effects
from torchid.errors import TorchidError
from torchid.export.dynamics import require_same_arm
from torchid.export.record import ResidualBand
from torchid.gap.record import Coefficient, Covariance, GapRecord
from torchid.identification.base_parameters import base_parameters
from torchid.identification.knowledge import known_names, pooled
from torchid.robot.inertia import PARAMETERS_PER_LINK, paper_order
from torchid.robot.model import JointType, Robot
from torchid.typing import Float, Tensor

LINK = LinkInertia.name


@dataclass(frozen=True, eq=False)
class DrawnFrom:
    """What draws are made from.

    Attributes:
        corrected: the centre.
        given: the robot whose bodies the drawn ones are near to.
        known: how well its coefficients are.
        left: (n,) torque that stays unexplained, RMS [N m; N].
        bands: the same, joint by joint.
        warnings: sentences for the user.
    """

    corrected: Robot
    given: Robot
    known: Covariance
    left: Float[Tensor, " n"]
    bands: tuple[ResidualBand, ...]
    warnings: tuple[str, ...] = ()


def of_diagnosis(found: GapRecord, robot: Robot | None, level: float) -> DrawnFrom:
    """Of a diagnosis, and of the robot as it was given to that if None.

    Raises:
        TorchidError: a diagnosis in which nothing was fitted; another robot.
    """
    if found.covariance is None:
        raise TorchidError(
            "the diagnosis holds no covariance of what it found: nothing was fitted.",
            got=f"status {found.status}",
        )
    given = found.model if robot is None else robot
    require_same_arm(given, found.corrected, "diagnosis is")
    left = torch.tensor([max(j.after, 1e-9) for j in found.how_far.per_joint]).double()
    return DrawnFrom(found.corrected, given, found.covariance, left, _bands(found, level))


def of_model(model: Robot, robot: Robot | None, level: float) -> DrawnFrom:
    """Of a model that says how sure it is; the drawn bodies are near to its own if `robot` is None.

    Raises:
        TorchidError: a model that does not say so, or another robot.
    """
    known = model.knowledge
    if known is None or known.left is None or model.parameters is None:
        raise TorchidError(
            f"the model of '{model.name}' does not say how sure it is.",
            got=model.source or model.name,
            expected="the JSON of `torchid gap`, or a model that `torchid gap --save-model` wrote",
        )
    given = model if robot is None else robot
    require_same_arm(given, model, "model is")
    # Of base parameters and coefficients together, what is determined.
    base, order = base_parameters(model), paper_order(model.n_links).tolist()
    at = [order[k] for k in base.independent]
    own = {
        name: (effect.name, coefficient)
        for effect, _ in nominal_effects(model)
        for name, coefficient in zip(known_names(effect), effect.coefficient_names(), strict=True)
    }
    names = [name for name in known.coefficients if name in own]
    root = known.over(names).root
    root = root[:, [*at, *range(known.rigid, root.shape[1])]]
    zero = root.new_zeros(root.shape[1])
    _, covariance, determined = pooled(root, zero, root[:0], zero)
    coefficients = []
    for k in at:
        link, entry = divmod(k, PARAMETERS_PER_LINK)
        name = LinkInertia(link).coefficient_names()[entry]
        coefficients.append(Coefficient(effect=LINK, names=(name,)))
    coefficients += [Coefficient(effect=own[n][0], names=own[n][1:]) for n in names]
    told = Covariance(coefficients=tuple(coefficients), matrix=covariance)
    every = [*base.names, *names]
    open_ = [name for name, there in zip(every, determined.tolist(), strict=True) if not there]
    said = [
        "the scale of the measured torque is taken for right: sessions with the same sensors do "
        "not show it, and a diagnosis (gap.json) adds how well it is known"
    ]
    if open_:
        said.append(f"no log has determined these, and no draw varies them: {', '.join(open_)}")
    # Normal, and of no known duration: nothing but its size is kept with a model.
    half = float(ndtri((1 + level) / 2))
    bands = tuple(
        ResidualBand(
            joint=j,
            low=-half * rms,
            high=half * rms,
            rms=rms,
            noise=0.0,
            unexplained=rms,
            correlation=0.0,
            why=f"the model was seen to leave {rms:.2g} {_unit(model, j)} RMS of the torque, noise "
            "of the sensor included.",
        )
        for j, rms in enumerate(known.left.tolist())
    )
    left = known.left.clamp(min=1e-9)
    return DrawnFrom(model, given, told, left, bands, tuple(said))


def _unit(robot: Robot, joint: int) -> str:
    return "N" if robot.joint_types[joint] is JointType.PRISMATIC else "N m"


def _bands(found: GapRecord, level: float) -> tuple[ResidualBand, ...]:
    """Of each joint the torque that stays, and what of it is noise of the sensor."""
    out = []
    for one in found.residual:
        half = float(np.interp(level, one.levels, one.sizes)) if one.sizes else math.nan
        floor, far = found.noise_floor, found.how_far.per_joint[one.joint]
        noise = min(float(floor.high[one.joint]), far.after)
        rest = math.sqrt(max(0.0, far.after**2 - noise**2))
        unit = _unit(found.model, one.joint)
        out.append(
            ResidualBand(
                joint=one.joint,
                low=-half,
                high=half,
                rms=far.after,
                noise=noise,
                unexplained=rest,
                correlation=one.correlation,
                why=(
                    f"on data that was not fitted the model misses {far.after:.2g} {unit} RMS, for "
                    f"{one.correlation:.2g} s at a time; up to {noise:.2g} {unit} of it may be "
                    f"noise of the sensor, and {rest:.2g} {unit} at least act on the arm."
                ),
            )
        )
    return tuple(out)
