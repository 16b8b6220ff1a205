"""Sets with exactly equal torque, feasible and not: how far are their internal forces apart?

The report leaves the question open (section 6): sets that violate inertias only seem to leave the
internal forces near the true ones, sets that violate centres of mass drive them off by 5e1 to 5e2 N
(sections 5.1 to 5.4); does the degree of the violation matter, and how do firmly feasible sets
compare with nearly infeasible ones? Its sets come from a search, so a set's reasons, its bounds and
its luck go together. Here families of sets with the torque of one reference are drawn for each kind
of violation, from slight to gross, and their forces compared with the reference's.

Three questions are kept apart: how far the forces of the *drawn* sets are (this depends on XX"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
import torch
from msgspec import UNSET, UnsetType, field

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Motion
from torchid.errors import TorchidError
from torchid.feasibility.conditions import Conditions
from torchid.feasibility.margins import Feasibility, feasibility
from torchid.feasibility.sets import ParameterSets
from torchid.inputs import RobotLike, as_robot
from torchid.results.record import Col, Ends, Part, Real, Record, Result, Rows
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor
from torchid.wrenches.deviation import WrenchErrors, wrench_errors
from torchid_study.equal_torque.force_reach import ForceReach, force_reach, force_squares
from torchid_study.equal_torque.sample import (
    FEASIBLE,
    KINDS,
    EqualTorqueSets,
    equal_torque_sets,
    equal_torque_space,
)
from torchid_study.equal_torque.setting import (
    MARGIN,
    RATE,
    Setting,
    equal_torque_setting,
    reference_motion,
)
from torchid_study.wrenches.classes import class_of, ordered_classes
from torchid_study.wrenches.compare import RESAMPLES, Comparison, compare
from torchid_study.wrenches.resampling import (
    LEAST_SETS,
    Estimate,
    Sample,
    quartile_words,
    quartiles,
    spearman,
)


class SetErrors(Part, frozen=True, kw_only=True):
    """One set against the reference, joint by joint.

    Attributes:
        id, kind: which; without a kind in a comparison of given sets.
        feasible, reasons, degree: its verdict.
        force_rms, force_max, force_norm_rms: (n,) error of the internal forces [N].
        moment_rms: (n,) of the moments [N m].
        torque_relative: (n,) difference of the torque over the torque.
        carried: (n,) difference of the mass that each joint carries [kg].
    """

    id: Annotated[str, Col("set")]
    kind: str | UnsetType = UNSET
    feasible: Annotated[bool, Col()]
    reasons: Annotated[tuple[str, ...], Col()]
    degree: Annotated[Real, Col(digits=".2g")]
    force_rms: Annotated[Float[Tensor, " n"], Col("force error", unit="N")]
    force_max: Float[Tensor, " n"]
    force_norm_rms: Float[Tensor, " n"]
    moment_rms: Annotated[Float[Tensor, " n"], Col("moment error", unit="N m")]
    torque_relative: Annotated[Float[Tensor, " n"], Col("torque error over the torque", ".1g")]
    carried: Float[Tensor, " n"] = field(name="carried_mass_difference")

    @property
    def worst(self) -> float:
        """Largest over the joints of the root mean square force error [N]."""
        return float(self.force_rms.max())


def _medians(of: Float[Tensor, "n 3"]) -> str:
    return " ".join(f"{value:.3g}" for value in of[:, 1].tolist())


class KindRecord(Part, frozen=True, kw_only=True):
    """Quartiles of the errors of one kind of sets: over the largest joint, and (n, 3) by joint."""

    kind: Annotated[str, Col("what is violated")]
    sets: Annotated[int, Col()]
    largest_force_rms: Annotated[Float[Tensor, "3"], Col("largest joint", words=quartile_words)]
    force_rms: Annotated[
        Float[Tensor, "n 3"], Col("force error by joint", unit="N", words=_medians)
    ]
    moment_rms: Annotated[Float[Tensor, "n 3"], Col("moment error", unit="N m", words=_medians)]
    degree: Annotated[Ends, Col(digits=".2g")]


@dataclass(frozen=True)
class KindCorrelation:
    """Spearman's rho of the degree and the force error within one kind: negative when firmer sets,
    and less infeasible ones, have smaller errors."""

    kind: str
    sets: int
    degree: Estimate


Range = tuple[Real, Real, Real]
"""Median of several numbers, and the range of 95 % of them."""


class ReferenceOfStudy(Part, frozen=True, kw_only=True):
    """What the sets have the torque of."""

    origin: str
    mass: Float[Tensor, " n"]
    torque_change_rms: Float[Tensor, " n"]
    force_rms: Float[Tensor, " n"]


class EqualTorqueRecord(Record, frozen=True, kw_only=True, tag="torchid.wrenches/1"):
    """A study of sets with equal torque as its JSON has it; see EqualTorqueStudy."""

    mode: Literal["equal_torque"] = "equal_torque"
    robot: str
    seed: int
    geometry: str
    outer: str
    total_mass: Ends
    reference: ReferenceOfStudy
    instants: int
    torque_relative_max: Real
    static_share: Range
    kinds: tuple[KindRecord, ...]
    comparison: Comparison
    correlations: tuple[KindCorrelation, ...]
    reach: tuple[ForceReach, ...]
    warnings: tuple[str, ...]
    sets: tuple[SetErrors, ...]
    findings: tuple[str, ...] | UnsetType = UNSET

    @property
    def table(self) -> Rows[SetErrors]:
        """The sets."""
        return Rows(self.sets)


class GivenReference(Part, frozen=True, kw_only=True):
    """The set that others are compared with, and its own internal wrenches (n,)."""

    id: str
    force_rms: Float[Tensor, " n"]
    moment_rms: Float[Tensor, " n"]


class GivenSetsRecord(Record, frozen=True, kw_only=True, tag="torchid.wrenches/1"):
    """A comparison of given sets as its JSON has it; see GivenSets. `source`: files of the sets."""

    mode: Literal["sets"] = "sets"
    robot: str
    source: tuple[str, ...]
    reference: GivenReference
    instants: int
    torque_relative_max: Real
    comparison: Comparison
    sets: tuple[SetErrors, ...]
    warnings: tuple[str, ...] = ()
    seed: int | UnsetType = UNSET

    @property
    def table(self) -> Rows[SetErrors]:
        """The sets."""
        return Rows(self.sets)


@dataclass(frozen=True, eq=False)
class WrenchComparison:
    """K sets beside one reference, on a motion.

    Attributes:
        motion: on which wrenches were compared.
        checked: the sets' feasibility.
        errors: of their wrenches against the reference's, per set and joint.
        torque_relative: (K, n) root mean square of the difference of the joint torques over that of
            the torque itself; rounding where the torque is equal.
        carried: (K, n) difference of the mass that each joint carries [kg].
    """

    motion: Motion
    checked: Feasibility
    errors: WrenchErrors
    torque_relative: Float[Tensor, "K n"]
    carried: Float[Tensor, "K n"]


def set_errors(
    comparison: WrenchComparison,
    ids: Sequence[str],
    degree: Float[Tensor, " K"],
    kinds: Sequence[str] = (),
) -> tuple[SetErrors, ...]:
    """Sets one by one, as the JSON has them."""
    names = ("force_rms", "force_max", "force_norm_rms", "moment_rms")
    return tuple(
        SetErrors(
            id=name,
            kind=kinds[k] if kinds else UNSET,
            feasible=bool(comparison.checked.feasible[k]),
            reasons=comparison.checked.reasons(k),
            degree=float(degree[k]),
            torque_relative=comparison.torque_relative[k],
            carried=comparison.carried[k],
            **{name: getattr(comparison.errors, name)[k] for name in names},
        )
        for k, name in enumerate(ids)
    )


def compared_on(
    motion: Motion,
    robot: Robot,
    sets: ParameterSets,
    reference: ParameterSets,
    conditions: Conditions,
) -> WrenchComparison:
    """Sets beside one reference; effects such as friction are no wrench of the links."""
    own = InertialParameters(reference.parameters.pi[0])
    errors = wrench_errors(robot, *motion.state, sets.parameters, own)
    tau = inverse_dynamics(robot, *motion.state, own)
    mass = sets.parameters.mass - own.mass
    return WrenchComparison(
        motion=motion,
        checked=feasibility(sets, conditions),
        errors=errors,
        torque_relative=errors.torque_rms / tau.square().mean(0).sqrt(),
        carried=mass.flip(-1).cumsum(-1).flip(-1),
    )


_REPORTS_PAIR = ("CoM only", "inertia only")
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class EqualTorqueStudy(WrenchComparison, Result):
    """What was found of a family, see `WrenchComparison`, against `setting.reference`.

    Attributes:
        setting: where the family is from.
        family: the sets.
        rate: samples per second of the motion [Hz]; None for a motion that was given.
        comparison: of the largest force error over the joints, by class and degree.
        correlations: of the degree and the error, kind by kind.
        reach: greatest force errors of any set of each kind.
        static_share: median, and range of 95 %, of what the weight of `carried` is of the largest
            force error.
        seed: of everything.
        warnings: sentences for the user.
    """

    setting: Setting
    family: EqualTorqueSets
    rate: float | None
    comparison: Comparison
    correlations: tuple[KindCorrelation, ...]
    reach: tuple[ForceReach, ...]
    static_share: Range
    seed: int
    warnings: tuple[str, ...]

    def __repr__(self) -> str:
        name, sets = self.setting.robot.name, len(self.family.kind)
        return f"EqualTorqueStudy('{name}', {sets} sets of {len(self.kinds)} kinds)"

    @cached_property
    def record(self) -> EqualTorqueRecord:
        """As the JSON has it; numbers that are not known are null."""
        setting = self.setting
        total = setting.conditions.total_mass.tolist()
        return EqualTorqueRecord.of(
            self,
            robot=setting.robot.name,
            geometry=setting.geometry,
            outer=setting.outer.name,
            total_mass=(total[0], total[1]),
            reference=ReferenceOfStudy(
                origin=setting.origin,
                mass=setting.reference.parameters.mass[0],
                torque_change_rms=setting.torque_change,
                force_rms=self.errors.reference_force_rms,
            ),
            instants=self.motion.q.shape[0],
            torque_relative_max=float(self.torque_relative.max()),
            kinds=tuple(_kind(self, kind) for kind in self.kinds),
            sets=set_errors(self, self.family.sets.ids, self.degree, self.family.kind),
        )

    @property
    def worst(self) -> Float[Tensor, " K"]:
        """(K,) largest over the joints of the root mean square force error [N]."""
        return self.errors.force_rms.amax(-1)

    @property
    def degree(self) -> Float[Tensor, " K"]:
        """(K,) smallest degree of the conditions on the links and on the total mass."""
        return links_degree(self.checked)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds that have sets, in their order."""
        return tuple(dict.fromkeys(self.family.kind))

    def rows(self, kind: str) -> list[int]:
        """Indices of the sets of a kind."""
        return [k for k, own in enumerate(self.family.kind) if own == kind]


def links_degree(checked: Feasibility) -> Float[Tensor, " K"]:
    """(K,) smallest degree of the conditions on the links and on the total mass: coefficients of
    effects are the same in all sets of a family."""
    return torch.minimum(checked.degrees.flatten(1).amin(-1), checked.total_mass_degree)


def equal_torque_study(
    robot: RobotLike,
    *,
    per_kind: int = 200,
    chains: int = 40,
    kinds: Sequence[str] = KINDS,
    setting: Setting | None = None,
    margin: float = MARGIN,
    motion: Motion | None = None,
    resamples: int = RESAMPLES,
    seed: int = 0,
    progress: Progress | None = None,
) -> EqualTorqueStudy:
    """What equal torque leaves open inside: families of sets with exactly the torque of one arm,
    feasible and not, and how far their internal forces are from its own.

    Args:
        robot: with inertial parameters, groups of bounds `normal` and `loose`, and limits of motion
            unless a motion is given.
        per_kind, chains, kinds: see `equal_torque_sets`; `feasible` must be among the kinds.
        setting: conditions, bounds and reference; `equal_torque_setting(robot, margin=margin)` if
            None.
        margin: see `equal_torque_setting`.
        motion: states (T, n); a sinusoid within the limits if None.
        resamples: of the bootstrap.
        seed: of all draws.
        progress: called with (stage, done, total).

    Raises:
        TorchidError: no bounds, no feasible set, no feasible set drawn, or `feasible` not asked
            for.

    >>> import torchid
    >>> robot, few = torchid.load_robot("3r"), ("feasible", "inertia")
    >>> study = equal_torque_study(robot, per_kind=8, chains=4, kinds=few, resamples=20)
    >>> bool(study.torque_relative.max() < 1e-9), float(study.errors.force_rms.max()) > 1
    (True, True)
    """
    robot = as_robot(robot)
    if FEASIBLE not in kinds:
        raise TorchidError("the kinds must include feasible sets.", got=list(kinds))
    setting = setting or equal_torque_setting(robot, margin=margin)
    rate = RATE if motion is None else None
    motion = motion or reference_motion(robot, seed)
    tell: Progress = progress or (lambda stage, done, total: None)
    tell("sets with equal torque", 0, 2)
    family = equal_torque_sets(
        setting.robot,
        setting.base,
        setting.reference,
        setting.conditions,
        setting.outer,
        kinds=kinds,
        per_kind=per_kind,
        seed=seed,
        chains=chains,
    )
    if family.kind.count(FEASIBLE) < 2:
        raise TorchidError(
            "no feasible sets with the reference's torque were found beside it.",
            got=f"bounds '{setting.geometry}' and '{setting.outer.name}'",
            hint="wider boxes, or a reference with a larger margin",
        )
    tell("statistics and greatest errors", 1, 2)
    compared = compared_on(
        motion, setting.robot, family.sets, setting.reference, setting.conditions
    )
    worst, degree = compared.errors.force_rms.amax(-1), links_degree(compared.checked)
    reasons = [compared.checked.reasons(k) for k in range(len(worst))]
    present = ordered_classes(map(class_of, reasons))
    # Each class against the feasible sets; the report asks for CoM against inertia.
    pairs = [(name, present[0]) for name in present[1:]]
    pairs += [_REPORTS_PAIR] if set(_REPORTS_PAIR) <= set(present) else []
    comparison = compare(
        worst,
        reasons,
        degree,
        cluster=family.cluster,
        pairs=pairs,
        resamples=resamples,
        seed=seed,
    )
    space = equal_torque_space(setting.reference, setting.base, setting.conditions, setting.outer)
    reach = force_reach(space, force_squares(setting.robot, motion, space.directions))
    weight = compared.carried.abs().amax(-1) * setting.robot.gravity.norm()
    low, middle, high = np.nanpercentile((weight / worst).numpy(), [2.5, 50, 97.5]).tolist()
    tell("done", 2, 2)
    return EqualTorqueStudy(
        **vars(compared),
        setting=setting,
        family=family,
        rate=rate,
        comparison=comparison,
        correlations=_correlations(family, degree.numpy(), worst.numpy(), resamples, seed),
        reach=reach,
        static_share=(middle, low, high),
        seed=seed,
        warnings=(*setting.notes, *family.warnings),
    )


def _correlations(
    family: EqualTorqueSets, degree: np.ndarray, error: np.ndarray, resamples: int, seed: int
) -> tuple[KindCorrelation, ...]:
    """Correlations of degree and error, of the kinds that have enough sets."""
    kind, correlations = np.array(family.kind), []
    sample = Sample(error, family.cluster.numpy(), resamples, np.random.default_rng(seed))
    for name in dict.fromkeys(family.kind):
        own = np.flatnonzero(kind == name)
        if len(own) >= 3 * LEAST_SETS:
            rho = sample.estimate(lambda k: spearman(degree[k], error[k]), [own])
            correlations.append(KindCorrelation(name, len(own), rho))
    return tuple(correlations)


def _kind(study: EqualTorqueStudy, kind: str) -> KindRecord:
    rows = study.rows(kind)
    return KindRecord(
        kind=kind,
        sets=len(rows),
        largest_force_rms=quartiles(study.worst[rows]),
        force_rms=quartiles(study.errors.force_rms[rows]),
        moment_rms=quartiles(study.errors.moment_rms[rows]),
        degree=(float(study.degree[rows].min()), float(study.degree[rows].max())),
    )
