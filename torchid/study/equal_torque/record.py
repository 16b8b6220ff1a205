"""Comparisons of internal wrenches as their JSON has them: the schema torchid.wrenches/1."""

from typing import Literal

import torch
from msgspec import UNSET, UnsetType, field

from torchid.results.record import Ends, Part, Real, Record, Rows
from torchid.study.equal_torque.force_reach import ForceReach
from torchid.study.equal_torque.given_sets import GivenSets
from torchid.study.equal_torque.statistics import (
    Across,
    FirmTruths,
    KindCorrelations,
    Matched,
    OtherTruths,
    Range,
    ThirdSummary,
)
from torchid.study.equal_torque.study import EqualTorqueStudy, Variant
from torchid.typing import Float, Tensor
from torchid.wrenches.compare import Comparison


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


def study_record(study: EqualTorqueStudy) -> EqualTorqueRecord:
    """A study of sets with equal torque; numbers that are not known are null."""
    setting, statistics = study.setting, study.statistics
    total = setting.conditions.total_mass.tolist()
    return EqualTorqueRecord(
        robot=setting.robot.name,
        seed=study.seed,
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
        static_share=study.static_share,
        kinds=tuple(_kind(study, kind) for kind in study.kinds),
        comparison=study.comparison,
        comparison_to_nominal=study.to_nominal,
        thirds=statistics.thirds,
        correlations=statistics.correlations,
        matched=statistics.matched,
        across=statistics.across,
        other_truths=study.truths,
        firm_truths=study.firm_truths,
        reach=study.reach,
        variants=study.variants,
        warnings=study.warnings,
        sets=_sets(study, study.family.sets.ids, study.degree, study.family.kind),
    )


def given_record(found: GivenSets, source: tuple[str, ...] = ()) -> GivenSetsRecord:
    """A comparison of given sets with a reference.

    Args:
        found: what was found.
        source: files of the sets.
    """
    return GivenSetsRecord(
        robot=found.robot.name,
        source=source,
        reference=GivenReference(
            id=found.reference.ids[0],
            force_rms=found.errors.reference_force_rms,
            moment_rms=found.errors.reference_moment_rms,
        ),
        instants=found.motion.q.shape[0],
        torque_relative_max=float(found.torque_relative.max()),
        comparison=found.comparison,
        sets=_sets(found, found.sets.ids, found.checked.degree),
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


def _sets(
    found: EqualTorqueStudy | GivenSets,
    ids: tuple[str, ...],
    degree: Float[Tensor, " K"],
    kinds: tuple[str, ...] = (),
) -> tuple[SetErrors, ...]:
    errors = found.errors
    return tuple(
        SetErrors(
            id=name,
            kind=kinds[k] if kinds else UNSET,
            feasible=bool(found.checked.feasible[k]),
            reasons=found.checked.reasons(k),
            degree=float(degree[k]),
            force_rms=errors.force_rms[k],
            force_max=errors.force_max[k],
            force_norm_rms=errors.force_norm_rms[k],
            moment_rms=errors.moment_rms[k],
            torque_relative=found.torque_relative[k],
            carried=found.carried[k],
        )
        for k, name in enumerate(ids)
    )
