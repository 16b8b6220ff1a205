"""Values of base parameters, wherever they are from, and what is known of their accuracy."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import torch

from torchid.effects.base import Effect, JointEffect
from torchid.effects.registry import (
    COLUMN_KINDS,
    effect_from_record,
    effect_kind,
    nominal_columns,
    on_every_joint,
)
from torchid.errors import TorchidError
from torchid.identification.base_parameters import BaseParameters, base_parameters, nominal_values
from torchid.identification.record import SCHEMA
from torchid.identification.result import Identification
from torchid.json_data import read_json
from torchid.robot.model import Basis, Robot
from torchid.typing import Bool, Float, Tensor


@dataclass(frozen=True, eq=False)
class BaseValues:
    """Values of base parameters, and what is known of their accuracy.

    Attributes:
        base, effects: which they are.
        values: (B,).
        known: (B,) those that the log determined.
        covariance: (B, B), or None where the values are exact.
        factor: (B + 1, B + 1) of the fit, or None where there was none.
    """

    base: BaseParameters
    effects: tuple[Effect, ...]
    values: Float[Tensor, " B"]
    known: Bool[Tensor, " B"]
    covariance: Float[Tensor, "B B"] | None
    factor: Float[Tensor, "C C"] | None

    @property
    def held(self) -> tuple[str, ...]:
        """Names of those that the fit held, which have no variance and are not sure for that."""
        if self.covariance is None:
            return ()
        mask = ((self.covariance.diagonal() == 0) & self.known).tolist()
        return tuple(n for n, is_held in zip(self.base.names, mask, strict=True) if is_held)

    @property
    def uncertainty(self) -> Float[Tensor, "B B"] | None:
        """The covariance, infinite for what the log did not determine; None where all is exact."""
        if self.covariance is None:
            return None
        covariance = self.covariance.clone()
        covariance[~self.known, ~self.known] = float("inf")
        return covariance


def plain_effects(effects: Sequence[Effect], what: str) -> tuple[JointEffect, ...]:
    """The effects of an identification, for what knows no others than those of a joint's own motion
    without shapes.

    Raises:
        TorchidError: it has others.
    """
    plain = tuple(e for e in effects if isinstance(e, JointEffect) and e.name in COLUMN_KINDS)
    if len(plain) < len(effects):
        others = dict.fromkeys(e.name for e in effects if e.name not in COLUMN_KINDS)
        raise TorchidError(
            f"{what} takes no identification with effects that have shapes, a memory or a load.",
            got=", ".join(others),
            available=list(COLUMN_KINDS),
            hint="identify again without them; `torchid export` takes all effects",
        )
    return plain


def nominal_base(robot: Robot) -> BaseValues:
    """The base parameters of the robot's nominal parameters and effects, exact.

    Raises:
        RobotError: the robot has no nominal parameters.
    """
    effects = tuple(effect for effect, _ in nominal_columns(robot))
    base = base_parameters(robot, effects)
    known = torch.ones(len(base), dtype=torch.bool)
    return BaseValues(base, effects, nominal_values(robot, base), known, None, None)


def identified_base(result: Identification) -> BaseValues:
    """The base parameters of an identification; what bodies or the log hold at zero stays known
    unless the log did not determine it."""
    unknown = set(result.undetermined)
    known = torch.tensor([name not in unknown for name in result.base.names])
    return BaseValues(
        result.base, result.effects, result.values, known, result.covariance, result.factor
    )


def read_base(path: Path, robot: Robot) -> BaseValues:
    """The result of `torchid identify ... --json PATH`, for the same robot.

    Raises:
        TorchidError: not such a file, another robot's, or values that are not finite.
    """
    return _base(_load(path), path, robot)


def _base(data: Mapping[str, Any], path: Path, robot: Robot) -> BaseValues:
    placed = placed_effects(data, robot)
    plain = _names(data["settings"], "effects", path)
    effects = placed or tuple(on_every_joint(plain, robot.n))
    # Results of an older torchid do not say it: theirs was the report's.
    basis = data.get("basis", "report")
    if basis not in get_args(Basis):
        raise TorchidError(f"'{path}': unknown basis.", got=basis, available=get_args(Basis))
    base = base_parameters(robot, effects, basis=basis)
    names = _names(data, "base_names", path)
    if list(base.names) != names:
        differing = [n for n in names if n not in base.names]
        raise TorchidError(
            f"'{path}' holds base parameters of another robot.",
            got=f"{len(names)} of '{data.get('robot')}'"
            + (f", e.g. {differing[0]}" if differing else ""),
            expected=f"the {len(base)} of '{robot.name}', e.g. {base.names[0]}",
            hint="of the same robot by an older torchid: identify again",
        )
    b = len(base)
    values = _tensor(data, "base_values", (b,), path)
    unknown = set(_names(data, "undetermined", path))
    if not unknown <= set(base.names):
        raise TorchidError(
            f"'{path}': what is undetermined is not among the base parameters.",
            got=sorted(unknown - set(base.names)),
        )
    known = torch.tensor([name not in unknown for name in base.names])
    return BaseValues(
        base,
        effects,
        values,
        known,
        _tensor(data, "covariance", (b, b), path),
        _tensor(data, "factor", (b + 1, b + 1), path),
    )


def placed_effects(data: Mapping[str, Any], robot: Robot) -> tuple[Effect, ...] | None:
    """The effects of an identification's record, in the order of their coefficients; None where all
    are of the kinds in its settings, on every joint.

    Raises:
        TorchidError: an unknown effect, or a place that the robot does not have.
    """
    entries = data.get("effects") or []
    if not any("places" in entry for entry in entries):
        return None
    out: list[Effect] = []
    for entry in entries:
        name = str(entry["effect"])
        if "places" not in entry:
            out += on_every_joint([name], robot.n)
            continue
        zeros = {c.name: 0.0 for c in effect_kind(name).coefficients}
        for place in entry["places"]:
            out.append(effect_from_record({"effect": name, **zeros, **place}, robot)[0])
    return tuple(out)


def _load(path: Path) -> Mapping[str, Any]:
    hint = "torchid identify ROBOT LOG... --json FILE"
    data = read_json(path, "a result of an identification", hint)
    schema = data.get("schema")
    needed = {"settings", "base_names", "base_values", "undetermined", "covariance", "factor"}
    if schema != SCHEMA or not needed <= set(data):
        missing = sorted(needed - set(data))
        raise TorchidError(
            f"'{path}' is not a result of an identification.",
            got=f"schema {schema}" + (f", without {', '.join(missing)}" if missing else ""),
            expected=f"schema {SCHEMA}",
            hint=hint,
        )
    return data


def _names(data: Any, key: str, path: Path) -> list[str]:
    found = data.get(key) if isinstance(data, Mapping) else None
    if not isinstance(found, list) or not all(isinstance(name, str) for name in found):
        raise TorchidError(f"'{path}': {key} is not a list of names.", got=found)
    return found


def _tensor(data: Mapping[str, Any], key: str, shape: tuple[int, ...], path: Path) -> Tensor:
    try:
        values = torch.tensor(data[key], dtype=torch.float64)
    except (TypeError, ValueError) as error:
        raise TorchidError(f"'{path}': {key} is not a table of numbers.") from error
    if tuple(values.shape) != shape or not bool(torch.isfinite(values).all()):
        raise TorchidError(
            f"'{path}': {key} has the wrong size or is not finite.",
            got=tuple(values.shape),
            expected=shape,
        )
    return values


@dataclass(frozen=True, eq=False)
class Prior:
    """What an identification knows, for the design of the next motion.

    Attributes:
        base, effects, values: its base parameters (B,).
        known: (B,) those that the log determined.
        std: (B,) standard deviations; 0 where held or unknown.
        information: (B, B) R'R of the weighted rows.
        inflation: (B,) standard deviation over that of white residuals; where nothing was
            estimated, the median of the others.
        whitening: (n, n) weights of the joints' rows.
        per_second: rows a second and joint.
    """

    base: BaseParameters
    effects: tuple[JointEffect, ...]
    values: Float[Tensor, " B"]
    known: Bool[Tensor, " B"]
    std: Float[Tensor, " B"]
    information: Float[Tensor, "B B"]
    inflation: Float[Tensor, " B"]
    whitening: Float[Tensor, "n n"]
    per_second: float


def read_prior(path: Path, robot: Robot) -> Prior:
    """What the identification in a file knows; for the same robot.

    Raises:
        TorchidError: not such a file, or one without the rows' weights, of an older torchid.
    """
    data = _load(path)
    found, rows = _base(data, path, robot), data.get("rows")
    if not isinstance(rows, Mapping) or not {"per_second", "whitening"} <= set(rows):
        raise TorchidError(
            f"'{path}' does not say how its rows were weighted.",
            hint="write it again: torchid identify ROBOT LOG... --json FILE",
        )
    assert found.covariance is not None
    assert found.factor is not None
    r = found.factor[:, :-1]
    std = found.covariance.diagonal().clamp(min=0).sqrt()
    free = (std > 0).nonzero().flatten()
    root = torch.linalg.qr(r[:, free], mode="r").R
    inverse = torch.linalg.solve_triangular(root, torch.eye(len(free)).to(root), upper=True)
    ratio = std[free] / torch.linalg.vector_norm(inverse, dim=1)
    inflation = torch.full_like(std, float(ratio.median()) if len(free) else 1.0)
    inflation[free] = ratio
    return Prior(
        found.base,
        plain_effects(found.effects, "the design of the next motion"),
        found.values,
        found.known,
        std,
        r.T @ r,
        inflation,
        _tensor(rows, "whitening", (robot.n, robot.n), path),
        float(rows["per_second"]),
    )
