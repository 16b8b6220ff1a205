"""What an identification found, and what its user must know about it."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from torchid.effects.base import Effect
from torchid.effects.registry import COLUMN_KINDS
from torchid.identification.base_parameters import BaseParameters, physical_signs
from torchid.identification.model import IdentifiedModel
from torchid.identification.record import (
    EffectRecord,
    Errors,
    FittedRows,
    IdentificationRecord,
)
from torchid.identification.settings import Settings
from torchid.identification.statistics import Uncertainty
from torchid.identification.tuning import CutoffChoice
from torchid.identification.validation import Prediction
from torchid.json_data import plain
from torchid.results.record import Result
from torchid.robot.knowledge import Knowledge, to_mapping
from torchid.robot.library import named_record
from torchid.robot.model import Robot
from torchid.typing import Bool, Float, Tensor

UNEXPLAINED = 50.0
"""Relative torque error above which a joint's model is called useless [%]."""


@dataclass(frozen=True, eq=False)
class Identification(IdentifiedModel, Result):
    """Base parameters identified from logs.

    Attributes:
        robot: as given.
        base: the base parameters' structure.
        effects: linear effects, in the order of their coefficients.
        values: (B,) in the order of `base.names`.
        covariance: (B, B), block-robust.
        factor: (B + 1, B + 1) R of the fitted rows [Y_R tau], weighted as in the fit, columns in
            the order of `base.names`: || R (x, -1) ||^2 is the fit's sum of squares at x.
        rows: how many rows a second, and their weights.
        free: (B,) estimated. The others are 0: bounded, undetermined or not essential.
        bounded, undetermined, dropped: names of those others.
        wrong_sign: names that came out negative against physics and were kept (signs = free).
        fit, held_out: errors; held_out is None without data to hold out.
        fit_predictions, held_out_predictions: measured and predicted torque.
        condition_number, scaled_condition_number: of the regressor of the free parameters.
        cutoff: [Hz] used, or None.
        cutoff_choice: what was tried, if it was automatic.
        reversal: (n,) speed at which each joint's direction counts as reversed [rad/s or m/s].
        uncertainty: blocks, correlation time.
        settings: as given.
        warnings: sentences for the user, without repetition.
        knowledge: of base parameters and coefficients, this log's and what was known before.
    """

    robot: Robot
    base: BaseParameters
    effects: tuple[Effect, ...]
    values: Float[Tensor, " B"]
    covariance: Float[Tensor, "B B"]
    factor: Float[Tensor, "C C"]
    rows: FittedRows
    free: Bool[Tensor, " B"]
    bounded: tuple[str, ...]
    undetermined: tuple[str, ...]
    dropped: tuple[str, ...]
    wrong_sign: tuple[str, ...]
    fit: Errors
    held_out: Errors | None
    fit_predictions: tuple[Prediction, ...]
    held_out_predictions: tuple[Prediction, ...]
    condition_number: float
    scaled_condition_number: float
    cutoff: float | None
    cutoff_choice: CutoffChoice | None
    reversal: Float[Tensor, " n"]
    uncertainty: Uncertainty
    settings: Settings
    warnings: tuple[str, ...]
    knowledge: Knowledge | None = None

    def __repr__(self) -> str:
        shown = self.fit if self.held_out is None else self.held_out
        percent = [v for v in shown.judged(self.settings.rows).tolist() if math.isfinite(v)]
        where = "fitted" if self.held_out is None else "held-out"
        error = f"{min(percent):.1f} to {max(percent):.1f} % by joint" if percent else "unknown"
        return (
            f"Identification('{self.robot.name}', {self.base.n_rigid} base parameters, "
            f"{len(self.base) - self.base.n_rigid} coefficients of effects, {where} torque error "
            f"{error})"
        )

    @cached_property
    def record(self) -> IdentificationRecord:
        """As the JSON has it."""
        base, estimates = self.base, self.estimates
        # Base parameters led by an effect's coefficient that are sums with others.
        combined = [b for b in range(base.n_rigid, len(base)) if not base.is_single(b)]
        return IdentificationRecord.of(
            self,
            **named_record(self.robot),
            n_base=base.n_rigid,
            basis=base.basis,
            parameters=estimates[: base.n_rigid],
            effects=self._effects(),
            combined=[estimates[b] for b in combined],
            absorbed=base.absorbed_effects(),
            rank_gap=base.rank_gap,
            grouping=base,
            base_names=base.names,
            statistics=self.uncertainty,
            model=self.robot,
            sure=None if self.knowledge is None else to_mapping(self.knowledge),
        )

    def _effects(self) -> list[EffectRecord]:
        """One entry a kind of effect."""
        # Base parameter led by each independent parameter.
        position = {k: b for b, k in enumerate(self.base.independent)}
        start = self.base.n_rigid_parameters
        by_effect: dict[str, dict[str, Any]] = {}
        for effect in self.effects:
            names = [c.name for c in effect.coefficients]
            entry = by_effect.setdefault(
                effect.name,
                {
                    "effect": effect.name,
                    "joints": [],
                    "parameters": {name: [] for name in names},
                    "std": {name: [] for name in names},
                },
            )
            own = [position.get(start + c) for c in range(len(names))]
            start += len(names)
            single = [b if b is not None and self.base.is_single(b) else None for b in own]
            if all(b is None for b in single):
                continue
            entry["joints"].append(effect.identity[1][0] + 1)
            for name, b in zip(names, single, strict=True):
                known = b is not None and bool(self.free[b])
                entry["parameters"][name].append(None if b is None else float(self.values[b]))
                entry["std"][name].append(float(self.std[b]) if known else None)
        for name, entry in by_effect.items():
            members = [e for e in self.effects if e.name == name]
            if name not in COLUMN_KINDS or len(members) < self.robot.n:
                # Effects without their coefficients, as `effect_from_record` takes them.
                records = [e.record([0.0] * len(e.coefficients)) for e in members]
                left_out = {"effect", *entry["parameters"]}
                entry["places"] = plain(
                    [{k: v for k, v in r.items() if k not in left_out} for r in records]
                )
        return [EffectRecord.of(**entry) for entry in by_effect.values()]

    @property
    def model(self) -> Robot:
        """The robot, as what is loaded calls it."""
        return self.robot

    @property
    def placed(self) -> tuple[Effect, ...]:
        """The effects, as what is loaded calls them."""
        return self.effects


def findings(result: Identification) -> list[str]:
    """What a user must know about a result, one sentence each."""
    fit = (*_of_no_body(result), *_of_the_cutoff(result), *_of_the_errors(result))
    return [*of_parameters(result), *fit]


def of_parameters(result: Identification) -> list[str]:
    """Which base parameters and coefficients are no estimates, one sentence a kind."""
    lists = {
        "this log does not determine, for want of excitation (set to 0)": result.undetermined,
        "fitted negative, set to 0": result.bounded,
        "fitted negative, which physics forbids, and kept": result.wrong_sign,
        "not distinguishable from 0, dropped as not essential": result.dropped,
    }
    return [f"{words}: {', '.join(names)}" for words, names in lists.items() if names]


def _of_no_body(result: Identification) -> list[str]:
    """Values that no body has."""
    # Sums whose 95 % interval lies where no body's value can.
    signs = physical_signs(result.base, result.effects).to(result.values)
    far = (signs * result.values + result.uncertainty.quantile() * result.std < 0) & result.free
    known = set(result.wrong_sign)
    bad = [k for k in far.nonzero().flatten().tolist() if result.base.names[k] not in known]
    listed = "; ".join(
        f"{result.base.names[k]} = {float(result.values[k]):.3g} +- {float(result.std[k]):.2g} "
        f"{result.base.units[k]}, never {'negative' if signs[k] > 0 else 'positive'}"
        for k in bad
    )
    words = "no body has these values, so no physical parameters give exactly this torque: "
    return [words + listed] if bad else []


def _of_the_cutoff(result: Identification) -> list[str]:
    """The best cut-off may be one that was not tried."""
    choice = result.cutoff_choice
    if choice is None or choice.cutoff is None:
        return []
    pairs = zip(choice.candidates, choice.scores, strict=True)
    tried = [(f, score) for f, score in pairs if f is not None]
    if len(tried) < 2 or tried[-1][0] != choice.cutoff:
        return []
    (_, before), (last, at) = tried[-2:]
    return [
        f"the cut-off chosen, {last:g} Hz, is the highest that was tried, and the "
        f"cross-validated error still falls there ({before:.4g} to {at:.4g} %): "
        "`cutoff=...` sets a higher one"
    ]


def _of_the_errors(result: Identification) -> list[str]:
    """Joints whose torque is not followed, and rows at rest."""
    said = []
    # Joints whose torque the model does not follow.
    shown, label = (
        (result.fit, "fitted") if result.held_out is None else (result.held_out, "held-out")
    )
    moving = shown.relative_percent_moving.tolist()
    useless = [
        f"{j} ({v:.0f} %)" for j, v in enumerate(moving, start=1) if UNEXPLAINED < v < math.inf
    ]
    if useless:
        said.append(
            f"the model leaves more than half of the {label} torque unexplained on joint "
            + ", ".join(useless)
            + ": unless that torque is the sensor's noise, or small beside gravity's and inertia's "
            "(a free swing, a hand's push), check the robot, the joints' order and signs, the gains"
        )
    # Rows at rest that were fitted as if half of the friction were there.
    shares = enumerate(result.fit.standstill_fraction.tolist(), start=1)
    # 0.2: share of the fitted rows at rest above which a joint's friction is said to be biased
    still = [f"{j} ({100 * share:.0f} %)" for j, share in shares if share > 0.2]
    if still and result.settings.rows == "all" and any(e.jumps for e in result.effects):
        said.append(
            "stand still in much of the fitted rows, where friction can hold any torque: joint "
            f"{', '.join(still)}; their friction is biased, "
            '`rows="moving"` (the default) leaves these rows out'
        )
    # Standstill holds much of the error: friction at rest can hold any torque.
    for where, e in (("fit", result.fit), ("held-out data", result.held_out)):
        # Rows that took no part in the fit say nothing about it.
        if e is None or (e is result.fit and result.settings.rows == "moving"):
            continue
        rest = zip(e.standstill_fraction.tolist(), e.standstill_error_share.tolist(), strict=True)
        held = [
            f"{j} ({100 * rows:.0f} % of the rows, {100 * share:.0f} % of the error)"
            for j, (rows, share) in enumerate(rest, start=1)
            if share > 0.5 and rows > 0.02
        ]
        if held:
            said.append(
                f"{where}: rows at rest hold most of the squared error, joint {', '.join(held)}; "
                "compare the rows `moving`"
            )
    return said
