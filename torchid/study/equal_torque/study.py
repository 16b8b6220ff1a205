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

import numpy as np

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Motion
from torchid.errors import MissingExtraError, TorchidError
from torchid.extraction.equal_torque.sample import FEASIBLE, KINDS, EqualTorqueSets
from torchid.extraction.equal_torque.space import equal_torque_space
from torchid.feasibility.margins import Feasibility
from torchid.feasibility.sets import ParameterSets
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.study.equal_torque.family import Drawn, draw
from torchid.study.equal_torque.force_reach import ForceReach, force_reach
from torchid.study.equal_torque.other_truths import FirmTruths, OtherTruths, other_truths
from torchid.study.equal_torque.setting import (
    MARGIN,
    RATE,
    Setting,
    equal_torque_setting,
    reference_motion,
)
from torchid.study.equal_torque.statistics import Statistics, statistics
from torchid.typing import Float, Tensor
from torchid.wrenches.compare import RESAMPLES, Comparison
from torchid.wrenches.deviation import WrenchErrors, wrench_errors

Progress = Callable[[str, int, int], None]


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
    medians: dict[str, float]
    deltas: dict[str, tuple[float, float, float]]
    rho: tuple[float, float, float]
    reach: tuple[ForceReach, ...]


@dataclass(frozen=True, eq=False)
class EqualTorqueStudy:
    """What was found. All errors of forces are against `setting.reference`.

    Attributes:
        setting: robot, conditions, outer bounds, reference.
        motion: on which forces were compared.
        rate: samples per second of the motion [Hz]; None for a motion that was given.
        family: the sets.
        checked: their feasibility.
        errors: of their wrenches, per set and joint.
        torque_relative: (K, n) root mean square of the difference of the joint torques over that of
            the torque itself: rounding.
        degree: (K,) of the conditions on links and total mass, see `Drawn.degree`.
        carried: (K, n) difference of the mass that each joint carries [kg].
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

    setting: Setting
    motion: Motion
    rate: float | None
    family: EqualTorqueSets
    checked: Feasibility
    errors: WrenchErrors
    torque_relative: Float[Tensor, "K n"]
    degree: Float[Tensor, " K"]
    carried: Float[Tensor, "K n"]
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


def equal_torque_study(
    robot: Robot,
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
    """The whole question for one robot.

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
    """
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
    to_nominal, offset = _to_nominal(drawn, motion, resamples, seed)
    reach, warnings = _reach(setting, drawn.squares)
    truths, firm = other_truths(samples.kind, samples.degree, drawn.distances())
    variants: tuple[Variant, ...] = ()
    found = statistics(samples, resamples=resamples, seed=seed)
    tau = inverse_dynamics(setting.robot, *motion.state, _first(setting.reference))
    weight = samples.carried * float(setting.robot.gravity.norm())
    low, middle, high = np.percentile(weight / samples.error, [2.5, 50, 97.5]).tolist()
    comparison = drawn.compared(resamples, seed)
    if with_variants:
        tell("other outer bounds", 2, total)
        variants = _variants(setting, motion, kinds, per_kind, chains, resamples, seed)
    tell("done", total, total)
    return EqualTorqueStudy(
        setting=setting,
        motion=motion,
        rate=rate,
        family=drawn.family,
        checked=drawn.checked,
        errors=drawn.errors,
        torque_relative=drawn.errors.torque_rms / tau.square().mean(0).sqrt(),
        degree=drawn.degree,
        carried=drawn.carried,
        comparison=comparison,
        statistics=found,
        truths=truths,
        firm_truths=firm,
        reach=reach,
        static_share=(middle, low, high),
        to_nominal=to_nominal,
        reference_to_nominal=offset,
        variants=variants,
        seed=seed,
        warnings=(*setting.notes, *drawn.family.warnings, *warnings),
    )


def _reach(
    setting: Setting, squares: Float[Tensor, "n D D"]
) -> tuple[tuple[ForceReach, ...], tuple[str, ...]]:
    """Greatest errors; a warning instead where the solver is not installed."""
    space = equal_torque_space(setting.reference, setting.base, setting.conditions, setting.outer)
    try:
        return force_reach(space, squares), ()
    except MissingExtraError as error:
        return (), (f"no greatest errors: {error.problem}",)


def _first(one: ParameterSets) -> InertialParameters:
    return InertialParameters(one.parameters.pi[0])


def _to_nominal(
    drawn: Drawn, motion: Motion, resamples: int, seed: int
) -> tuple[Comparison | None, float]:
    """The comparison against the nominal parameters, and how far the reference is from them."""
    setting = drawn.setting
    if setting.origin == "nominal":
        return None, 0.0
    own = _first(setting.nominal)
    errors, offset = (
        wrench_errors(setting.robot, *motion.state, sets.parameters, own)
        for sets in (drawn.family.sets, setting.reference)
    )
    return drawn.compared(resamples, seed, errors), float(offset.force_rms.amax())


def _variants(
    setting: Setting,
    motion: Motion,
    kinds: Sequence[str],
    per_kind: int,
    chains: int,
    resamples: int,
    seed: int,
) -> tuple[Variant, ...]:
    asked = (
        ("outer bounds a quarter as far", 0.25, True),
        ("total mass unknown", 1.0, False),
        ("both", 0.25, False),
    )
    found = []
    for name, share, total_mass in asked:
        other = setting.widened(name, share, total_mass=total_mass)
        drawn = draw(other, motion, kinds, per_kind, chains, seed)
        compared = drawn.compared(resamples, seed)
        rho = compared.correlation.rho
        worst, own = drawn.samples().error, np.array(drawn.family.kind)
        medians = {k: float(np.median(worst[own == k])) for k in dict.fromkeys(drawn.family.kind)}
        deltas = {
            e.first: (e.delta.value, e.delta.low, e.delta.high)
            for e in compared.effects
            if e.second == "feasible"
        }
        reach, _ = _reach(other, drawn.squares)
        found.append(Variant(name, medians, deltas, (rho.value, rho.low, rho.high), reach))
    return tuple(found)
