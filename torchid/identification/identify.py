"""From a robot and its logs to base parameters: the whole job as one call."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch

from torchid.effects.base import Effect, Motion
from torchid.effects.registry import on_every_joint
from torchid.errors import LogError, TorchidError
from torchid.identification.base_parameters import VISIBLE, BaseParameters, base_parameters
from torchid.identification.least_squares import (
    COVARIANCES,
    METHODS,
    Covariance,
    Fit,
    Method,
    fit,
)
from torchid.identification.motion import fast_speed, measurements
from torchid.identification.rows import Layout, RowSource, layout
from torchid.identification.statistics import Uncertainty, jackknife
from torchid.identification.tuning import (
    CutoffChoice,
    Training,
    choose_cutoff,
    choose_reversal,
)
from torchid.identification.validation import Errors, Prediction, errors, model_torque, predict
from torchid.log.checks import check_log
from torchid.log.model import Log
from torchid.log.sampling import resample
from torchid.robot.model import JointType, Robot
from torchid.typing import Bool, Float, Joints, Tensor

DEFAULT_EFFECTS = ("viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia")

Rows = Literal["all", "moving"]
Signs = Literal["bounded", "free"]
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Settings:
    """How to identify.

    Attributes:
        effects: names of the effects, on every joint.
        cutoff: [Hz]; "auto"; or None for no filter.
        reversal: speed at which a joint's direction counts as reversed, as a fraction of its 99 %
            speed; or "auto".
        rows: rows used for the fit: all, or those whose own joint moves.
        method: `ols`, `wls` or `huber`.
        covariance: of the noise between joints, `diagonal` or `full`.
        signs: `bounded` holds coefficients that physics forbids to be negative at zero or above;
            `free` leaves them and reports the wrong ones.
        essential: drop parameters that cannot be told from zero.
        held_out_fraction: share of each trajectory's end kept for validation if no log is given.
        error_cutoff: [Hz] filter under which errors are reported; the fit's if None.
        compiled: evaluate the final regressor by compiled code; pays on very long logs.
    """

    effects: tuple[str, ...] = DEFAULT_EFFECTS
    cutoff: float | Literal["auto"] | None = "auto"
    reversal: float | Literal["auto"] = "auto"
    rows: Rows = "all"
    method: Method = "huber"
    covariance: Covariance = "diagonal"
    signs: Signs = "bounded"
    essential: bool = False
    held_out_fraction: float = 0.0
    error_cutoff: float | None = None
    compiled: bool = False

    def __post_init__(self) -> None:
        for name, allowed in (
            ("rows", ("all", "moving")),
            ("method", METHODS),
            ("covariance", COVARIANCES),
            ("signs", ("bounded", "free")),
        ):
            if getattr(self, name) not in allowed:
                raise TorchidError(
                    f"unknown choice for {name}.", got=getattr(self, name), available=allowed
                )
        for name, unit in (("cutoff", "Hz"), ("reversal", "share of the 99 % speed")):
            value = getattr(self, name)
            if value not in ("auto", None) and not (isinstance(value, int | float) and value >= 0):
                raise TorchidError(
                    f"{name} is `auto` or a number that is not negative [{unit}].", got=value
                )


@dataclass(frozen=True, eq=False)
class Identification:
    """Base parameters identified from logs.

    Attributes:
        robot: as given.
        base: the base parameters' structure.
        effects: linear effects, in the order of their coefficients.
        values: (B,) in the order of `base.names`.
        covariance: (B, B), block-robust.
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
    """

    robot: Robot
    base: BaseParameters
    effects: tuple[Effect, ...]
    values: Float[Tensor, " B"]
    covariance: Float[Tensor, "B B"]
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

    @property
    def std(self) -> Float[Tensor, " B"]:
        """Standard deviations (B,); 0 for parameters that are not free."""
        return self.covariance.diagonal().clamp(min=0).sqrt()

    @property
    def relative_std_percent(self) -> Float[Tensor, " B"]:
        """100 std / |value| (B,); nan for parameters that are not free."""
        return 100 * self.std / self.values.abs()

    def interval(self, level: float = 0.95) -> Float[Tensor, "B 2"]:
        """Confidence intervals (B, 2) of the given level, by Student's quantile."""
        half = self.uncertainty.quantile(level) * self.std
        return torch.stack([self.values - half, self.values + half], -1)

    def predict(self, q: Joints, dq: Joints, ddq: Joints) -> Joints:
        """Joint torques (..., n) [N m; N] of the identified model."""
        values = self.values.to(q)
        return model_torque(self.robot, self.base, self.effects, values, Motion(q, dq, ddq))

    def residual(self, q: Joints, dq: Joints, ddq: Joints, tau: Joints) -> Joints:
        """Measured minus predicted torque (..., n)."""
        return tau - self.predict(q, dq, ddq)

    def combination(self, weights: Float[Tensor, " P"]) -> tuple[float, float]:
        """Value and standard deviation of a linear combination of all parameters.

        Args:
            weights: (P,) over `base.parameter_names`.

        Raises:
            TorchidError: the torque, or this log, does not determine this combination.
        """
        row = weights[list(self.base.independent)]
        if not torch.allclose(row @ self.base.grouping, weights, atol=1e-8):
            raise TorchidError("the torque does not determine this combination of parameters.")
        used = [name for name, w in zip(self.base.names, row.tolist(), strict=True) if w != 0]
        unknown = sorted(set(used) & set(self.undetermined))
        if unknown:
            raise TorchidError("this log does not determine this combination.", got=unknown)
        return float(row @ self.values), float((row @ self.covariance @ row).clamp(min=0).sqrt())


def identify(
    robot: Robot,
    log: Log,
    *,
    held_out: Log | None = None,
    settings: Settings | None = None,
    device: torch.device | str = "cpu",
    progress: Progress | None = None,
) -> Identification:
    """Identify base parameters and effects from logs, and validate them.

    Args:
        robot: kinematics, gravity; drive gains for logs of currents.
        log: one or several trajectories to fit.
        held_out: whole trajectories that take part in no choice. If None, the last
            `settings.held_out_fraction` of every trajectory of `log`.
        settings: how; defaults if None.
        device: where regressors are evaluated and filtered.
        progress: called with (stage, done, total).

    Raises:
        LogError: logs that do not fit the robot or cannot be used.
        IdentificationError: nothing to identify from.
    """
    settings = settings or Settings()
    log, kept_back = _split(log, held_out, settings)
    log, log_warnings = prepared(log, robot)
    kept_back, held_warnings = (None, ()) if kept_back is None else prepared(kept_back, robot)
    effects = on_every_joint(settings.effects, robot.n)
    base = base_parameters(robot, effects)
    columns = layout(robot, base, effects)
    signs = _non_negative(columns) & (settings.signs == "bounded")
    training = Training(_on(log, device), columns, settings.rows == "moving", signs)
    cutoff, choice = _cutoff(training, settings, progress)
    reversal = _reversal(training, cutoff, settings, progress)
    measured = measurements(training.log, cutoff, reversal)
    source = RowSource(
        measured,
        columns,
        moving_only=training.moving_only,
        compiled=settings.compiled,
        progress=_stage(progress, "filtering"),
    )
    found, uncertainty, dropped = _fit(source, settings, signs)
    values, order = _in_base_order(found.x, columns)
    named = _Names(base.names, order)
    del source
    shown = settings.error_cutoff if settings.error_cutoff is not None else cutoff
    fitted, checked = (
        [predict(m, robot, base, effects, values) for m in part]
        for part in (
            measured if shown == cutoff else measurements(training.log, shown, reversal),
            [] if kept_back is None else measurements(_on(kept_back, device), shown, reversal),
        )
    )
    wrong = _non_negative(columns) & (found.x < 0)
    covariance = uncertainty.covariance[order][:, order]
    result = Identification(
        robot=robot,
        base=base,
        effects=tuple(effects),
        values=values,
        covariance=covariance,
        free=found.free[order],
        bounded=named.where(found.bounded),
        undetermined=named.where(found.undetermined),
        dropped=named.where(dropped),
        wrong_sign=named.where(wrong),
        fit=errors(fitted),
        held_out=errors(checked) if checked else None,
        fit_predictions=tuple(fitted),
        held_out_predictions=tuple(checked),
        condition_number=found.condition_number,
        scaled_condition_number=found.scaled_condition_number,
        cutoff=cutoff,
        cutoff_choice=choice,
        reversal=reversal,
        uncertainty=uncertainty,
        settings=settings,
        warnings=(),
    )
    noticed = [
        *robot.warnings,
        *log_warnings,
        *held_warnings,
        *base.warnings,
        *(w for m in measured for w in m.warnings),
        *uncertainty.warnings,
        *_result_warnings(result),
    ]
    object.__setattr__(result, "warnings", tuple(dict.fromkeys(noticed)))
    return result


def prepared(log: Log, robot: Robot) -> tuple[Log, tuple[str, ...]]:
    """A log checked against the robot, with torques, on a uniform grid; and its warnings."""
    if log.tau is None and log.current is not None and robot.drive_gain is not None:
        log = log.with_torque(robot.drive_gain)
    noticed = check_log(
        log,
        n=robot.n,
        robot_name=robot.name,
        position_limits=robot.limits.position,
        prismatic=[t is JointType.PRISMATIC for t in robot.joint_types],
    )
    even = resample(log)
    return even, (*noticed, *even.warnings)


def _split(log: Log, held_out: Log | None, settings: Settings) -> tuple[Log, Log | None]:
    if held_out is not None or settings.held_out_fraction == 0:
        return log, held_out
    if not 0 < settings.held_out_fraction < 1:
        raise LogError(
            "the held-out fraction must lie between 0 and 1.", got=settings.held_out_fraction
        )
    return log.split(1 - settings.held_out_fraction, gap_s=0.0)


def _on(log: Log, device: torch.device | str) -> Log:
    if torch.device(device).type == "cpu":
        return log
    moved = {name: signal.to(device) for name, signal in log.signals.items()}
    return log.replace(t=log.t.to(device), trajectory=log.trajectory.to(device), **moved)


def _stage(progress: Progress | None, stage: str) -> Callable[[int, int], None] | None:
    return None if progress is None else (lambda done, total: progress(stage, done, total))


def _cutoff(
    training: Training, settings: Settings, progress: Progress | None
) -> tuple[float | None, CutoffChoice | None]:
    if settings.cutoff != "auto":
        return settings.cutoff, None
    choice = choose_cutoff(training, _stage(progress, "choosing the cut-off"))
    return choice.cutoff, choice


def _reversal(
    training: Training, cutoff: float | None, settings: Settings, progress: Progress | None
) -> Tensor:
    if settings.reversal == "auto":
        return choose_reversal(training, cutoff, _stage(progress, "choosing the reversal speed"))
    return settings.reversal * fast_speed(measurements(training.log, cutoff))


def _fit(source: RowSource, settings: Settings, signs: Tensor) -> tuple[Fit, Uncertainty, Tensor]:
    """Fit with standard deviations; with `essential`, without parameters that may be zero."""
    dropped = torch.zeros_like(signs)

    def once() -> tuple[Fit, Uncertainty]:
        found = fit(
            source,
            method=settings.method,
            covariance=settings.covariance,
            non_negative=signs,
            left_out=dropped,
        )
        return found, jackknife(source, found)

    found, uncertainty = once()
    while settings.essential and int(found.free.sum()) > 1:
        ratio = torch.where(found.free, found.x.abs() / uncertainty.std, torch.inf)
        weakest = int(ratio.argmin())
        if float(ratio[weakest]) > uncertainty.quantile():
            break
        dropped = dropped.clone()
        dropped[weakest] = True
        found, uncertainty = once()
    return found, uncertainty, dropped


def _non_negative(columns: Layout) -> Bool[Tensor, " B"]:
    """Columns, in the layout's order, that are one coefficient which physics forbids to be < 0."""
    base, n = columns.base, columns.robot.n
    alone = (base.grouping.abs() > VISIBLE).sum(1) == 1
    coefficients = [c for e in columns.effects for c in e.coefficients]
    out = torch.zeros(columns.size, dtype=torch.bool)
    for j, position in enumerate(columns.order):
        k = base.independent[position] - 10 * n
        out[j] = k >= 0 and coefficients[k].non_negative and bool(alone[position])
    return out


def _in_base_order(x: Tensor, columns: Layout) -> tuple[Tensor, Tensor]:
    """Values in the base parameters' order, and the index that takes any column vector there."""
    order = torch.empty(columns.size, dtype=torch.long)
    order[list(columns.order)] = torch.arange(columns.size)
    return x[order], order


@dataclass(frozen=True)
class _Names:
    names: tuple[str, ...]
    order: Tensor

    def where(self, mask: Tensor) -> tuple[str, ...]:
        hits = mask[self.order].tolist()
        return tuple(name for name, hit in zip(self.names, hits, strict=True) if hit)


def _result_warnings(result: Identification) -> list[str]:
    said = []
    if result.undetermined:
        said.append(
            "this log does not determine, for want of excitation (set to 0): "
            + ", ".join(result.undetermined)
        )
    if result.bounded:
        said.append(
            "the data ask for a sign that physics forbids; held at 0: " + ", ".join(result.bounded)
        )
    if result.wrong_sign:
        said.append("kept with a sign that physics forbids: " + ", ".join(result.wrong_sign))
    if result.dropped:
        said.append("cannot be told from 0, dropped as not essential: " + ", ".join(result.dropped))
    for label, e in (("fit", result.fit), ("held-out", result.held_out)):
        said += _standstill(label, e)
    return said


def _standstill(label: str, e: Errors | None) -> list[str]:
    """Says when standstill holds much of the error: friction at rest can hold any torque."""
    if e is None:
        return []
    out = []
    pairs = zip(e.standstill_fraction.tolist(), e.standstill_error_share.tolist(), strict=True)
    for j, (rows, share) in enumerate(pairs, start=1):
        if share > 0.5 and rows > 0.02:
            out.append(
                f"{label}: joint {j} stands still in {100 * rows:.0f} % of the rows, which hold "
                f"{100 * share:.0f} % of its squared error"
            )
    return out
