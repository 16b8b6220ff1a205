"""Several identifications of one type of arm: what agrees, drifts, or is never determined."""

from collections.abc import Sequence
from typing import get_args

import torch
from msgspec.structs import replace

from torchid.compare.basis import Common, common_basis
from torchid.compare.reading import Identified
from torchid.compare.record import (
    BirgeRecord,
    ComparedParameter,
    Comparison,
    Verdict,
)
from torchid.compare.scatter import Scatter, holm, monotone, scatter, typical_birge, whole
from torchid.compare.torque import identified_spread
from torchid.errors import TorchidError
from torchid.log.model import Log
from torchid.robot.model import Robot
from torchid.typing import Tensor

ALPHA = 0.05
"""Family-wise level, and 1 - that of the intervals."""

UNKNOWN = 50.0
"""Relative standard deviation from which a value cannot be told from zero [%]."""


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
    pairs = [(p.birge, int(torch.isfinite(p.std).sum())) for p in parameters if p.birge is not None]
    typical = typical_birge(*torch.tensor(pairs, dtype=torch.float64).T) if pairs else None
    # All parameters that every result estimates.
    every = (common.estimated.all(0) & (common.std > 0).all(0)).nonzero().flatten()
    together, birge = None, BirgeRecord()
    if len(every):
        covariance, correlation = (
            x[:, every][:, :, every] for x in (common.covariance, common.correlation)
        )
        values = common.values[:, every]
        together, birge = whole(values, covariance, correlation, freedom, seed=seed)
    fitted = [name for r in results for name in set(r.record.fit.trajectories)]
    names = list(dict.fromkeys(r.record.robot for r in results if r.record.model is not None))
    notes = [
        *common.notes,
        *(
            f"{r.label} holds what was known before its log ({', '.join(r.earlier)}), and agrees "
            "with results of the same sessions for that"
            for r in results
            if r.earlier
        ),
    ]
    if robot is None:
        notes.append("no torque: these results did not record their robot; `robot=...` names it")
    return Comparison(
        robot=" and ".join(names) if names else "the arm",
        labels=tuple(r.label for r in results),
        counts={v: sum(p.verdict == v for p in parameters) for v in get_args(Verdict)},
        parameters=parameters,
        birge=replace(birge, typical=typical),
        whole=together,
        torque=None if robot is None else identified_spread(results, robot, on=on, seed=seed),
        notes=tuple(notes),
        quantiles=tuple(r.record.statistics.quantile95 for r in results),
        same_motion=len(set(fitted)) < len(fitted),
    )


def _parameters(common: Common, freedom: Tensor) -> tuple[ComparedParameter, ...]:
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
        out.append(
            ComparedParameter.of(
                one, name=common.names[k], unit=common.units[k], verdict=verdict, values=values,
                std=std, held=common.held[:, k], p_holm=adjusted,
            )
        )  # fmt: skip
    return tuple(out)
