"""What the last link carries, from the base parameters identified without and with it.

Gaz and De Luca, "Payload estimation based on identified coefficients of robot dynamics - with an
application to collision detection", IROS 2017. The mathematics is in `payload_fit`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, get_args

import torch
from msgspec import UNSET, UnsetType, field
from scipy.special import chdtri, fdtri

from torchid.errors import TorchidError
from torchid.identification.base_parameters import BaseParameters
from torchid.identification.identify import Progress, identify
from torchid.identification.payload_fit import (
    Fitted,
    Model,
    fit_payload,
    last_link_columns,
    nearest_consistent,
    root_of,
    weighting,
)
from torchid.identification.result import Identification
from torchid.identification.settings import Settings
from torchid.identification.values import known_values
from torchid.inputs import LogLike, RobotLike, as_log, as_robot
from torchid.results.record import Part, Real, Record, Result, Rows
from torchid.robot.inertia import InertialParameters, move
from torchid.robot.model import Robot
from torchid.statistics.jackknife import student_quantile
from torchid.typing import Bool, Float, Tensor

LEVEL = 0.95
PARAMETER_NAMES = ("m", "mcx", "mcy", "mcz", "Jxx", "Jxy", "Jxz", "Jyy", "Jyz", "Jzz")

_ROUGH = 0.2
"""Relative standard deviation of the mass above which first-order intervals are called rough."""


class Estimate(Part, frozen=True):
    """Numbers with standard deviations, (Q,) each; nan where the data do not tell.

    Attributes:
        value, std: in the same unit.
        ci95: (Q, 2) the 95 % interval.
    """

    value: Float[Tensor, " Q"]
    std: Float[Tensor, " Q"]
    ci95: Float[Tensor, "Q 2"]

    @property
    def low(self) -> Float[Tensor, " Q"]:
        """Lower end of the interval."""
        return self.ci95[:, 0]

    @property
    def high(self) -> Float[Tensor, " Q"]:
        """Upper end of the interval."""
        return self.ci95[:, 1]


class Body(Part, frozen=True):
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


class Change(Part, frozen=True):
    """How one parameter differs between the two runs.

    Attributes:
        name, unit: of the parameter.
        change, std: loaded minus unloaded, or what the payload leaves of it.
        significant: beyond the interval of its kind.
    """

    name: str
    unit: str
    change: Real
    std: Real
    significant: bool


class PayloadParameters(Part, frozen=True, kw_only=True):
    """The ten parameters in the last link's frame, and which of them are determined."""

    names: tuple[str, ...]
    frame: str
    parameters: Float[Tensor, "10"] = field(name="value")
    covariance: Float[Tensor, "10 10"]
    determined: Bool[Tensor, "10"]


class PayloadFrames(Part, frozen=True):
    """The payload in the last link's frame and in the tool's."""

    last_link: Body
    tool: Body


class _Carried:
    """What a payload can say, computed or read back."""

    __slots__ = ()

    if TYPE_CHECKING:

        @property
        def effect_changes(self) -> tuple[Change, ...]:
            """Of friction and other effects."""

    @property
    def friction_changes(self) -> tuple[Change, ...]:
        """Effects that changed beyond their 95 % intervals."""
        return tuple(c for c in self.effect_changes if c.significant)


class PayloadRecord(_Carried, Record, frozen=True, kw_only=True, tag="torchid.payload/1"):
    """A payload as its JSON has it; see Payload."""

    robot: str
    model: Model
    frames: PayloadFrames
    estimate: PayloadParameters = field(name="parameters")
    degrees_of_freedom: Real
    quantile: Real = field(name="quantile95")
    seen: bool
    consistent: bool
    consistent_within: bool = field(name="consistent_within_interval")
    margin: Real
    nearest: Float[Tensor, "10"] | None = field(name="nearest_consistent")
    effect_changes: tuple[Change, ...]
    unexplained: tuple[Change, ...]
    undetermined: tuple[str, ...]
    excluded: tuple[str, ...]
    warnings: tuple[str, ...]
    cutoff: float | UnsetType | None = field(name="cutoff_hz", default=UNSET)
    seed: int | UnsetType = UNSET

    @property
    def link(self) -> Body:
        """In the last link's frame."""
        return self.frames.last_link

    @property
    def tool(self) -> Body:
        """In the tool's frame."""
        return self.frames.tool

    @property
    def parameters(self) -> Float[Tensor, "10"]:
        """(10,) in the last link's frame."""
        return self.estimate.parameters

    @property
    def covariance(self) -> Float[Tensor, "10 10"]:
        """Theirs."""
        return self.estimate.covariance

    @property
    def determined(self) -> Bool[Tensor, "10"]:
        """(10,) which of them the arm and the logs determine."""
        return self.estimate.determined

    @property
    def table(self) -> Rows[Change]:
        """What changed beside the payload."""
        return Rows((*self.effect_changes, *self.unexplained))


@dataclass(frozen=True, eq=False)
class Payload(_Carried, Result):
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
        cutoff: of both identifications' filter [Hz]; None without one.
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
    cutoff: float | None = None

    def __repr__(self) -> str:
        mass = self.tool.mass
        return (
            f"Payload('{self.robot}', {float(mass.value):.4g} ± {float(mass.std):.2g} kg, "
            f"{self.model})"
        )

    @cached_property
    def record(self) -> PayloadRecord:
        """As the JSON has it."""
        return PayloadRecord.of(
            self,
            frames=PayloadFrames(self.link, self.tool),
            estimate=PayloadParameters.of(self, names=PARAMETER_NAMES, frame="last_link"),
        )

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
    if payload.consistent or not payload.seen:
        pass
    elif payload.consistent_within:
        said.append(
            "no rigid body has exactly these parameters, but one within their 95 % region does: "
            "consistent within its interval"
        )
    elif payload.model != "general":
        said.append(f"no rigid body has these parameters; the model `{payload.model}` may not hold")
    else:
        said.append(
            "no rigid body within the 95 % region: the change is not that of a rigid payload on "
            "the last link, or the standard deviations are too small"
        )
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


_ROUNDING = 1e-9
"""Relative size below which a change, or a negative eigenvalue, is rounding."""

_SAME = 1e-6
"""Squared distance, in standard deviations, below which two payloads have the same torques."""


def payload(
    robot: RobotLike,
    empty: LogLike | None,
    loaded: LogLike,
    *,
    model: Model = "general",
    settings: Settings | None = None,
    device: torch.device | str = "cpu",
    progress: Progress | None = None,
) -> Payload:
    """Mass, centre of mass and inertia of what the last link carries, from logs without and with
    it, best on the same trajectories.

    Args:
        robot: kinematics, gravity and tool; nominal parameters are not needed. What its model knows
            of itself is of the arm without the payload, and counts beside the logs without it.
        empty: without the payload, one or several trajectories; None for what the model knows
            alone.
        loaded: with it.
        model: `general` (ten parameters), `symmetric` about the tool's z axis, or `point_mass`.
        settings: of both identifications; the defaults with rows="moving" if None: at rest
            friction can hold any torque, and so part of a payload's. A cut-off "auto" is chosen on
            the logs without payload and used for both: what the filter does to the parameters then
            cancels in their difference.
        device: where regressors are evaluated and filtered.
        progress: called with (stage, done, total).

    Raises:
        LogError: logs that do not fit the robot or cannot be used.
        IdentificationError: a motion that does not tell parameters apart.
        TorchidError: an unknown model, nothing left to estimate from, or no log without payload of
            a robot whose model does not say how sure it is.

    >>> import torch, torchid
    >>> robot = torchid.load_robot("3r")
    >>> carrying = with_payload(robot, torch.tensor([1.5, *[0.0] * 9]).double())  # at the tool
    >>> motion = torchid.excite(robot, duration=10.0, restarts=1, iterations=0).log()
    >>> empty, loaded = (torchid.simulate(arm, motion) for arm in (robot, carrying))
    >>> found = payload(robot, empty, loaded, settings=torchid.Settings(effects=(), cutoff=10.0))
    >>> bool((found.tool.mass.value - 1.5).abs() < 0.1)
    True
    """
    robot = as_robot(robot)
    empty = None if empty is None else as_log(empty, robot)
    loaded = as_log(loaded, robot)
    robot.require_fixed_base("a payload")
    settings = settings or Settings(rows="moving")
    # The arm with the payload is another one than the one that is known.
    unknown = replace(robot, knowledge=None)
    if empty is None:
        if robot.knowledge is None:
            raise TorchidError(
                "the arm without payload is not known.",
                got=f"no log without payload, and '{robot.name}', whose model does not say how "
                "sure it is",
                expected="logs without payload, or a model that `torchid gap --save-model` or "
                "`torchid export` wrote from such logs",
            )
        carrying = identify(unknown, loaded, settings=settings, device=device, progress=progress)
        found = payload_beside_model(robot, carrying, model=model)
        said = dict.fromkeys([*carrying.warnings, *found.warnings])
        return replace(found, cutoff=carrying.cutoff, warnings=tuple(said))
    without = identify(robot, empty, settings=settings, device=device, progress=progress)
    same = replace(settings, cutoff=without.cutoff)
    carrying = identify(unknown, loaded, settings=same, device=device, progress=progress)
    found = estimate_payload(without, carrying, model=model)
    noticed = dict.fromkeys(
        [
            *(f"without payload: {w}" for w in without.warnings),
            *(f"with payload: {w}" for w in carrying.warnings),
            *found.warnings,
        ]
    )
    return replace(found, cutoff=without.cutoff, warnings=tuple(noticed))


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
    one, two = unloaded.base, loaded.base
    if one.names != two.names or one.parameter_names != two.parameter_names:
        only = [n for n in (*one.names, *two.names) if (n in one.names) != (n in two.names)]
        raise TorchidError(
            "the two identifications do not have the same base parameters.",
            got=f"{unloaded.robot.name} with {len(one)} and {loaded.robot.name} with {len(two)}; "
            f"different: {', '.join((only or ['their order'])[:4])}",
            expected="the same robot with the same effects",
        )
    if not torch.allclose(one.grouping, two.grouping, atol=1e-6) or not torch.allclose(
        unloaded.robot.tool, loaded.robot.tool, atol=1e-9
    ):
        raise TorchidError(
            "the two identifications are of robots with different lengths.",
            expected="the same robot with the same effects",
        )
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


def payload_beside_model(
    robot: Robot, loaded: Identification, *, model: Model = "general"
) -> Payload:
    """The payload that turns a known model into an identification.

    Args:
        robot: whose model says how sure it is, on another day.
        loaded: of the same robot with the payload.
        model: see `Payload`.

    Raises:
        TorchidError: nothing to estimate from, or a model that does not say how sure it is.
    """
    known = known_values(robot, loaded.base, loaded.effects)
    if known is None or known.covariance is None:
        raise TorchidError(f"the model of '{robot.name}' does not say how sure it is.")
    estimated = known.known & loaded.free
    return payload_from_change(
        robot,
        loaded.base,
        loaded.values - known.values,
        known.covariance + loaded.covariance,
        float(max(1, loaded.uncertainty.blocks - 1)),
        model=model,
        estimated=estimated,
        nominal=known.covariance + _nominal(loaded, estimated),
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
    # Effects hidden in base parameters that a payload changes: they could change with it, but for
    # rotor inertias, which are of the drive.
    touched = torch.zeros(len(base), dtype=torch.bool)
    touched[used] = (columns.abs() > _ROUNDING).any(-1)
    absorbed = [
        base.parameter_names[k]
        for k in base.dependent
        if k >= base.n_rigid_parameters
        and bool((base.grouping[touched, k].abs() > _ROUNDING).any())
    ]
    hidden = ", ".join(name for name in absorbed if not name.startswith("Ia"))
    said = f"taken for unchanged, as they are part of rigid base parameters: {hidden}"
    return replace(payload, warnings=(*([said] if hidden else []), *findings(payload)))


def with_payload(robot: Robot, payload: Float[Tensor, "10"]) -> Robot:
    """The robot with a payload (10,), given in the tool frame, fixed to its last link.

    Raises:
        RobotError: the robot has no nominal parameters.
    """
    pi = robot.require_parameters("carrying a payload").pi.clone()
    pi[..., -1, :] += move(payload, robot.tool.to(payload)).to(pi)
    return robot.with_parameters(InertialParameters(pi))


def _quantile(level: float, degrees: float) -> float:
    return float(student_quantile(level, torch.tensor([degrees])))


def _changes(
    base: BaseParameters, which: Tensor, change: Tensor, std: Tensor, quantile: float, floor: float
) -> tuple[Change, ...]:
    beyond = change.abs() > quantile * std + floor
    positions = which.nonzero().flatten().tolist()
    rows = zip(positions, change.tolist(), std.tolist(), beyond.tolist(), strict=True)
    return tuple(Change(base.names[b], base.units[b], c, s, sig) for b, c, s, sig in rows)


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
        # Squared size of the 95 % region in so many directions (Hotelling's T^2).
        left, region = degrees - directions + 1, math.inf
        if directions > 0 and math.isinf(degrees):
            region = float(chdtri(directions, 1 - LEVEL))
        elif directions > 0 and left > 0:
            quantile_f = float(fdtri(directions, left, LEVEL))
            region = directions * degrees / left * quantile_f
        within = consistent or distance <= region
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
        half = quantile * std
        return Estimate(value, std, torch.stack([value - half, value + half], -1))

    # A mass that may be zero is no divisor: where it is, nobody can tell.
    return Body(
        estimate(lambda x: x[:1]), estimate(com, seen), estimate(inertia, seen),
        estimate(parameters),
    )  # fmt: skip
