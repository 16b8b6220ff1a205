"""What is known of a payload, what its user must know, and the schema torchid.payload/1."""

import math
from dataclasses import dataclass
from typing import Any

from torchid.identification.payload_fit import Model
from torchid.typing import Bool, Float, Tensor

SCHEMA = "torchid.payload/1"
LEVEL = 0.95
PARAMETER_NAMES = ("m", "mcx", "mcy", "mcz", "Jxx", "Jxy", "Jxz", "Jyy", "Jyz", "Jzz")

_ROUGH = 0.2
"""Relative standard deviation of the mass above which first-order intervals are called rough."""


@dataclass(frozen=True)
class Estimate:
    """Numbers with standard deviations, (Q,) each; nan where the data do not tell.

    Attributes:
        value, std: in the same unit.
        low, high: the 95 % interval.
    """

    value: Float[Tensor, " Q"]
    std: Float[Tensor, " Q"]
    low: Float[Tensor, " Q"]
    high: Float[Tensor, " Q"]


@dataclass(frozen=True)
class Body:
    """The payload in one frame.

    Attributes:
        mass: (1,) [kg].
        com: (3,) centre of mass [m].
        inertia_about_com: (6,) xx, xy, xz, yy, yz, zz about the payload's own centre of mass, in
            axes of the frame [kg m^2].
        parameters: (10,) m, m c, and J about the frame's origin.
    """

    mass: Estimate
    com: Estimate
    inertia_about_com: Estimate
    parameters: Estimate


@dataclass(frozen=True)
class Change:
    """How one parameter differs between the two runs.

    Attributes:
        name, unit: of the parameter.
        change, std: loaded minus unloaded, or what the payload leaves of it.
        significant: beyond the interval of its kind.
    """

    name: str
    unit: str
    change: float
    std: float
    significant: bool


@dataclass(frozen=True, eq=False)
class Payload:
    """What the last link carries.

    Attributes:
        robot: name.
        model: `general` (10 parameters), `symmetric` about the tool's z axis (4), or `point_mass`.
        parameters: (10,) m, m c, J about the last link frame's origin, in its axes.
        covariance: (10, 10) theirs.
        determined: (10,) which of them the arm and the logs determine; others are of least norm.
        link, tool: the body in the last link's frame and in the tool's.
        degrees_of_freedom: of the covariance; quantile: of Student's 95 % interval with them.
        seen: whether the mass can be told from zero.
        consistent: whether some rigid body has these parameters.
        consistent_within: whether some rigid body lies in the estimate's 95 % region.
        margin: smallest eigenvalue of the pseudo-inertia in the last link's frame; nan where not
            all parameters are determined.
        nearest: (10,) the consistent payload nearest in the metric of the covariance, in the last
            link's frame; None for the models with fewer parameters where they are inconsistent.
        effect_changes: of friction and other effects; none of it is the payload's.
        unexplained: changes of rigid base parameters that no payload on the last link makes.
        excluded: base parameters without information in one of the runs.
        warnings: sentences for the user.
    """

    robot: str
    model: Model
    parameters: Float[Tensor, "10"]
    covariance: Float[Tensor, "10 10"]
    determined: Bool[Tensor, "10"]
    link: Body
    tool: Body
    degrees_of_freedom: float
    quantile: float
    seen: bool
    consistent: bool
    consistent_within: bool
    margin: float
    nearest: Float[Tensor, "10"] | None
    effect_changes: tuple[Change, ...]
    unexplained: tuple[Change, ...]
    excluded: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def friction_changes(self) -> tuple[Change, ...]:
        """Effects that changed beyond their 95 % intervals."""
        return tuple(c for c in self.effect_changes if c.significant)

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of the parameters, in the last link's frame, that are not determined."""
        return tuple(
            n for n, d in zip(PARAMETER_NAMES, self.determined.tolist(), strict=True) if not d
        )


def findings(payload: Payload) -> list[str]:
    """What a user must know about a payload, one sentence each."""
    mass, std = float(payload.link.mass.value), float(payload.link.mass.std)
    half = payload.quantile * std
    said = []
    if math.isnan(mass):
        said.append("this arm's torque does not determine the payload's mass")
    elif not payload.seen and mass <= -half and mass < 0:
        said.append(
            f"the loaded run carries less than the unloaded one ({mass:.3g} ± {half:.2g} kg): "
            "are the logs exchanged?"
        )
    elif not payload.seen:
        said.append(f"no payload can be seen: its mass is {mass:.3g} ± {half:.2g} kg")
    elif std > _ROUGH * mass:
        said.append(
            "the mass is known to no better than a fifth: intervals of the centre of mass and of "
            "the inertia, of first order, are rough"
        )
    if payload.undetermined:
        said.append("not determined by this arm and these logs: " + ", ".join(payload.undetermined))
    if payload.excluded:
        said.append(
            "left out, as one of the runs does not know them (what they hide may bias the "
            "payload): " + ", ".join(payload.excluded)
        )
    return said + _consistency(payload) + _changed(payload)


def _consistency(payload: Payload) -> list[str]:
    if payload.consistent or not payload.seen:
        return []
    if payload.consistent_within:
        return [
            "no rigid body has exactly these parameters, but one within their 95 % region does: "
            "consistent within its interval"
        ]
    if payload.model != "general":
        return [f"no rigid body has these parameters; the model `{payload.model}` may not hold"]
    return [
        "no rigid body within the 95 % region: the change is not that of a rigid payload on the "
        "last link, or the standard deviations are too small"
    ]


def _changed(payload: Payload) -> list[str]:
    said = []
    changed = payload.friction_changes
    if changed:
        count = len(payload.effect_changes)
        said.append(
            f"{len(changed)} of {count} coefficients of effects changed beyond their 95 % "
            f"interval (about {(1 - LEVEL) * count:.1f} do by chance); they are not part of the "
            "payload: " + ", ".join(f"{c.name} by {c.change:.2g} ± {c.std:.1g}" for c in changed)
        )
    if payload.unexplained:
        said.append(
            "rigid base parameters changed in a way that this payload does not explain (is it "
            "rigid and fixed to the last link, the model right, the arm otherwise the same?): "
            + ", ".join(c.name for c in payload.unexplained)
        )
    return said


def record(payload: Payload) -> dict[str, Any]:
    """The payload as JSON-ready data, schema torchid.payload/1; nan is null."""
    return {
        "schema": SCHEMA,
        "robot": payload.robot,
        "model": payload.model,
        "frames": {"last_link": _frame(payload.link), "tool": _frame(payload.tool)},
        "parameters": {
            "names": list(PARAMETER_NAMES),
            "frame": "last_link",
            "value": payload.parameters.tolist(),
            "covariance": payload.covariance.tolist(),
            "determined": payload.determined.tolist(),
        },
        "degrees_of_freedom": _number(payload.degrees_of_freedom),
        "quantile95": payload.quantile,
        "seen": payload.seen,
        "consistent": payload.consistent,
        "consistent_within_interval": payload.consistent_within,
        "margin": _number(payload.margin),
        "nearest_consistent": None if payload.nearest is None else payload.nearest.tolist(),
        "effect_changes": [vars(c) for c in payload.effect_changes],
        "unexplained": [vars(c) for c in payload.unexplained],
        "undetermined": list(payload.undetermined),
        "excluded": list(payload.excluded),
        "warnings": list(payload.warnings),
    }


def _frame(body: Body) -> dict[str, Any]:
    return {
        name: {
            "value": [_number(v) for v in e.value.tolist()],
            "std": [_number(v) for v in e.std.tolist()],
            "ci95": [
                [_number(a), _number(b)]
                for a, b in zip(e.low.tolist(), e.high.tolist(), strict=True)
            ],
        }
        for name, e in vars(body).items()
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
