"""Several identifications of one type of arm: what agrees, drifts, or is never determined."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import get_args

import torch

from torchid.compare.basis import Common, common_basis
from torchid.compare.reading import Identified
from torchid.compare.record import (
    BirgeRecord,
    ComparedParameter,
    ComparisonRecord,
    Judged,
    TorqueSpread,
    Verdict,
)
from torchid.compare.scatter import Scatter, Whole, holm, monotone, scatter, typical_birge, whole
from torchid.compare.torque import identified_spread
from torchid.errors import TorchidError
from torchid.log.model import Log
from torchid.results.record import Result
from torchid.robot.model import Robot
from torchid.typing import Bool, Float, Tensor

ALPHA = 0.05
"""Family-wise level, and 1 - that of the intervals."""

UNKNOWN = 50.0
"""Relative standard deviation from which a value cannot be told from zero [%]."""


@dataclass(frozen=True)
class Compared:
    """One parameter.

    Attributes:
        name, unit: as in the results.
        verdict: `differ`: Welch's test rejects equal values at 5 % after Holm's correction;
            `drift`: and the values rise or fall from each result to the next; `never_determined`:
            relative standard deviation above 50 % in every result that has it; `not_compared`:
            estimated in fewer than two results; else `agree`.
        values, std: (m,) per result; std is nan where it is not estimated, value where it is not
            even in the result's structure.
        held: (m,) held at zero by the fit.
        scatter: None where not compared.
        p_holm: adjusted for all parameters compared.
    """

    name: str
    unit: str
    verdict: Verdict
    values: Float[Tensor, " m"]
    std: Float[Tensor, " m"]
    held: Bool[Tensor, " m"]
    scatter: Scatter | None
    p_holm: float | None


@dataclass(frozen=True)
class Comparison(Judged[Compared], Result):
    """All of it.

    Attributes:
        labels: (m,) of the results, in the order given.
        robot: its name, or names.
        quantiles: (m,) half-widths of the results' 95 % intervals in standard deviations.
        parameters: every parameter that any result has.
        whole: all parameters that every result estimates, with their correlations; None where
            there are none.
        birge: of the typical parameter (median); None if nothing was compared.
        torque: None without the robot.
        notes: sentences for the user.
        same_motion: whether two were fitted on a trajectory of the same name.
    """

    labels: tuple[str, ...]
    robot: str
    quantiles: tuple[float, ...]
    parameters: tuple[Compared, ...]
    whole: Whole | None
    birge: float | None
    torque: TorqueSpread | None
    notes: tuple[str, ...]
    same_motion: bool = False

    def __repr__(self) -> str:
        return (
            f"Comparison('{self.robot}', {len(self.labels)} identifications, "
            f"{len(self.having('agree'))} of {len(self.parameters)} parameters agree)"
        )

    @cached_property
    def record(self) -> ComparisonRecord:
        """As the JSON has it."""
        whole = self.whole
        return ComparisonRecord.of(
            self,
            results=self.labels,
            compared="identifications",
            counts={verdict: len(self.having(verdict)) for verdict in get_args(Verdict)},
            parameters=[ComparedParameter.of(p, p.scatter, std=p.std) for p in self.parameters],
            correction="Holm, family-wise 5 %",
            birge=BirgeRecord(
                pooled=None if whole is None else whole.pooled,
                pooled_expected=None if whole is None else whole.pooled_expected,
                typical=self.birge,
            ),
        )


def compare_identifications(
    results: Sequence[Identified],
    *,
    robot: Robot | None = None,
    on: Log | None = None,
    seed: int = 0,
) -> Comparison:
    """Compare two or more identifications, in the order given.

    Args:
        results: from `read_identification`.
        robot: for the torque; that of the first result which recorded its own if None.
        on: a log whose motion (and torque) the models are compared on; random motion if None.
        seed: of random motion and of the null distribution of the whole.

    Raises:
        TorchidError: results of different kinematics, or a log but no robot.
    """
    common = common_basis(results)
    robot = robot or next((r.record.model for r in results if r.record.model is not None), None)
    if robot is None and on is not None:
        raise TorchidError("torque along a log needs the robot.", expected="`robot=...`")
    freedom = torch.tensor(
        [float(max(1, r.record.statistics.blocks - 1)) for r in results], dtype=torch.float64
    )
    parameters = _parameters(common, freedom)
    pairs = [
        (p.scatter.birge, int(torch.isfinite(p.std).sum()))
        for p in parameters
        if p.scatter is not None
    ]
    birge = typical_birge(*torch.tensor(pairs, dtype=torch.float64).T) if pairs else None
    # All parameters that every result estimates.
    every = (common.estimated.all(0) & (common.std > 0).all(0)).nonzero().flatten()
    together = None
    if len(every):
        covariance, correlation = (
            x[:, every][:, :, every] for x in (common.covariance, common.correlation)
        )
        values = common.values[:, every]
        together = whole(values, covariance, correlation, freedom, seed=seed)
    fitted = [name for r in results for name in set(r.record.fit.trajectories)]
    names = list(dict.fromkeys(r.record.robot for r in results if r.record.model is not None))
    return Comparison(
        labels=tuple(r.label for r in results),
        robot=" and ".join(names) if names else "the arm",
        quantiles=tuple(r.record.statistics.quantile95 for r in results),
        parameters=parameters,
        whole=together,
        birge=birge,
        torque=None if robot is None else identified_spread(results, robot, on=on, seed=seed),
        notes=common.notes
        + tuple(f"{r.label} holds what was known before its log ({', '.join(r.earlier)}), and "
                "agrees with results of the same sessions for that" for r in results if r.earlier)
        + (() if robot is not None else ("no torque: these results did not record their robot; "
           "`robot=...` names it",)),
        same_motion=len(set(fitted)) < len(fitted),
    )  # fmt: skip


def _parameters(common: Common, freedom: Tensor) -> tuple[Compared, ...]:
    found: list[Scatter | None] = []
    for k in range(len(common.names)):
        own = common.estimated[:, k]
        many = int(own.sum()) > 1
        values, std = common.values[own, k], common.std[own, k]
        found.append(scatter(values, std, freedom[own]) if many else None)
    p = holm(torch.tensor([s.p for s in found if s is not None], dtype=torch.float64)).tolist()
    out = []
    for k, one in enumerate(found):
        own = common.estimated[:, k]
        values = torch.where(common.determined[:, k], common.values[:, k], torch.nan)
        std = torch.where(own, common.std[:, k], torch.nan)
        relative = 100 * std[own] / values[own].abs()
        adjusted = None if one is None else p.pop(0)
        verdict: Verdict
        if adjusted is None:
            verdict = "not_compared"
        elif adjusted < ALPHA:
            verdict = "drift" if bool(own.all()) and monotone(values) else "differ"
        else:
            verdict = "never_determined" if bool((relative > UNKNOWN).all()) else "agree"
        name, unit, held = common.names[k], common.units[k], common.held[:, k]
        out.append(Compared(name, unit, verdict, values, std, held, one, adjusted))
    return tuple(out)
