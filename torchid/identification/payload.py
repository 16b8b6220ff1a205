"""What the last link carries, from the base parameters identified without and with it.

Gaz and De Luca, "Payload estimation based on identified coefficients of robot dynamics - with an
application to collision detection", IROS 2017. The mathematics is in `payload_fit`.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Annotated, get_args

import torch
from msgspec import UNSET, UnsetType, field, structs
from scipy.special import chdtri, fdtri

from torchid.design.motion import measurements, moves
from torchid.design.signal import DRIVE_GAIN, from_current
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.motion import Motion
from torchid.errors import TorchidError
from torchid.identification.base_parameters import (
    BaseParameters,
    random_states,
    stacked_regressor,
)
from torchid.identification.identify import Progress, identify
from torchid.identification.knowledge import known_before
from torchid.identification.logs import prepared
from torchid.identification.payload_fit import (
    Evidence,
    Fitted,
    Model,
    changes_beside,
    evidence_of,
    fit_payload,
    joint_regression,
    known_rows,
    last_link_columns,
    nearest_consistent,
)
from torchid.identification.result import Identification, of_parameters
from torchid.identification.settings import Settings
from torchid.inputs import LogLike, RobotLike, as_log, as_robot
from torchid.log.model import Log
from torchid.results.record import Col, Ends, Part, Real, Record, Rows
from torchid.robot.inertia import InertialParameters, move
from torchid.robot.model import Robot, joint_list
from torchid.robot.shapes import reach
from torchid.statistics.jackknife import student_quantile
from torchid.statistics.resampling import LEVEL
from torchid.typing import Bool, Float, Tensor

PARAMETER_NAMES = ("m", "mcx", "mcy", "mcz", "Jxx", "Jxy", "Jxz", "Jyy", "Jyz", "Jzz")


QUANTITIES = (
    ("mass", "kg"),
    *((f"com {axis}", "m") for axis in "xyz"),
    *((f"inertia {entry}", "kg m^2") for entry in ("xx", "xy", "xz", "yy", "yz", "zz")),
)
"""Names and units of what is estimated of a payload; the inertia is about its centre of mass."""
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


class Quantity(Part, frozen=True):
    """One of a payload's ten numbers, nan where the data do not tell it.

    Attributes:
        name, unit: of the number.
        value, std: of it; both zero of what is not part of the model.
        ci95: the 95 % interval.
    """

    name: Annotated[str, Col("quantity")]
    unit: str
    value: Annotated[Real, Col("value ± std", spread="std", unit_of="unit")]
    std: Real
    ci95: Annotated[Ends, Col("95 % interval", ".4g")]


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

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Mass, centre of mass and inertia about it, one by one."""
        parts = (self.mass, self.com, self.inertia_about_com)
        value, std = (torch.cat([getattr(x, key) for x in parts]) for key in ("value", "std"))
        # 1e-9: zero but for rounding, as a point's inertia is
        zero = torch.maximum(value.abs(), std) < 1e-9
        ends = torch.cat([x.ci95 for x in parts]).masked_fill(zero[:, None], 0.0).tolist()
        columns = (x.masked_fill(zero, 0.0).tolist() for x in (value, std))
        each = zip(QUANTITIES, *columns, ends, strict=True)
        return tuple(Quantity(name, unit, x, s, (a, b)) for (name, unit), x, s, (a, b) in each)


class Change(Part, frozen=True):
    """How one parameter differs between the two runs.

    Attributes:
        name, unit: of the parameter.
        change, std: loaded minus unloaded, or what the payload leaves of it.
        significant: beyond the interval of its kind.
    """

    name: Annotated[str, Col("coefficient")]
    unit: str
    change: Annotated[Real, Col("change ± std", spread="std", unit_of="unit")]
    std: Real
    significant: bool


class PayloadParameters(Part, frozen=True, kw_only=True):
    """The payload's ten parameters.

    Attributes:
        names, frame: of the parameters, and the frame they are in.
        parameters: (10,) m, m c, J about the last link frame's origin, in its axes.
        covariance: (10, 10) theirs.
        determined: (10,) which of them the arm and the logs determine, to less than what the torque
            of the log could hold at arm's length; others are of least norm.
    """

    names: tuple[str, ...]
    frame: str
    parameters: Float[Tensor, "10"] = field(name="value")
    covariance: Float[Tensor, "10 10"]
    determined: Bool[Tensor, "10"]


class PayloadFrames(Part, frozen=True):
    """The payload in the last link's frame and in the tool's."""

    last_link: Body
    tool: Body


class Payload(Record, frozen=True, kw_only=True, tag="torchid.payload/1"):
    """What the last link carries.

    Attributes:
        robot: name.
        model: `general` (10 parameters), `symmetric` about the tool's z axis (4), or `point_mass`.
        frames: the body in the last link's frame and in the tool's.
        estimate: the ten parameters in the last link's frame.
        degrees_of_freedom: of the mass's variance; quantile: of Student's 95 % interval with them.
        seen: whether the mass can be told from zero.
        consistent: whether some rigid body has these parameters.
        consistent_within: whether some rigid body lies in the estimate's 95 % region.
        margin: smallest eigenvalue of the pseudo-inertia in the last link's frame; nan where not
            all parameters are determined.
        nearest: (10,) the consistent payload nearest in the metric of the covariance, in the last
            link's frame; None for the models with fewer parameters where they are inconsistent.
        effect_changes: of friction and other effects; none of it is the payload's.
        unexplained: changes of rigid base parameters that no payload on the last link makes.
        undetermined: names of the parameters that are not determined.
        excluded: base parameters that one of the runs did not estimate.
        warnings: sentences for the user.
        cutoff: of both identifications' filter [Hz]; None without one.
    """

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
        """Covariance of the payload's parameters."""
        return self.estimate.covariance

    @property
    def determined(self) -> Bool[Tensor, "10"]:
        """(10,) which of them the arm and the logs determine."""
        return self.estimate.determined

    @property
    def rejected(self) -> bool:
        """Whether no rigid payload on the last link, nor exchanged logs, make such a change: the
        parameters are then those of the nearest body, with intervals as wide as it is away."""
        unchanged = self.nearest is not None and torch.equal(self.nearest, self.parameters)
        return unchanged and not self.consistent_within

    @property
    def table(self) -> Rows[Change]:
        """What changed beside the payload."""
        return Rows((*self.effect_changes, *self.unexplained))

    @property
    def friction_changes(self) -> tuple[Change, ...]:
        """Effects that changed beyond their 95 % intervals."""
        return tuple(c for c in self.effect_changes if c.significant)

    def __repr__(self) -> str:
        mass = self.tool.mass
        return (
            f"Payload('{self.robot}', {float(mass.value):.4g} ± {float(mass.std):.2g} kg, "
            f"{self.model})"
        )


def findings(payload: Payload) -> list[str]:
    """What a user must know about a payload, one sentence each."""
    mass, std = float(payload.link.mass.value), float(payload.link.mass.std)
    half = payload.quantile * std
    said = []
    if math.isnan(mass):
        own = payload.link.parameters
        known = [
            f"{name} = {value:.3g} ± {high - value:.2g}"
            for name, value, high in zip(
                PARAMETER_NAMES, own.value.tolist(), own.high.tolist(), strict=True
            )
            if not math.isnan(value)
        ]
        rest = f", but in the last link's frame {', '.join(known)} (95 %)" if known else ""
        said.append(f"the payload's mass is not known{rest}")
    elif not payload.seen and mass <= -half and mass < 0:
        said.append(
            f"the loaded run carries less than the unloaded one ({mass:.3g} ± {half:.2g} kg): "
            "are the logs exchanged?"
        )
    elif not payload.seen:
        said.append(f"no payload can be seen: its mass is {mass:.3g} ± {half:.2g} kg")
    elif std > _ROUGH * mass:
        said.append(
            "the mass is known to no better than a fifth: intervals of the inertia, of first "
            "order, are rough"
        )
    if payload.undetermined:
        said.append("not determined by this arm and these logs: " + ", ".join(payload.undetermined))
    if payload.rejected:
        said.append(
            "no rigid body within the 95 % region: the change is not that of a rigid payload on "
            "the last link, or the model lacks something; the nearest body is given, with "
            "intervals as wide as it is away"
        )
    elif payload.consistent or not payload.seen:
        pass
    elif payload.consistent_within:
        said.append(
            "no rigid body has exactly these parameters, but one within their 95 % region does: "
            "consistent within its interval"
        )
    elif payload.model != "general":
        said.append(f"no rigid body has these parameters; the model `{payload.model}` may not hold")
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


def _motion_for(payload: Payload, robot: Robot, log: Log, run: Identification) -> list[str]:
    """Which motion would tell what is not known of a payload, in one sentence or none.

    Args:
        payload, robot: what is known of it, on what arm.
        log, run: with it.
    """
    asked = PARAMETER_NAMES if payload.model == "general" else PARAMETER_NAMES[:4]
    unknown = torch.tensor([n in payload.undetermined and n in asked for n in PARAMETER_NAMES])
    standing = (run.fit.standstill_fraction > _MOSTLY_STANDS).tolist()
    joints = [j for j in range(robot.n) if not standing[j]]
    never = unknown & ~_felt(robot, log.q, list(range(robot.n)))
    added, missing = list[int](), unknown & ~never & ~_felt(robot, log.q, joints)
    while bool(missing.any()) and len(joints) < robot.n:
        others = [j for j in range(robot.n) if j not in joints]
        after = {j: missing & ~_felt(robot, log.q, [*joints, j]) for j in others}
        # The last of equals: it carries the least of the arm beside the payload.
        best = min(after, key=lambda j: (int(after[j].sum()), -j))
        joints, added, missing = [*joints, best], [*added, best], after[best]

    def listed(mask: Tensor) -> str:
        return ", ".join(n for n, hit in zip(PARAMETER_NAMES, mask.tolist(), strict=True) if hit)

    said, how = [], "the joints farther and faster, in other postures"
    if added:
        how = f"{joint_list(sorted(added))} as well, far and to and fro"
    if bool((unknown & ~never).any()):
        said.append(
            f"{listed(unknown & ~never)}: move {how}, in both logs (`torchid excite` designs such "
            "a motion)"
        )
    if bool(never.any()):
        said.append(f"{listed(never)}: no motion of this arm tells them")
    return ["; ".join(said)] if said else []


def _felt(robot: Robot, q: Float[Tensor, "T n"], joints: list[int]) -> Bool[Tensor, "10"]:
    """Which of a payload's parameters the torques of some joints tell, beside friction and offsets
    of their own, if they move about where a log has them and the others stand."""
    moved = random_states(robot, samples=_STATES)
    mask = torch.zeros(robot.n).double()
    mask[joints] = 1.0
    state = q.mean(0) + mask * moved.q / 3, mask * moved.dq, mask * moved.ddq
    unit = torch.zeros(10, robot.n_links, 10, dtype=torch.float64)
    unit[:, -1] = torch.eye(10)
    rows = torch.stack([inverse_dynamics(robot, *state, InertialParameters(u)) for u in unit], -1)
    dq = moved.dq.unsqueeze(-1)
    own = torch.cat([dq, dq.sign(), torch.ones_like(dq)], -1)
    left = [
        rows[:, j] - own[:, j] @ torch.linalg.lstsq(own[:, j], rows[:, j]).solution for j in joints
    ]
    table = torch.cat([*left, rows.new_zeros(10, 10)])
    size = table.norm(dim=0)
    table = table / size.clamp(min=1e-9)
    _, sizes, axes = torch.linalg.svd(table, full_matrices=False)
    unfelt = axes[sizes < _FAINT]
    return (unfelt.abs().amax(0) < _FAINT) if len(unfelt) else torch.ones(10, dtype=torch.bool)


_MOSTLY_STANDS = 0.8
"""Share of a log at rest from which on a joint counts as one that stands."""


_STATES, _FAINT = 60, 1e-3
"""Random states that show what joints feel, and the share of a torque that counts as none."""

_ROUNDING = 1e-9
"""Relative size below which a change, or a negative eigenvalue, is rounding."""


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
        IdentificationError: nothing that moves.
        TorchidError: an unknown model, or no log without payload of a robot whose model does not
            say how sure it is.

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
    # What weak motion leaves open is said of the payload; no model of the whole arm is asked for.
    settings = replace(settings or Settings(rows="moving"), force=True)
    # The arm with the payload is another one than the one that is known.
    unknown = replace(robot, knowledge=None)
    without: Robot | Identification = robot
    noticed: list[str] = []
    if empty is not None:
        without = identify(robot, empty, settings=settings, device=device, progress=progress)
        settings = replace(settings, cutoff=without.cutoff)
        noticed = _of_the_log(without, "without payload")
    elif robot.knowledge is None:
        raise TorchidError(
            "the arm without payload is not known.",
            got=f"no log without payload, and '{robot.name}', whose model does not say how "
            "sure it is",
            expected="logs without payload, or a model that `torchid gap --save-model` or "
            "`torchid export` wrote from such logs",
        )
    carrying = identify(unknown, loaded, settings=settings, device=device, progress=progress)
    gain_std = DRIVE_GAIN if from_current(loaded) else 0.0
    rest: tuple[Evidence, ...] = ()
    said: list[str] = []
    if isinstance(without, Identification) and settings.rows == "moving":
        rest, said = _at_rest(without, carrying, loaded)
    load = estimate_payload(without, carrying, model=model, gain_std=gain_std, rest=rest)
    own = [*load.warnings, *_motion_for(load, robot, loaded, carrying), *said]
    if gain_std:
        own.append(
            f"torque is computed from current. Its gain is assumed known to {gain_std:.0%}; every "
            "± includes that."
        )
    warnings = tuple(dict.fromkeys([*own, *noticed, *_of_the_log(carrying, "with payload")]))
    return structs.replace(load, cutoff=carrying.cutoff, warnings=warnings)


def _at_rest(
    without: Identification, carrying: Identification, log: Log
) -> tuple[tuple[Evidence, ...], list[str]]:
    """What joints that stand in the log with payload hold, and a sentence that says so: one row of
    gravity a joint and trajectory, the mean of its rows at rest; what the others' motion adds is
    that without payload. Friction holds up to the dry friction of the joint either way, as far as
    that is known without payload: as much is the row's error."""
    base, robot, n = carrying.base, carrying.robot, carrying.base.n_rigid
    at = {name: k for k, name in enumerate(base.names) if bool(without.free[k])}
    standing = (carrying.fit.standstill_fraction > _MOSTLY_STANDS).nonzero().flatten().tolist()
    shown = {j: at[f"Fc{j + 1}"] for j in standing if f"Fc{j + 1}" in at}
    rows, values = [], []
    for m in measurements(prepared(log, robot)[0], carrying.cutoff) if shown else ():
        # 1000: of a trajectory, at most about so many whose mean says what standing joints hold
        some = slice(m.edge, m.samples - m.edge, max(1, m.samples // 1000))
        motion = m.whole.part(some)
        both = motion, Motion(motion.q, 0 * motion.q, 0 * motion.q)
        whole, y = (stacked_regressor(robot, (), x)[:, list(base.independent[:n])] for x in both)
        added = ((whole - y) @ without.values[:n]).unflatten(0, (-1, robot.n))
        y, still = y.unflatten(0, (-1, robot.n)), ~moves(motion, m.moving)
        held = m.tau[some] - added
        for j, k in shown.items():
            friction = float(without.values[k])
            offset = float(without.values[at[f"F0{j + 1}"]]) if f"F0{j + 1}" in at else 0.0
            own = still[:, j]
            if friction > 0 and own.any():
                row = torch.cat([y[own, j].mean(0), y.new_zeros(len(base) - n)])
                rows.append(row / friction)
                values.append((held[own, j].mean() - offset) / friction)
    if not rows:
        return (), []
    said = f"{joint_list(sorted(shown))} stand with the payload: what they hold counts to within "
    return (known_rows(torch.stack(rows), torch.stack(values)),), [said + "their dry friction"]


def _of_the_log(arm: Identification, which: str) -> list[str]:
    """What an identification says of its log; of single parameters nobody asks for a payload."""
    parameters = of_parameters(arm)
    return [f"{which}: {w}" for w in arm.warnings if w not in parameters]


def estimate_payload(
    unloaded: Robot | Identification,
    loaded: Identification,
    *,
    model: Model = "general",
    gain_std: float = 0.0,
    rest: tuple[Evidence, ...] = (),
) -> Payload:
    """The payload that turns one identification, or a known model, into the other.

    The runs are taken for independent. The same trajectories in both are best: what the filter and
    differentiation do to the base parameters is then nearly the same in both.

    Args:
        unloaded: of the same robot with the same effects; or the robot, whose model says how sure
            it is on another day.
        loaded: with the payload.
        model: see `Payload`.
        gain_std: how well the scale of all torque is known, as a share of it.
        rest: what else is known with the payload.

    Raises:
        TorchidError: other base parameters in the two, or a model that does not say how sure it is.
    """
    two, known, empty = loaded.base, loaded.free, list[Evidence]()
    robot = unloaded if isinstance(unloaded, Robot) else unloaded.robot
    if isinstance(unloaded, Identification):
        one = unloaded.base
        if one.names != two.names or one.parameter_names != two.parameter_names:
            only = [n for n in (*one.names, *two.names) if (n in one.names) != (n in two.names)]
            raise TorchidError(
                "the two identifications do not have the same base parameters.",
                got=f"{robot.name} with {len(one)} and {loaded.robot.name} with {len(two)}; "
                f"different: {', '.join((only or ['their order'])[:4])}",
                expected="the same robot with the same effects",
            )
        if not torch.allclose(one.grouping, two.grouping, atol=1e-6) or not torch.allclose(
            robot.tool, loaded.robot.tool, atol=1e-9
        ):
            raise TorchidError(
                "the two identifications are of robots with different lengths.",
                expected="the same robot with the same effects",
            )
        known = known & unloaded.free
        empty += evidence_of(unloaded)
    before = known_before(robot, two, loaded.effects)
    if before is None and not empty:
        raise TorchidError(f"the model of '{robot.name}' does not say how sure it is.")
    if before is not None:
        root, expected = before
        empty.append(known_rows(root, root @ expected))
    torque = max(float(p.measured.abs().max()) for p in loaded.fit_predictions)
    return payload_from_evidence(
        robot, two, tuple(empty), (*evidence_of(loaded), *rest), model, known, torque, gain_std
    )


def payload_from_evidence(
    robot: Robot,
    base: BaseParameters,
    empty: tuple[Evidence, ...],
    loaded: tuple[Evidence, ...],
    model: Model,
    estimated: Bool[Tensor, " B"] | None = None,
    torque: float = math.inf,
    gain_std: float = 0.0,
) -> Payload:
    """The payload that logs without and with it tell of.

    Args:
        robot, base: the arm and its base parameters' structure.
        empty: without it, of one source or several; none if `loaded` is of the change.
        loaded: with it.
        model: see `Payload`.
        estimated: (B,) base parameters that both runs estimated; all if None.
        torque: largest in the log [N m; N], which no payload that is held exceeds.
        gain_std: as of `estimate_payload`.

    Raises:
        TorchidError: an unknown model.
    """
    if model not in get_args(Model):
        raise TorchidError("unknown model of a payload.", got=model, available=get_args(Model))
    known = torch.ones(len(base), dtype=torch.bool) if estimated is None else estimated
    # Nobody needs a log for an interval of masses that the arm could not even hold.
    length = reach(robot)
    powers = torch.tensor([0, *[1] * 3, *[2] * 6])
    # 9.81: acceleration [m/s^2] with which a torque is compared with a mass
    largest = torque / (9.81 * length) * length ** powers.double()
    columns = last_link_columns(robot, base)
    joint = joint_regression(base, columns, empty, loaded)
    fitted = replace(fit_payload(model, robot, joint), gain_std=gain_std)
    change, std, freedom, shown = changes_beside(fitted, columns)
    rigid = torch.arange(len(base)) < base.n_rigid
    # All rigid parameters are tested at once (Bonferroni).
    strict = 1 - (1 - LEVEL) / max(1, int((shown & rigid).sum()))
    rounding = _ROUNDING * float(change[shown].abs().sum() + columns.abs().max())
    quantile = torch.where(
        rigid, student_quantile(strict, freedom), student_quantile(LEVEL, freedom)
    )
    beyond = change.abs() > quantile * std + rounding
    changes = [
        (k, Change(base.names[k], base.units[k], float(change[k]), float(std[k]), bool(beyond[k])))
        for k in shown.nonzero().flatten().tolist()
    ]
    alone = _payload(robot, model, fitted, largest)
    explained = alone.determined[0]
    payload = structs.replace(
        alone,
        effect_changes=tuple(c for k, c in changes if k >= base.n_rigid),
        # A mass that is not known leaves open what it would explain.
        unexplained=tuple(
            c for k, c in changes if k < base.n_rigid and c.significant and bool(explained)
        ),
        excluded=base.named(~known),
    )
    # Effects hidden in base parameters that a payload changes: they could change with it, but for
    # rotor inertias, which are of the drive.
    touched = (columns.abs() > _ROUNDING).any(-1)
    absorbed = [
        base.parameter_names[k]
        for k in base.dependent
        if k >= base.n_rigid_parameters
        and bool((base.grouping[touched, k].abs() > _ROUNDING).any())
    ]
    hidden = ", ".join(name for name in absorbed if not name.startswith("Ia"))
    said = f"taken for unchanged, as they are part of rigid base parameters: {hidden}"
    return structs.replace(payload, warnings=(*([said] if hidden else []), *findings(payload)))


def with_payload(robot: Robot, payload: Float[Tensor, "10"]) -> Robot:
    """The robot with a payload (10,), given in the tool frame, fixed to its last link.

    Raises:
        RobotError: the robot has no nominal parameters.
    """
    pi = robot.require_parameters("carrying a payload").pi.clone()
    pi[..., -1, :] += move(payload, robot.tool.to(payload)).to(pi)
    return robot.with_parameters(InertialParameters(pi))


def _payload(robot: Robot, model: Model, fitted: Fitted, largest: Float[Tensor, "10"]) -> Payload:
    """Everything about the payload that follows from the fit alone.

    Args:
        robot, model, fitted: the payload.
        largest: half of an interval from which on a parameter is not known.
    """
    theta, covariance, freedom, felt = fitted.of(torch.clone)
    degrees, quantile = float(freedom[0]), float(student_quantile(LEVEL, freedom)[0])

    def half() -> Float[Tensor, "10"]:
        return student_quantile(LEVEL, freedom) * covariance.diagonal().clamp(min=0).sqrt()

    determined = felt & (half() <= largest)
    everything = bool(felt.all())
    body = InertialParameters(theta.unsqueeze(0))
    margin = float(body.consistency_margin()[0])
    size = float(body.pseudo_inertia[0].diagonal().abs().max())
    consistent = everything and margin >= -_ROUNDING * size
    within, nearest = consistent, theta if consistent else None
    if not consistent and model == "general" and bool(torch.equal(determined, felt) and felt.any()):
        nearest, distance, directions = nearest_consistent(theta, covariance, fitted.null)
        # 1e-6: squared distance, in standard deviations, below which two payloads have the same
        # torques
        consistent = not everything and distance < 1e-6
        region = _region(directions, float(freedom[felt].min()))
        within = consistent or distance <= region
        if not within and nearest_consistent(-theta, covariance, fitted.null)[1] > region:
            # No payload on the last link, nor exchanged logs: errors are larger than the logs'
            # blocks say, by what the nearest body is away (Birge 1932).
            fitted = replace(fitted, free=nearest, wider=max(1.0, distance / directions))
            theta, covariance, *_ = fitted.of(torch.clone)
            determined = felt & (half() <= largest)
    seen = bool(determined[0]) and float(theta[0]) > max(float(half()[0]), _ROUNDING)
    link, tool = torch.eye(4, dtype=theta.dtype), torch.linalg.inv(robot.tool)
    unknown = zip(PARAMETER_NAMES, determined.tolist(), strict=True)
    return Payload(
        robot=robot.name,
        model=model,
        frames=PayloadFrames(*(_body(fitted, pose, largest, seen) for pose in (link, tool))),
        estimate=PayloadParameters(
            names=PARAMETER_NAMES,
            frame="last_link",
            parameters=theta,
            covariance=covariance,
            determined=determined,
        ),
        degrees_of_freedom=degrees,
        quantile=quantile,
        seen=seen,
        consistent=consistent,
        consistent_within=within,
        margin=margin if everything else math.nan,
        nearest=nearest,
        effect_changes=(),
        unexplained=(),
        undetermined=tuple(name for name, shown in unknown if not shown),
        excluded=(),
        warnings=(),
        cutoff=None,
    )


def _region(directions: int, freedom: float) -> float:
    """Squared size of a 95 % region in so many directions (Hotelling's T^2)."""
    left = freedom - directions + 1
    if directions > 0 and left > 1e6:
        return float(chdtri(directions, 1 - LEVEL))
    if directions > 0 and left > 0:
        return directions * freedom / left * float(fdtri(directions, left, LEVEL))
    return math.inf


def _body(fitted: Fitted, pose: Tensor, largest: Float[Tensor, "10"], seen: bool) -> Body:
    """The payload in the frame in which the last link's frame has the given pose (4, 4)."""

    def parameters(x: Tensor) -> Tensor:
        return move(x, pose.to(x))

    def com(x: Tensor) -> Tensor:
        return InertialParameters(parameters(x).unsqueeze(0)).com[0]

    def inertia(x: Tensor) -> Tensor:
        return InertialParameters(parameters(x).unsqueeze(0)).inertia_about_com[0]

    def estimate(function: Callable[[Tensor], Tensor], limit: Tensor, shown: bool) -> Estimate:
        value, covariance, freedom, determined = fitted.of(function)
        std = covariance.diagonal().clamp(min=0).sqrt()
        # What a model holds at zero is zero to rounding after a change of frame.
        value, std = (torch.where(x.abs() < 1e-15, torch.zeros_like(x), x) for x in (value, std))
        quantile = student_quantile(LEVEL, freedom)
        ends = torch.stack([value - quantile * std, value + quantile * std], -1)
        if function is com:
            ends = _quotients(*fitted.of(parameters)[:2], quantile)
        nan = torch.full_like(value, math.nan)
        known = determined & shown & ((ends[:, 1] - ends[:, 0]) / 2 <= limit)
        value, std = torch.where(known, value, nan), torch.where(known, std, nan)
        return Estimate(value, std, torch.where(known.unsqueeze(1), ends, nan.unsqueeze(1)))

    reachable = torch.where(largest[0].isinf(), math.inf, largest[1:4] / largest[0])
    # A mass that may be zero is no divisor: where it is, nobody can tell.
    return Body(
        estimate(lambda x: parameters(x)[:1], largest[:1], True),
        estimate(com, reachable, seen),
        estimate(inertia, largest[4:], seen),
        estimate(parameters, largest, True),
    )


def _quotients(
    value: Float[Tensor, "10"], covariance: Float[Tensor, "10 10"], quantile: Float[Tensor, "3"]
) -> Float[Tensor, "3 2"]:
    """Intervals (3, 2) of m c / m, with a mass that is surely not zero: those of c at which m c -
    c m may be zero (Fieller 1954)."""
    m, top, wide = value[0], value[1:4], quantile.square()
    a = m.square() - wide * covariance[0, 0]
    b = m * top - wide * covariance[0, 1:4]
    d = top.square() - wide * covariance.diagonal()[1:4]
    root = (b.square() - a * d).clamp(min=0).sqrt()
    return torch.stack([(b - root) / a, (b + root) / a], -1)
