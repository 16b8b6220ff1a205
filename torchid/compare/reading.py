"""Results read back from their JSON, to be compared: what each holds, and of which robot."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from torchid.effects.base import JointEffect
from torchid.effects.registry import COLUMN_KINDS, on_every_joint
from torchid.errors import TorchidError
from torchid.feasibility.sets import SCHEMA as SETS
from torchid.gap.diagnosis import Diagnosis
from torchid.gap.record import SCHEMA as GAP
from torchid.gap.record import record as gap_record
from torchid.identification.base_parameters import BaseParameters
from torchid.identification.record import SCHEMA as IDENTIFICATION
from torchid.identification.record import record
from torchid.identification.result import Identification
from torchid.json_data import plain, read_json
from torchid.robot.inertia import PARAMETERS_PER_LINK, parameter_names, parameter_units
from torchid.robot.model import JointType, Robot
from torchid.robot.record import recorded_robot
from torchid.typing import Bool, Float, Tensor

KINDS = {IDENTIFICATION: "identifications", GAP: "gap diagnoses", SETS: "parameter sets"}

CONTAMINATED = 0.03
"""Share of an undetermined column that lies along an estimated one, above which the estimate is of
their sum."""


@dataclass(frozen=True)
class Result:
    """A file of results as it stands.

    Attributes:
        label: short name, unique among the results compared.
        path: of the file; the label, where there is none.
        schema: which kind.
        data: its content.
    """

    label: str
    path: Path
    schema: str
    data: Mapping[str, Any]

    @property
    def robot_name(self) -> str:
        """As the file says."""
        return str(self.data.get("robot"))


@dataclass(frozen=True, eq=False)
class Identified:
    """An identification read back.

    Attributes:
        label: what to call it.
        base, effects, values: its base parameters (B,).
        covariance: (B, B), block-robust; 0 where nothing was estimated.
        estimated: (B,) free in the fit, and not part of a sum with undetermined ones.
        held: (B,) held at zero: a sign that physics forbids, or not essential.
        correlation: (B, B) of the estimates under white residuals, from the fit's factor; the
            identity for what was not estimated.
        blocks: of the jackknife.
        quantile: half-width of the 95 % interval in standard deviations.
        cutoff: [Hz], or None. reversal: (n,) [rad/s or m/s].
        trajectories: names of those fitted.
        robot: as recorded, or None.
    """

    label: str
    base: BaseParameters
    effects: tuple[JointEffect, ...]
    values: Float[Tensor, " B"]
    covariance: Float[Tensor, "B B"]
    estimated: Bool[Tensor, " B"]
    held: Bool[Tensor, " B"]
    correlation: Float[Tensor, "B B"]
    blocks: int
    quantile: float
    cutoff: float | None
    reversal: Float[Tensor, " n"]
    trajectories: tuple[str, ...]
    robot: Robot | None

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.base.n_rigid_parameters // PARAMETERS_PER_LINK


def read_results(given: Sequence[str | Path | Identification | Diagnosis]) -> list[Result]:
    """Results of one kind, files or objects, in the order given.

    Raises:
        TorchidError: fewer than two, files that are no results, or of different kinds.
    """
    if len(given) < 2:
        raise TorchidError(
            "a comparison needs two results or more.", got=", ".join(str(p) for p in given) or None
        )
    files = iter(_read_files([Path(one) for one in given if isinstance(one, str | Path)]))
    results = []
    for k, one in enumerate(given, start=1):
        if isinstance(one, str | Path):
            results.append(next(files))
            continue
        data = record(one) if isinstance(one, Identification) else gap_record(one)
        label = f"result {k}"
        # As a file of it would be read.
        results.append(Result(label, Path(label), data["schema"], plain(data)))
    if len({r.schema for r in results}) > 1:
        raise TorchidError(
            "only results of the same kind can be compared.",
            got=", ".join(f"{r.path} ({KINDS[r.schema]})" for r in results),
            expected="all of one kind",
        )
    return results


def _read_files(paths: Sequence[Path]) -> list[Result]:
    same = [p for k, p in enumerate(paths) if p.resolve() in [o.resolve() for o in paths[:k]]]
    if same:
        raise TorchidError("a result is given twice.", got=same[0])
    results = []
    # The shortest ends of the paths that tell them apart; files that a command named itself are
    # called by their folder.
    parts = [(*p.resolve().parent.parts, p.stem) for p in paths]
    if len(paths) > 1 and len({p.stem for p in paths}) == 1:
        parts = [p[:-1] for p in parts]
    longest = max(map(len, parts), default=0)
    ends = (["/".join(p[-k:]) for p in parts] for k in range(1, longest + 1))
    labels = next((e for e in ends if len(set(e)) == len(e)), [str(p) for p in paths])
    for label, path in zip(labels, paths, strict=True):
        data = read_json(path, "a result")
        schema = data.get("schema")
        if schema not in KINDS:
            raise TorchidError(
                f"'{path}' is not a result that can be compared.",
                got=f"schema {schema}",
                available=[f"{name} ({what})" for name, what in KINDS.items()],
                hint="of an extraction, the file of its sets: sets.json",
            )
        results.append(Result(label, path, schema, data))
    return results


def read_identification(result: Result) -> Identified:
    """An identification, checked.

    Raises:
        TorchidError: the file is incomplete or contradicts itself.
    """
    data = result.data
    try:
        robot = recorded_robot(data, str(result.path))
        base, effects = _structure(data, robot)
        b = len(base)
        values = _tensor(data["base_values"], (b,))
        covariance = _tensor(data["covariance"], (b, b))
        factor = _tensor(data["factor"], (b + 1, b + 1))[:, :b]
        unknown = _mask(base, data["undetermined"])
        held = _mask(base, [*data["bounded"], *data["dropped"]])
        # Which estimates are of a sum with an undetermined parameter, as far as this log shows.
        contaminated, size = torch.zeros_like(unknown), torch.linalg.vector_norm(factor, dim=0)
        lost, known = unknown & (size > 0), ~unknown
        if bool(lost.any()) and bool(known.any()):
            parts = factor[:, known] / size[known], factor[:, lost] / size[lost]
            share = torch.linalg.lstsq(*parts).solution
            contaminated[known] = (share.abs() > CONTAMINATED).any(1)
        # The correlation of the estimates under white residuals.
        correlation = torch.eye(b, dtype=factor.dtype)
        index = (~(unknown | held)).nonzero().flatten()
        r = torch.linalg.qr(factor[:, index], mode="r").R
        root = torch.linalg.solve_triangular(r, torch.eye(len(r)).to(r), upper=True)
        root = root / torch.linalg.vector_norm(root, dim=1, keepdim=True)
        correlation[index.unsqueeze(-1), index] = root @ root.T
        cutoff = data["cutoff_hz"]
        return Identified(
            label=result.label,
            base=base,
            effects=effects,
            values=values,
            covariance=covariance,
            estimated=~(unknown | held | contaminated),
            held=held,
            correlation=correlation,
            blocks=int(data["statistics"]["blocks"]),
            quantile=float(data["statistics"]["quantile95"]),
            cutoff=None if cutoff is None else float(cutoff),
            reversal=_tensor(
                data["reversal_speed"], (base.n_rigid_parameters // PARAMETERS_PER_LINK,)
            ),
            trajectories=tuple(str(name) for name in data["fit"]["trajectories"]),
            robot=robot,
        )
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise TorchidError(
            f"'{result.path}' is not a complete identification.",
            got=f"{type(error).__name__}: {error}",
            hint="write it again: torchid identify ROBOT LOG... --json FILE",
        ) from error


def _structure(
    data: Mapping[str, Any], robot: Robot | None
) -> tuple[BaseParameters, tuple[JointEffect, ...]]:
    """Base parameters from the recorded grouping; the independent one of each leads its name."""
    shaped = [str(e["effect"]) for e in data.get("effects") or [] if "places" in e]
    if shaped:
        raise TorchidError(
            "a comparison takes identifications whose effects have no shapes, memory or load, and "
            "are on every joint.",
            got=", ".join(shaped),
            available=list(COLUMN_KINDS),
        )
    names = [str(name) for name in data["grouping"]["parameters"]]
    kinds = on_every_joint([str(name) for name in data["settings"]["effects"]], 1)
    n = len(names) // (PARAMETERS_PER_LINK + sum(len(e.coefficients) for e in kinds))
    effects = on_every_joint([e.name for e in kinds], n)
    if names != parameter_names(n) + [c for e in effects for c in e.coefficient_names()]:
        raise ValueError("the parameters' names do not fit the effects")
    grouping = _tensor(data["grouping"]["matrix"], (len(data["base_names"]), len(names)))
    independent = [names.index(str(text).split()[0]) for text in data["base_names"]]
    if not torch.equal(grouping[:, independent], torch.eye(len(grouping), dtype=grouping.dtype)):
        raise ValueError("a base parameter of the grouping has no column of its own")
    types = [JointType.REVOLUTE] * n if robot is None else robot.joint_types
    units = parameter_units(n) + [
        c.unit_for(types[e.joint] is JointType.PRISMATIC) for e in effects for c in e.coefficients
    ]
    rigid = PARAMETERS_PER_LINK * n
    return BaseParameters(
        names=tuple(str(name) for name in data["base_names"]),
        units=tuple(units[k] for k in independent),
        parameter_names=tuple(names),
        independent=tuple(independent),
        dependent=tuple(sorted(set(range(len(names))) - set(independent))),
        grouping=grouping,
        basis=data.get("basis", "report"),
        rank_gap=(float(data["rank_gap"][0]), float(data["rank_gap"][1])),
        n_rigid_parameters=rigid,
        n_rigid=sum(k < rigid for k in independent),
        warnings=(),
    ), tuple(effects)


def _tensor(values: Any, shape: tuple[int, ...]) -> Tensor:
    out = torch.tensor(values, dtype=torch.float64)
    if tuple(out.shape) != shape or not bool(torch.isfinite(out).all()):
        raise ValueError(f"{tuple(out.shape)} finite numbers, not {shape}")
    return out


def _mask(base: BaseParameters, names: Sequence[str]) -> Bool[Tensor, " B"]:
    unknown = sorted(set(names) - set(base.names))
    if unknown:
        raise ValueError(f"{unknown[0]} is not a base parameter")
    return torch.tensor([name in names for name in base.names])
