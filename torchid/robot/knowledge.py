"""How sure a model's values are: what was known of them before a log is seen.

The coordinates are the links' 10 n inertial parameters, link by link, and behind them coefficients
of effects, by name. What sessions know adds up as inverse covariances (the information filter,
Anderson and Moore 1979, 6.3): of the links the torque tells base parameters only, so that changes
of parameters which leave all of these as they are have no information and stay unknown.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch

from torchid.errors import RobotError
from torchid.robot.inertia import PARAMETERS_PER_LINK
from torchid.robot.yaml_values import known, numbers
from torchid.typing import Float, Tensor

KEYS = ("sources", "coefficients", "rows")
"""Of the yaml; `rows` are those of a matrix R, numbers in a text each, with information R'R."""

NOTHING = 1e-14
"""Eigenvalue of information, columns in units of what is known of each alone, below which there is
none: rounding."""


@dataclass(frozen=True, eq=False)
class Knowledge:
    """Inverse covariance of a robot's inertial parameters and of its effects' coefficients.

    Attributes:
        links: n.
        coefficients: names of K coefficients, e.g. `viscous_friction Fv3`.
        information: (10 n + K, 10 n + K) inverse covariance, in the parameters' own units.
        sources: where it comes from, e.g. `identified from run1`.

    Raises:
        RobotError: a matrix of another size.

    >>> import torch
    >>> one = Knowledge(1, ("viscous_friction Fv1",), torch.eye(11) * 4.0, ("run 1",))
    >>> one.std("viscous_friction Fv1"), one.plus(one).std("viscous_friction Fv1")
    (0.5, 0.35355339059327373)
    """

    links: int
    coefficients: tuple[str, ...]
    information: Float[Tensor, "M M"]
    sources: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "information", self.information.double())
        size = self.rigid + len(self.coefficients)
        if tuple(self.information.shape) != (size, size):
            raise RobotError(
                "knowledge of another number of parameters.",
                got=tuple(self.information.shape),
                expected=f"({size}, {size})",
            )

    @property
    def rigid(self) -> int:
        """Number of inertial parameters."""
        return self.links * PARAMETERS_PER_LINK

    def std(self, coefficient: str) -> float:
        """Standard deviation of one coefficient, whatever all others are; infinite if unknown."""
        if coefficient not in self.coefficients:
            return torch.inf
        left = float(self.over([coefficient], rigid=False).information[-1, -1])
        return left**-0.5 if left > 0 else torch.inf

    def over(self, coefficients: Sequence[str], *, rigid: bool = True) -> "Knowledge":
        """What is known of these coefficients, whatever the others are; nothing of new ones.

        Args:
            coefficients: names, in the order asked for.
            rigid: whether inertial parameters are asked for too; else nothing is known of them.
        """
        place = {name: self.rigid + k for k, name in enumerate(self.coefficients)}
        kept = [*range(self.rigid if rigid else 0)]
        kept += [place[name] for name in coefficients if name in place]
        gone = sorted(set(range(len(self.information))) - set(kept))
        inner = _without(self.information, kept, gone)
        # Into the order asked for.
        size = self.rigid + len(coefficients)
        new = [k for k, name in enumerate(coefficients) if name in place]
        at = torch.tensor([*range(self.rigid if rigid else 0), *(self.rigid + k for k in new)])
        out = torch.zeros(size, size, dtype=torch.float64)
        if len(at):
            out[at.unsqueeze(1), at] = inner
        return replace(self, coefficients=tuple(coefficients), information=out)

    def without(self, coefficients: Sequence[str]) -> "Knowledge":
        """The same, of some coefficients nothing known any more: they have changed."""
        rest = [name for name in self.coefficients if name not in set(coefficients)]
        return self.over(rest).over(self.coefficients)

    def aged(self, variances: Mapping[str, float]) -> "Knowledge":
        """After coefficients may have changed by themselves: (information^-1 + Q)^-1, without the
        inverse, for information may be singular.

        Args:
            variances: Q, by coefficient, in squares of its unit.
        """
        rows = [self.rigid + k for k, name in enumerate(self.coefficients) if name in variances]
        size = torch.tensor([variances[self.coefficients[k - self.rigid]] for k in rows]).double()
        if not len(rows):
            return self
        spread = size.sqrt()
        across = self.information[:, rows] * spread
        inner = torch.eye(len(rows), dtype=torch.float64) + across[rows] * spread.unsqueeze(1)
        return replace(
            self, information=self.information - across @ torch.linalg.solve(inner, across.T)
        )

    def plus(self, other: "Knowledge") -> "Knowledge":
        """What both know together: their information adds up, coefficients of either are there."""
        names = tuple(dict.fromkeys([*self.coefficients, *other.coefficients]))
        a, b = self.over(names).information, other.over(names).information
        sources = tuple(dict.fromkeys([*self.sources, *other.sources]))
        return Knowledge(self.links, names, a + b, sources)

    def rows(self) -> Float[Tensor, "R M"]:
        """R with R'R the information: as many rows as directions are known."""
        size = self.information.diagonal().clamp(min=0).sqrt()
        scale = torch.where(size > 0, 1 / size, 0.0)
        values, vectors = torch.linalg.eigh(self.information * scale * scale.unsqueeze(1))
        there = values > NOTHING * values[-1:].clamp(min=1e-300)
        return vectors[:, there].T * values[there].sqrt().unsqueeze(1) * size


def _without(matrix: Float[Tensor, "M M"], kept: list[int], gone: list[int]) -> Tensor:
    """Information of some parameters when the others may be anything: the Schur complement."""
    inner = matrix[kept][:, kept]
    if not gone:
        return inner
    # Columns of length one, so that what is not known at all is told from small units.
    across, own = matrix[gone][:, kept], matrix[gone][:, gone]
    size = own.diagonal().clamp(min=0).sqrt()
    scale = torch.where(size > 0, 1 / size, 0.0)
    values, vectors = torch.linalg.eigh(own * scale * scale.unsqueeze(1))
    there = values > NOTHING * values[-1:].clamp(min=1e-300)
    held = (vectors[:, there] / values[there].sqrt()).T @ (across * scale.unsqueeze(1))
    return inner - held.T @ held


def coefficient_keys(effect: str, names: Sequence[str]) -> list[str]:
    """Names by which coefficients of an effect are known, e.g. `viscous_friction Fv3`."""
    return [f"{effect} {name}" for name in names]


def to_mapping(knowledge: Knowledge) -> dict[str, Any]:
    """As a robot's yaml has it."""
    return {
        "sources": list(knowledge.sources),
        "coefficients": list(knowledge.coefficients),
        "rows": [" ".join(map(repr, row)) for row in knowledge.rows().tolist()],
    }


def from_mapping(data: Any, n: int, source: str) -> Knowledge:
    """Of the parsed yaml of a robot with n links; `source` names it in errors.

    Raises:
        RobotError: unknown keys, or rows of another length than the coefficients ask for.
    """
    where = f"{source}: knowledge"
    known(data, KEYS, where)
    texts = {}
    for key in KEYS:
        texts[key] = data.get(key) or []
        if not isinstance(texts[key], list) or not all(isinstance(x, str) for x in texts[key]):
            raise RobotError(f"{where}.{key}: must be a list of texts.", got=texts[key])
    names = tuple(texts["coefficients"])
    if len(set(names)) < len(names):
        raise RobotError(f"{where}.coefficients: one is named twice.", got=list(names))
    size = n * PARAMETERS_PER_LINK + len(names)
    rows = [[_number(x, f"{where}.rows") for x in row.split()] for row in texts["rows"]]
    root = numbers(rows, (len(rows), size), f"{where}.rows") if rows else torch.zeros(0, size)
    return Knowledge(n, names, root.double().T @ root.double(), tuple(texts["sources"]))


def _number(text: str, where: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise RobotError(f"{where}: not a number.", got=text) from error
