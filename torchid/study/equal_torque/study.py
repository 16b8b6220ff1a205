"""Sets with exactly equal torque, feasible and not: how far are their internal forces apart?

The report leaves the question open (section 6): sets that violate inertias only seem to leave the
internal forces near the true ones, sets that violate centres of mass drive them off by 5e1 to 5e2 N
(sections 5.1 to 5.4); does the degree of the violation matter, and how do firmly feasible sets
compare with nearly infeasible ones? Its sets come from a search, so a set's reasons, its bounds and
its luck go together. Here families of sets with the torque of one reference are drawn for each kind
of violation, from slight to gross, and their forces compared with the reference's.

Three questions are kept apart: how far the forces of the *drawn* sets are (this depends on how sets
are drawn), how far those of *any* such set can be (`force_reach`: it does not), and
whether it matters which of the feasible sets is the true arm (`other_truths`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from msgspec import UNSET, UnsetType, field

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Motion
from torchid.errors import TorchidError
from torchid.extraction.equal_torque.sample import (
    FEASIBLE,
    KINDS,
    EqualTorqueSets,
    equal_torque_sets,
    equal_torque_space,
)
from torchid.feasibility.margins import LINK_CONDITIONS, Feasibility, feasibility
from torchid.feasibility.sets import ParameterSets
from torchid.inputs import RobotLike, as_robot
from torchid.results.record import Ends, Part, Real, Record, Result, Rows
from torchid.robot.inertia import InertialParameters
from torchid.study.equal_torque.force_reach import ForceReach, force_reach, force_squares
from torchid.study.equal_torque.setting import (
    MARGIN,
    RATE,
    Setting,
    equal_torque_setting,
    reference_motion,
)
from torchid.study.equal_torque.statistics import (
    Across,
    FirmTruths,
    KindCorrelations,
    Matched,
    OtherTruths,
    Range,
    Samples,
    Statistics,
    ThirdSummary,
    middle_range,
    other_truths,
    statistics,
)
from torchid.typing import Float, Tensor
from torchid.wrenches.classes import class_of, ordered_classes
from torchid.wrenches.compare import RESAMPLES, Comparison, compare
from torchid.wrenches.deviation import WrenchErrors, wrench_errors


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

    id: str
    kind: str | UnsetType = UNSET
    feasible: bool
    reasons: tuple[str, ...]
    degree: Real
    force_rms: Float[Tensor, " n"]
    force_max: Float[Tensor, " n"]
    force_norm_rms: Float[Tensor, " n"]
    moment_rms: Float[Tensor, " n"]
    torque_relative: Float[Tensor, " n"]
    carried: Float[Tensor, " n"] = field(name="carried_mass_difference")


class KindRecord(Part, frozen=True, kw_only=True):
    """Quartiles of the errors of one kind of sets: over the largest joint, and (n, 3) by joint."""

    kind: str
    sets: int
    largest_force_rms: Float[Tensor, "3"]
    force_rms: Float[Tensor, "n 3"]
    moment_rms: Float[Tensor, "n 3"]
    degree: Ends


@dataclass(frozen=True, eq=False)
class Variant:
    """The same question with other outer bounds.

    Attributes:
        name: what is different.
        medians: of the error, per kind that was found [N].
        deltas: Cliff's delta against the feasible sets, per other kind.
        rho: Spearman's, degree and error over all sets; value, low, high.
        reach: greatest errors of each kind; empty without Clarabel.
    """

    name: str
    medians: dict[str, Real]
    deltas: dict[str, Range]
    rho: Range
    reach: tuple[ForceReach, ...]


class ReferenceOfStudy(Part, frozen=True, kw_only=True):
    """What the sets have the torque of."""

    origin: str
    mass: Float[Tensor, " n"]
    torque_change_rms: Float[Tensor, " n"]
    force_rms: Float[Tensor, " n"]
    force_rms_to_nominal: Real


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
    comparison_to_nominal: Comparison | None
    thirds: tuple[ThirdSummary, ...]
    correlations: tuple[KindCorrelations, ...]
    matched: tuple[Matched, ...]
    across: tuple[Across, ...]
    other_truths: tuple[OtherTruths, ...]
    firm_truths: tuple[FirmTruths, ...]
    reach: tuple[ForceReach, ...]
    variants: tuple[Variant, ...]
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


def set_errors(
    ids: tuple[str, ...],
    degree: Float[Tensor, " K"],
    checked: Feasibility,
    errors: WrenchErrors,
    torque_relative: Float[Tensor, "K n"],
    carried: Float[Tensor, "K n"],
    kinds: tuple[str, ...] = (),
) -> tuple[SetErrors, ...]:
    """Sets one by one, with errors as of `EqualTorqueStudy` and `GivenSets`."""
    return tuple(
        SetErrors(
            id=name,
            kind=kinds[k] if kinds else UNSET,
            feasible=bool(checked.feasible[k]),
            reasons=checked.reasons(k),
            degree=float(degree[k]),
            force_rms=errors.force_rms[k],
            force_max=errors.force_max[k],
            force_norm_rms=errors.force_norm_rms[k],
            moment_rms=errors.moment_rms[k],
            torque_relative=torque_relative[k],
            carried=carried[k],
        )
        for k, name in enumerate(ids)
    )


_OTHER_BOUNDS = (
    ("outer bounds a quarter as far", 0.25, True),
    ("total mass unknown", 1.0, False),
    ("both", 0.25, False),
)
"""Names of other settings, share of the way to the outer bounds, whether the total mass counts."""
_REPORTS_PAIR = ("CoM only", "inertia only")
_CONDITION_KINDS = {
    "mass": "mass",
    "eigenvalue": "inertia",
    "triangle": "inertia",
    "shape": "shape",
}


@dataclass(frozen=True, eq=False)
class Drawn:
    """A family of sets with equal torque, and its errors against the reference.

    Attributes:
        setting: where it is from.
        family: the sets.
        checked: their feasibility.
        errors: of their wrenches.
        squares: (n, D, D) see `force_squares`.
        z: (K, D) the sets' coordinates in the null space.
    """

    setting: Setting
    family: EqualTorqueSets
    checked: Feasibility
    errors: WrenchErrors
    squares: Float[Tensor, "n D D"]
    z: Float[Tensor, "K D"]

    @property
    def carried(self) -> Float[Tensor, "K n"]:
        """(K, n) difference of the mass that each joint carries [kg]."""
        sets, reference = self.family.sets.parameters, self.setting.reference.parameters
        return (sets.mass - reference.mass).flip(-1).cumsum(-1).flip(-1)

    @property
    def worst(self) -> Float[Tensor, " K"]:
        """(K,) largest over the joints of the root mean square force error [N]."""
        return self.errors.force_rms.amax(-1)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds that have sets, in their order."""
        return tuple(dict.fromkeys(self.family.kind))

    def rows(self, kind: str) -> list[int]:
        """Indices of the sets of a kind."""
        return [k for k, own in enumerate(self.family.kind) if own == kind]

    def samples(self) -> Samples:
        """For the statistics."""
        return Samples(
            kind=np.array(self.family.kind),
            error=self.worst.numpy(),
            degree=self.degree.numpy(),
            carried=self.carried.abs().amax(-1).numpy(),
            coordinates=self.checked.violated[..., 3:6].sum((1, 2)).numpy(),
            tightest=self.tightest(),
            cluster=self.family.cluster.numpy(),
        )

    def distances(self) -> np.ndarray:
        """(F, K) force error of each set if feasible set f is the truth: by joint from z'G z."""
        feasible = self.rows(FEASIBLE)
        largest = self.z.new_zeros(len(feasible), len(self.z))
        for square in self.squares:
            values, vectors = torch.linalg.eigh(square)
            y = self.z @ (vectors * values.clamp(min=0.0).sqrt())
            largest = torch.maximum(largest, torch.cdist(y[feasible], y))
        return largest.numpy()

    def compared(self, resamples: int, seed: int, errors: WrenchErrors | None = None) -> Comparison:
        """By class and degree; each class against the feasible, and CoM against inertia."""
        reasons = [self.checked.reasons(k) for k in range(len(self.z))]
        present = ordered_classes(class_of(r) for r in reasons)
        pairs = [(name, present[0]) for name in present[1:]]
        pairs += [_REPORTS_PAIR] if set(_REPORTS_PAIR) <= set(present) else []
        return compare(
            (errors or self.errors).force_rms.amax(-1),
            reasons,
            self.degree,
            cluster=self.family.cluster,
            pairs=pairs,
            resamples=resamples,
            seed=seed,
        )

    @property
    def degree(self) -> Float[Tensor, " K"]:
        """(K,) smallest degree of the conditions on the links and on the total mass: coefficients
        of effects are the same in all sets."""
        return self._degrees().amin(-1)

    def tightest(self) -> np.ndarray:
        """(K,) kind of the condition with the smallest degree."""
        names = [_CONDITION_KINDS.get(c, "com") for c in LINK_CONDITIONS]
        names = [*names * self.checked.degrees.shape[1], "total_mass"]
        return np.array(names)[self._degrees().argmin(-1).numpy()]

    def _degrees(self) -> Float[Tensor, "K C"]:
        links = self.checked.degrees.flatten(1)
        return torch.cat([links, self.checked.total_mass_degree.unsqueeze(-1)], -1)


def draw(
    setting: Setting, motion: Motion, kinds: Sequence[str], per_kind: int, chains: int, seed: int
) -> Drawn:
    """Draw the sets of each kind and compare their wrenches with the reference's.

    Raises:
        TorchidError: there is no other feasible set, so nothing to compare with.
    """
    reference = setting.reference
    family = equal_torque_sets(
        setting.robot,
        setting.base,
        reference,
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
    space = equal_torque_space(reference, setting.base, setting.conditions, setting.outer)
    own = InertialParameters(reference.parameters.pi[0])
    rigid = family.sets.parameters
    return Drawn(
        setting=setting,
        family=family,
        checked=feasibility(family.sets, setting.conditions),
        errors=wrench_errors(setting.robot, *motion.state, rigid, own),
        squares=force_squares(setting.robot, motion, space.directions),
        z=(rigid.to_paper_order() - space.x) @ space.directions,
    )


Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class EqualTorqueStudy(Drawn, Result):
    """What was found of a family. All errors of forces are against `setting.reference`.

    Attributes:
        motion: on which forces were compared.
        rate: samples per second of the motion [Hz]; None for a motion that was given.
        torque_relative: (K, n) root mean square of the difference of the joint torques over that of
            the torque itself: rounding.
        comparison: of the largest force error over the joints, by class and degree.
        statistics: thirds of the degree, correlations, comparison at equal carried mass.
        truths, firm_truths: with every feasible set as the truth.
        reach: greatest force errors of any set of each kind.
        static_share: median, and range of 95 %, of what the weight of `carried` is of the largest
            force error.
        to_nominal: the same comparison with the errors against the robot's nominal parameters,
            where these are not the reference; the torque then differs by `setting.torque_change`.
        reference_to_nominal: force error between reference and nominal parameters [N].
        variants: with other outer bounds.
        seed: of everything.
        warnings: sentences for the user.
    """

    motion: Motion
    rate: float | None
    torque_relative: Float[Tensor, "K n"]
    comparison: Comparison
    statistics: Statistics
    truths: tuple[OtherTruths, ...]
    firm_truths: tuple[FirmTruths, ...]
    reach: tuple[ForceReach, ...]
    static_share: tuple[float, float, float]
    to_nominal: Comparison | None
    reference_to_nominal: float
    variants: tuple[Variant, ...]
    seed: int
    warnings: tuple[str, ...]

    def __repr__(self) -> str:
        name = self.setting.robot.name
        return f"EqualTorqueStudy('{name}', {len(self.z)} sets of {len(self.kinds)} kinds)"

    @cached_property
    def record(self) -> EqualTorqueRecord:
        """As the JSON has it."""
        return study_record(self)


def equal_torque_study(
    robot: RobotLike,
    *,
    per_kind: int = 200,
    chains: int = 40,
    kinds: Sequence[str] = KINDS,
    setting: Setting | None = None,
    margin: float = MARGIN,
    motion: Motion | None = None,
    with_variants: bool = True,
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
        with_variants: whether the question is asked again with other outer bounds.
        resamples: of the bootstrap.
        seed: of all draws.
        progress: called with (stage, done, total).

    Raises:
        TorchidError: no bounds, no feasible set, no feasible set drawn, or `feasible` not asked
            for.

    >>> import torchid
    >>> robot, few = torchid.load_robot("3r"), ("feasible", "inertia")
    >>> study = equal_torque_study(
    ...     robot, per_kind=8, chains=4, kinds=few, with_variants=False, resamples=20
    ... )
    >>> bool(study.torque_relative.max() < 1e-9), float(study.errors.force_rms.max()) > 1
    (True, True)
    """
    robot = as_robot(robot)
    if FEASIBLE not in kinds:
        raise TorchidError("the kinds must include feasible sets.", got=list(kinds))
    setting = setting or equal_torque_setting(robot, margin=margin)
    rate = RATE if motion is None else None
    motion = motion or reference_motion(robot, seed)
    total = 3 if with_variants else 2
    tell: Progress = progress or (lambda stage, done, total: None)
    tell("sets with equal torque", 0, total)
    drawn = draw(setting, motion, kinds, per_kind, chains, seed)
    tell("statistics and greatest errors", 1, total)
    samples = drawn.samples()
    # Against the nominal parameters, and how far the reference is from them.
    to_nominal, offset = None, 0.0
    if setting.origin != "nominal":
        errors, apart = (
            wrench_errors(setting.robot, *motion.state, sets.parameters, _first(setting.nominal))
            for sets in (drawn.family.sets, setting.reference)
        )
        to_nominal = drawn.compared(resamples, seed, errors)
        offset = float(apart.force_rms.amax())
    reach = _reach(setting, drawn.squares)
    truths, firm = other_truths(samples.kind, samples.degree, drawn.distances())
    found = statistics(samples, resamples=resamples, seed=seed)
    tau = inverse_dynamics(setting.robot, *motion.state, _first(setting.reference))
    weight = samples.carried * float(setting.robot.gravity.norm())
    comparison = drawn.compared(resamples, seed)
    variants = []
    if with_variants:
        tell("other outer bounds", 2, total)
    for name, share, total_mass in _OTHER_BOUNDS if with_variants else ():
        other = setting.widened(name, share, total_mass=total_mass)
        more = draw(other, motion, kinds, per_kind, chains, seed)
        compared = more.compared(resamples, seed)
        worst = more.worst.numpy()
        medians = {kind: float(np.median(worst[more.rows(kind)])) for kind in more.kinds}
        deltas = {
            e.first: (e.delta.value, e.delta.low, e.delta.high)
            for e in compared.effects
            if e.second == "feasible"
        }
        rho = compared.correlation.rho
        far = _reach(other, more.squares)
        variants.append(Variant(name, medians, deltas, (rho.value, rho.low, rho.high), far))
    tell("done", total, total)
    return EqualTorqueStudy(
        **vars(drawn),
        motion=motion,
        rate=rate,
        torque_relative=drawn.errors.torque_rms / tau.square().mean(0).sqrt(),
        comparison=comparison,
        statistics=found,
        truths=truths,
        firm_truths=firm,
        reach=reach,
        static_share=middle_range(weight / samples.error),
        to_nominal=to_nominal,
        reference_to_nominal=offset,
        variants=tuple(variants),
        seed=seed,
        warnings=(*setting.notes, *drawn.family.warnings),
    )


def _reach(setting: Setting, squares: Float[Tensor, "n D D"]) -> tuple[ForceReach, ...]:
    """Greatest errors."""
    space = equal_torque_space(setting.reference, setting.base, setting.conditions, setting.outer)
    return force_reach(space, squares)


def _first(one: ParameterSets) -> InertialParameters:
    return InertialParameters(one.parameters.pi[0])


def study_record(study: EqualTorqueStudy) -> EqualTorqueRecord:
    """A study of sets with equal torque; numbers that are not known are null."""
    setting, found = study.setting, study.statistics
    total = setting.conditions.total_mass.tolist()
    return EqualTorqueRecord.of(
        study,
        found,
        robot=setting.robot.name,
        geometry=setting.geometry,
        outer=setting.outer.name,
        total_mass=(total[0], total[1]),
        reference=ReferenceOfStudy(
            origin=setting.origin,
            mass=setting.reference.parameters.mass[0],
            torque_change_rms=setting.torque_change,
            force_rms=study.errors.reference_force_rms,
            force_rms_to_nominal=float(study.reference_to_nominal),
        ),
        instants=study.motion.q.shape[0],
        torque_relative_max=float(study.torque_relative.max()),
        kinds=tuple(_kind(study, kind) for kind in study.kinds),
        comparison_to_nominal=study.to_nominal,
        other_truths=study.truths,
        firm_truths=study.firm_truths,
        sets=set_errors(
            study.family.sets.ids,
            study.degree,
            study.checked,
            study.errors,
            study.torque_relative,
            study.carried,
            study.family.kind,
        ),
    )


def _kind(study: EqualTorqueStudy, kind: str) -> KindRecord:
    rows = study.rows(kind)

    def three(x: torch.Tensor) -> torch.Tensor:
        return torch.quantile(x[rows], x.new_tensor([0.25, 0.5, 0.75]), dim=0).movedim(0, -1)

    return KindRecord(
        kind=kind,
        sets=len(rows),
        largest_force_rms=three(study.worst),
        force_rms=three(study.errors.force_rms),
        moment_rms=three(study.errors.moment_rms),
        degree=(float(study.degree[rows].min()), float(study.degree[rows].max())),
    )
