"""What the last link carries, from the base parameters identified without and with it.

Gaz and De Luca, "Payload estimation based on identified coefficients of robot dynamics - with an
application to collision detection", IROS 2017. The mathematics is in `payload_fit`.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import get_args

import torch
from scipy.stats import chi2
from scipy.stats import f as fisher

from torchid.errors import TorchidError
from torchid.identification.base_parameters import BaseParameters
from torchid.identification.payload_fit import (
    Fitted,
    Model,
    fit_payload,
    last_link_columns,
    nearest_consistent,
    root_of,
    weighting,
)
from torchid.identification.payload_result import (
    LEVEL,
    Body,
    Change,
    Estimate,
    Payload,
    findings,
    record,
)
from torchid.identification.result import Identification
from torchid.robot.inertia import InertialParameters, move
from torchid.robot.model import Robot
from torchid.statistics.jackknife import student_quantile
from torchid.typing import Bool, Float, Tensor

__all__ = [
    "Body",
    "Change",
    "Estimate",
    "Payload",
    "estimate_payload",
    "findings",
    "payload_from_change",
    "record",
    "with_payload",
]

_ROUNDING = 1e-9
"""Relative size below which a change, or a negative eigenvalue, is rounding."""

_SAME = 1e-6
"""Squared distance, in standard deviations, below which two payloads have the same torques."""


def estimate_payload(
    unloaded: Identification, loaded: Identification, *, model: Model = "general"
) -> Payload:
    """The payload that turns one identification into the other.

    The runs are taken for independent. The same trajectories in both are best: what the filter and
    differentiation do to the base parameters is then nearly the same in both.

    Args:
        unloaded, loaded: of the same robot with the same effects.
        model: see `Payload`.

    Raises:
        TorchidError: other base parameters in the two; or nothing left to estimate from.
    """
    _require_same(unloaded, loaded)
    degrees = min(r.uncertainty.blocks for r in (unloaded, loaded)) - 1
    estimated = unloaded.free & loaded.free
    return payload_from_change(
        unloaded.robot,
        unloaded.base,
        loaded.values - unloaded.values,
        unloaded.covariance + loaded.covariance,
        float(max(1, degrees)),
        model=model,
        estimated=estimated,
        nominal=_nominal(unloaded, estimated) + _nominal(loaded, estimated),
    )


def _nominal(result: Identification, estimated: Tensor) -> Float[Tensor, "B B"]:
    """Covariance (B, B) that the fit's own rows promise if their errors are independent: 0 for what
    is not estimated. Far too small on real logs, but its correlations are the log's."""
    rows = result.factor[:-1, :-1][:, estimated]
    scale = torch.linalg.vector_norm(rows, dim=0)
    inverse = torch.linalg.pinv(rows / scale) / scale.unsqueeze(-1)
    out = torch.zeros_like(result.covariance)
    index = estimated.nonzero().flatten()
    out[index.unsqueeze(-1), index] = inverse @ inverse.T
    return out


def payload_from_change(
    robot: Robot,
    base: BaseParameters,
    change: Float[Tensor, " B"],
    covariance: Float[Tensor, "B B"],
    degrees_of_freedom: float = math.inf,
    *,
    model: Model = "general",
    estimated: Bool[Tensor, " B"] | None = None,
    nominal: Float[Tensor, "B B"] | None = None,
) -> Payload:
    """The payload behind a change of base parameters.

    Args:
        robot, base: the arm and its base parameters' structure.
        change, covariance: of all base parameters, loaded minus unloaded.
        degrees_of_freedom: of the covariance.
        model: see `Payload`.
        estimated: (B,) which are known in both runs; all if None.
        nominal: (B, B) covariance by which the changes are weighted, to any scale; that of random
            states of the arm if None. It never enters the standard deviations. (`covariance` itself
            is no weighting: from some dozen blocks it is known too roughly to be inverted.)

    Raises:
        TorchidError: an unknown model; no rigid base parameter known in both runs.
    """
    if model not in get_args(Model):
        raise TorchidError("unknown model of a payload.", got=model, available=get_args(Model))
    known = torch.ones(len(base), dtype=torch.bool) if estimated is None else estimated
    rigid = torch.arange(len(base)) < base.n_rigid
    used, others = known & rigid, known & ~rigid
    columns = last_link_columns(robot, base)[used]
    if not bool((columns.abs() > _ROUNDING).any()):
        raise TorchidError(
            "no base parameter that a payload changes is known in both runs.",
            expected="logs that excite the wrist",
        )
    own, std = covariance[used][:, used], covariance.diagonal().clamp(min=0).sqrt()
    root = weighting(robot, base, used, std[used]) if nominal is None else root_of(nominal, used)
    fitted = fit_payload(model, robot, change[used], own, columns, root)
    quantile = _quantile(LEVEL, degrees_of_freedom)
    # All rows of the residual are tested at once (Bonferroni).
    strict = _quantile(1 - (1 - LEVEL) / int(used.sum()), degrees_of_freedom)
    rounding = _ROUNDING * float(change.abs().max())
    left = _changes(base, used, fitted.residual, fitted.residual_std, strict, rounding)
    payload = replace(
        _payload(robot, model, fitted, degrees_of_freedom),
        effect_changes=_changes(base, others, change[others], std[others], quantile, rounding),
        unexplained=tuple(c for c in left if c.significant),
        excluded=tuple(n for n, k in zip(base.names, known.tolist(), strict=True) if not k),
    )
    return replace(payload, warnings=(*_absorbed(base, columns, used), *findings(payload)))


def with_payload(robot: Robot, payload: Float[Tensor, "10"]) -> Robot:
    """The robot with a payload (10,), given in the tool frame, fixed to its last link.

    Raises:
        RobotError: the robot has no nominal parameters.
    """
    pi = robot.require_parameters("carrying a payload").pi.clone()
    pi[..., -1, :] += move(payload, robot.tool.to(payload)).to(pi)
    return robot.with_parameters(InertialParameters(pi))


def _require_same(unloaded: Identification, loaded: Identification) -> None:
    """Raise unless the base parameters of both mean the same."""
    one, two = unloaded.base, loaded.base
    if one.names != two.names or one.parameter_names != two.parameter_names:
        only = [n for n in (*one.names, *two.names) if (n in one.names) != (n in two.names)]
        differing = only or ["their order"]
        raise TorchidError(
            "the two identifications do not have the same base parameters.",
            got=f"{unloaded.robot.name} with {len(one)} and {loaded.robot.name} with {len(two)}; "
            f"different: {', '.join(differing[:4])}",
            expected="the same robot with the same effects",
        )
    if not torch.allclose(one.grouping, two.grouping, atol=1e-6) or not torch.allclose(
        unloaded.robot.tool, loaded.robot.tool, atol=1e-9
    ):
        raise TorchidError(
            "the two identifications are of robots with different lengths.",
            expected="the same robot with the same effects",
        )


def _quantile(level: float, degrees: float) -> float:
    return float(student_quantile(level, torch.tensor([degrees])))


def _changes(
    base: BaseParameters, which: Tensor, change: Tensor, std: Tensor, quantile: float, floor: float
) -> tuple[Change, ...]:
    beyond = change.abs() > quantile * std + floor
    positions = which.nonzero().flatten().tolist()
    rows = zip(positions, change.tolist(), std.tolist(), beyond.tolist(), strict=True)
    return tuple(Change(base.names[b], base.units[b], c, s, sig) for b, c, s, sig in rows)


def _absorbed(base: BaseParameters, columns: Tensor, used: Tensor) -> list[str]:
    """Effects hidden in base parameters that a payload changes: they could change with it."""
    touched = torch.zeros(len(base), dtype=torch.bool)
    touched[used] = (columns.abs() > _ROUNDING).any(-1)
    start = base.n_rigid_parameters
    names = [
        base.parameter_names[k]
        for k in base.dependent
        if k >= start and bool((base.grouping[touched, k].abs() > _ROUNDING).any())
    ]
    # Rotor inertias are of the drive and do not change.
    names = [n for n in names if not n.startswith("Ia")]
    if not names:
        return []
    return [f"taken for unchanged, as they are part of rigid base parameters: {', '.join(names)}"]


def _payload(robot: Robot, model: Model, fitted: Fitted, degrees: float) -> Payload:
    """Everything about the payload that follows from the fit alone."""
    theta, covariance, determined = fitted.of(torch.clone)
    quantile = _quantile(LEVEL, degrees)
    seen = bool(determined[0]) and float(theta[0]) > quantile * float(covariance[0, 0].sqrt())
    seen = seen and float(theta[0]) > _ROUNDING
    everything = bool(determined.all())
    body = InertialParameters(theta.unsqueeze(0))
    margin = float(body.consistency_margin()[0])
    size = float(body.pseudo_inertia[0].diagonal().abs().max())
    consistent = everything and margin >= -_ROUNDING * size
    within, nearest = consistent, theta if consistent else None
    if not consistent and model == "general":
        nearest, distance, directions = nearest_consistent(theta, covariance, fitted.null)
        consistent = not everything and distance < _SAME
        within = consistent or distance <= _region(directions, degrees)
    return Payload(
        robot=robot.name,
        model=model,
        parameters=theta,
        covariance=covariance,
        determined=determined,
        link=_body(fitted, torch.eye(4, dtype=theta.dtype), quantile, seen),
        tool=_body(fitted, torch.linalg.inv(robot.tool), quantile, seen),
        degrees_of_freedom=degrees,
        quantile=quantile,
        seen=seen,
        consistent=consistent,
        consistent_within=within,
        margin=margin if everything else math.nan,
        nearest=nearest,
        effect_changes=(),
        unexplained=(),
        excluded=(),
        warnings=(),
    )


def _region(directions: int, degrees: float) -> float:
    """Squared size of the 95 % region in so many directions (Hotelling's T^2)."""
    left = degrees - directions + 1
    if left <= 0 or directions == 0:
        return math.inf
    if math.isinf(degrees):
        return float(chi2.ppf(LEVEL, directions))
    return float(directions * degrees / left * fisher.ppf(LEVEL, directions, left))


def _body(fitted: Fitted, pose: Float[Tensor, "4 4"], quantile: float, seen: bool) -> Body:
    """The payload in the frame in which the last link's frame has the given pose."""

    def parameters(x: Tensor) -> Tensor:
        return move(x, pose.to(x))

    def com(x: Tensor) -> Tensor:
        return InertialParameters(parameters(x).unsqueeze(0)).com[0]

    def inertia(x: Tensor) -> Tensor:
        return InertialParameters(parameters(x).unsqueeze(0)).inertia_about_com[0]

    def estimate(function: Callable[[Tensor], Tensor], told: bool = True) -> Estimate:
        value, covariance, determined = fitted.of(function)
        std = covariance.diagonal().clamp(min=0).sqrt()
        # What a model holds at zero is zero to rounding after a change of frame.
        value, std = (torch.where(x.abs() < 1e-15, torch.zeros_like(x), x) for x in (value, std))
        nan = torch.full_like(value, math.nan)
        known = determined & told
        value, std = torch.where(known, value, nan), torch.where(known, std, nan)
        return Estimate(value, std, value - quantile * std, value + quantile * std)

    # A mass that may be zero is no divisor: where it is, nobody can tell.
    return Body(
        estimate(lambda x: x[:1]), estimate(com, seen), estimate(inertia, seen),
        estimate(parameters),
    )  # fmt: skip
