"""Comparisons of internal wrenches as their JSON has them: the schema torchid.wrenches/1."""

from dataclasses import dataclass
from typing import Literal

from msgspec import UNSET, UnsetType, field

from torchid.feasibility.margins import Feasibility
from torchid.results.record import Ends, Part, Real, Record, Rows
from torchid.study.equal_torque.force_reach import ForceReach
from torchid.study.equal_torque.statistics import (
    Across,
    FirmTruths,
    KindCorrelations,
    Matched,
    OtherTruths,
    Range,
    ThirdSummary,
)
from torchid.typing import Float, Tensor
from torchid.wrenches.compare import Comparison
from torchid.wrenches.deviation import WrenchErrors


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
