"""Results read back from their JSON, to be compared: what each holds, and of which robot."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch

from torchid.effects.base import JointEffect
from torchid.effects.registry import COLUMN_KINDS, on_every_joint
from torchid.errors import TorchidError
from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.identification.base_parameters import BaseParameters
from torchid.identification.least_squares import contaminated_columns
from torchid.identification.record import IdentificationRecord
from torchid.identification.result import Identification
from torchid.results.files import read
from torchid.results.record import Record
from torchid.robot.inertia import PARAMETERS_PER_LINK
from torchid.typing import Bool, Float, Tensor

_R = TypeVar("_R", bound=Record)

KINDS = {
    "torchid.identification/1": "identifications",
    "torchid.gap/1": "gap diagnoses",
    "torchid.parameter_sets/1": "parameter sets",
}


@dataclass(frozen=True)
class Compared(Generic[_R]):
    """A result that is compared.

    Attributes:
        label: short name, unique among the results compared.
        path: of its file; the label, where there is none.
        record: what it holds.
    """

    label: str
    path: Path
    record: _R


@dataclass(frozen=True, eq=False)
class Identified:
    """An identification read back.

    Attributes:
        label: what to call it.
        record: as it was read.
        base, effects, values: its base parameters (B,).
        covariance: (B, B), block-robust; 0 where nothing was estimated.
        estimated: (B,) free in the fit, and not part of a sum with undetermined ones.
        held: (B,) held at zero: a sign that physics forbids, or not essential.
        correlation: (B, B) of the estimates under white residuals, from the fit's factor; the
            identity for what was not estimated.
    """

    label: str
    record: IdentificationRecord
    base: BaseParameters
    effects: tuple[JointEffect, ...]
    values: Float[Tensor, " B"]
    covariance: Float[Tensor, "B B"]
    estimated: Bool[Tensor, " B"]
    held: Bool[Tensor, " B"]
    correlation: Float[Tensor, "B B"]

    @property
    def earlier(self) -> tuple[str, ...]:
        """Sessions that its model knew before."""
        return tuple((self.record.sure or {}).get("sources", ())[:-1])

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.base.n_rigid_parameters // PARAMETERS_PER_LINK


def read_results(
    given: Sequence[str | Path | Identification | TorqueDiagnosis],
) -> list[Compared[Any]]:
    """Results of one kind, files or objects, in the order given.

    Raises:
        TorchidError: fewer than two, files that are no results, or of different kinds.
    """
    if len(given) < 2:
        raise TorchidError(
            "a comparison needs two results or more.", got=", ".join(str(p) for p in given) or None
        )
    files = iter(_read_files([Path(one) for one in given if isinstance(one, str | Path)]))
    results = [
        next(files)
        if isinstance(one, str | Path)
        else Compared(f"result {k}", Path(f"result {k}"), one.record)
        for k, one in enumerate(given, start=1)
    ]
    if len({type(r.record) for r in results}) > 1:
        raise TorchidError(
            "only results of the same kind can be compared.",
            got=", ".join(f"{r.path} ({KINDS[r.record.schema]})" for r in results),
            expected="all of one kind",
        )
    return results


def _read_files(paths: Sequence[Path]) -> list[Compared[Any]]:
    same = [p for k, p in enumerate(paths) if p.resolve() in [o.resolve() for o in paths[:k]]]
    if same:
        raise TorchidError("a result is given twice.", got=same[0])
    # The shortest ends of the paths that tell them apart; files that a command named itself are
    # called by their folder.
    parts = [(*p.resolve().parent.parts, p.stem) for p in paths]
    if len(paths) > 1 and len({p.stem for p in paths}) == 1:
        parts = [p[:-1] for p in parts]
    longest = max(map(len, parts), default=0)
    ends = (["/".join(p[-k:]) for p in parts] for k in range(1, longest + 1))
    labels = next((e for e in ends if len(set(e)) == len(e)), [str(p) for p in paths])
    what, hint = (
        "a result that can be compared",
        "of an extraction, the file of its sets: sets.json",
    )
    return [
        Compared(label, path, read(path, list(KINDS), what, hint))
        for label, path in zip(labels, paths, strict=True)
    ]


def read_identification(result: Compared[IdentificationRecord]) -> Identified:
    """An identification, checked.

    Raises:
        TorchidError: the record contradicts itself.
    """
    found = result.record
    shaped = [e.effect for e in found.effects if e.places]
    if shaped:
        raise TorchidError(
            "a comparison takes identifications whose effects have no shapes, memory or load, and "
            "are on every joint.",
            got=", ".join(shaped),
            available=list(COLUMN_KINDS),
        )
    effects = tuple(on_every_joint(found.settings.effects, len(found.reversal)))
    try:
        base = found.base
        b = len(base)
        factor = found.factor[:, :b]
        unknown = _mask(base, found.undetermined)
        held = _mask(base, [*found.bounded, *found.dropped])
    except ValueError as error:
        raise TorchidError(
            f"'{result.path}' is not a complete identification.",
            got=str(error),
            hint="write it again: torchid identify ROBOT LOG... --json FILE",
        ) from error
    # The correlation of the estimates under white residuals.
    correlation = torch.eye(b, dtype=factor.dtype)
    index = (~(unknown | held)).nonzero().flatten()
    r = torch.linalg.qr(factor[:, index], mode="r").R
    root = torch.linalg.solve_triangular(r, torch.eye(len(r)).to(r), upper=True)
    root = root / torch.linalg.vector_norm(root, dim=1, keepdim=True)
    correlation[index.unsqueeze(-1), index] = root @ root.T
    return Identified(
        label=result.label,
        record=found,
        base=base,
        effects=effects,
        values=found.values,
        covariance=found.covariance,
        estimated=~(unknown | held | contaminated_columns(factor, unknown)),
        held=held,
        correlation=correlation,
    )


def _mask(base: BaseParameters, names: Sequence[str]) -> Bool[Tensor, " B"]:
    unknown = sorted(set(names) - set(base.names))
    if unknown:
        raise ValueError(f"{unknown[0]} is not a base parameter")
    return torch.tensor([name in names for name in base.names])
