"""How sure a model's values are: what was known of them before a log is seen.

The coordinates are the links' 10 n inertial parameters, link by link, and behind them coefficients
of effects, by name. What sessions know adds up as inverse covariances (the information filter,
Anderson and Moore 1979, 6.3): of the links the torque tells base parameters only, so that changes
of parameters which leave all of these as they are have no information and stay unknown. Values are
in units of the torque that the arm's own sensors measure: a wrong scale is the same in every
session.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch

from torchid.errors import RobotError
from torchid.robot.inertia import PARAMETERS_PER_LINK
from torchid.robot.yaml_values import known, numbers
from torchid.typing import Float, Tensor

BETWEEN = 0.05
"""Standard deviation of friction from one session of an arm to the next, as a share of it, where no
sessions tell it [1]: with the temperature of the grease viscous friction changes by 2 to 10 % a
day (docs/fleet.md)."""

KEYS = ("sources", "coefficients", "rows", "left", "between_sessions", "log")
"""Of the yaml; `rows` are those of the root, numbers in a text each, and so is `left`;
`between_sessions` has a text a coefficient, its name and a number; `log` are a file and its
SHA-256."""


NOTHING = 1e-10
"""Singular value, columns of length one, below which a direction is not known: rounding."""


@dataclass(frozen=True, eq=False)
class Knowledge:
    """A root of the inverse covariance of a robot's inertial parameters and effects' coefficients.

    Attributes:
        links: n.
        coefficients: names of K coefficients, e.g. `viscous_friction Fv3`.
        root: (R, 10 n + K) rows; root' root is the inverse covariance, in the parameters' own
            units. A square root keeps the digits that the product would lose (Bierman 1977).
        sources: where it comes from, e.g. `run1`.
        left: (n,) torque that the model was seen to leave unexplained, RMS [N m; N]; None where
            nobody looked.
        between: standard deviations by which coefficients change from session to session by
            themselves, as several sessions have shown them, in their units.
        log: file beside the model's with the log that it was made from, and its SHA-256; None where
            it was not kept, and of what several logs know together.

    Raises:
        RobotError: rows of another length.

    >>> import torch
    >>> one = Knowledge(1, ("viscous_friction Fv1",), 2 * torch.eye(11), ("run 1",))
    >>> [round(known.std("viscous_friction Fv1"), 6) for known in (one, one.plus(one))]
    [0.5, 0.353553]
    """

    links: int
    coefficients: tuple[str, ...]
    root: Float[Tensor, "R M"]
    sources: tuple[str, ...] = ()
    left: Float[Tensor, " n"] | None = None
    between: Mapping[str, float] = field(default_factory=dict)
    log: tuple[str, str] | None = None

    def __post_init__(self) -> None:
        root = self.root.double()
        size = self.rigid + len(self.coefficients)
        if root.ndim != 2 or root.shape[1] != size:
            raise RobotError(
                "knowledge of another number of parameters.",
                got=tuple(root.shape),
                expected=f"rows of {size}",
            )
        if len(root) > size:  # no more rows than parameters are needed
            root = torch.linalg.qr(root, mode="r").R
        object.__setattr__(self, "root", root)

    @property
    def rigid(self) -> int:
        """Number of inertial parameters."""
        return self.links * PARAMETERS_PER_LINK

    @property
    def information(self) -> Float[Tensor, "M M"]:
        """Inverse covariance."""
        return self.root.T @ self.root

    def std(self, coefficient: str) -> float:
        """Standard deviation of one coefficient, whatever all others are; infinite if unknown."""
        if coefficient not in self.coefficients:
            return math.inf
        own = self.rigid + self.coefficients.index(coefficient)
        left = self._eliminated([k for k in range(self.root.shape[1]) if k != own])[:, own].norm()
        return 1 / float(left) if left > NOTHING * self.root[:, own].norm() else math.inf

    def over(self, coefficients: Sequence[str]) -> "Knowledge":
        """What is known of inertial parameters and these coefficients, whatever the others are;
        nothing of new ones.

        Args:
            coefficients: names, in the order asked for.
        """
        place = {name: self.rigid + k for k, name in enumerate(self.coefficients)}
        gone = [k for name, k in place.items() if name not in set(coefficients)]
        root = self._eliminated(gone)
        out = root.new_zeros(len(root), self.rigid + len(coefficients))
        out[:, : self.rigid] = root[:, : self.rigid]
        for k, name in enumerate(coefficients):
            if name in place:
                out[:, self.rigid + k] = root[:, place[name]]
        return replace(self, coefficients=tuple(coefficients), root=out)

    def without(self, coefficients: Sequence[str], links: Sequence[int] = ()) -> "Knowledge":
        """This knowledge, of some coefficients and links nothing any more: they have changed.

        Args:
            coefficients: names.
            links: from 0.
        """
        names = self.coefficients
        gone = [self.rigid + names.index(c) for c in dict.fromkeys(coefficients) if c in names]
        for link in links:
            gone += range(link * PARAMETERS_PER_LINK, (link + 1) * PARAMETERS_PER_LINK)
        return replace(self, root=self._eliminated(gone))

    def merged(self, coefficients: Sequence[str], link: int) -> "Knowledge":
        """Knowledge of an arm whose link holds a body as well: what is known of the two together.

        Args:
            coefficients: names of the body's ten.
            link: from 0.
        """
        own = [self.rigid + self.coefficients.index(name) for name in coefficients]
        root, first = self.root.clone(), link * PARAMETERS_PER_LINK
        body, both = root[:, own], root[:, first : first + PARAMETERS_PER_LINK]
        # Beside their sum the body alone: rounding, where nothing but a log told of it.
        alone = body - both
        # 1e-6: relative difference below which two columns, evaluated by two ways, are one
        apart = alone.norm(dim=0) > 1e-6 * (body.norm(dim=0) + both.norm(dim=0))
        root[:, own] = alone * apart
        rest = [name for name in self.coefficients if name not in coefficients]
        return replace(self, root=root).over(rest)

    def aged(self, variances: Mapping[str, float]) -> "Knowledge":
        """After coefficients may have changed by themselves: (information^-1 + Q)^-1.

        The change w of a coefficient is known to be zero to its variance, the coefficient before
        is that of now less w, and w is eliminated (Bierman 1977, VII.2).

        Args:
            variances: Q, by coefficient, in squares of its unit.
        """
        own = [k for k, name in enumerate(self.coefficients) if variances.get(name, 0.0) > 0]
        if not own:
            return self
        spread = torch.tensor([variances[self.coefficients[k]] for k in own]).double().sqrt()
        before = self.root[:, [self.rigid + k for k in own]] * spread
        eye = torch.eye(len(own), dtype=torch.float64)
        changes = torch.cat([-before, eye])
        rows = torch.cat([self.root, eye.new_zeros(len(own), self.root.shape[1])])
        return replace(self, root=_left_of(changes, rows))

    def shifted(self, change: Float[Tensor, " M"]) -> "Knowledge":
        """What is known of other values, which were chosen and not measured: the covariance plus
        change change', as if the change were one standard deviation of what is not known.

        Args:
            change: of inertial parameters, link by link, and coefficients.
        """
        one = torch.ones(1, 1, dtype=torch.float64)
        changes = torch.cat([-(self.root @ change).unsqueeze(1), one])
        rows = torch.cat([self.root, one.new_zeros(1, self.root.shape[1])])
        return replace(self, root=_left_of(changes, rows))

    def plus(self, other: "Knowledge") -> "Knowledge":
        """What both know together: their information adds up, coefficients of either are there."""
        names = tuple(dict.fromkeys([*self.coefficients, *other.coefficients]))
        rows = torch.cat([self.over(names).root, other.over(names).root])
        sources = (*self.sources, *other.sources)
        # The most that was left in any session: an easy motion shows less of what a model lacks.
        known = [k.left for k in (self, other) if k.left is not None]
        left = torch.stack(known).amax(0) if known else None
        between = {**self.between, **other.between}
        return Knowledge(self.links, names, rows, sources, left, between)

    def _eliminated(self, gone: Sequence[int]) -> Float[Tensor, "R M"]:
        """The root of what is known of the others, whatever these are; their columns are zero."""
        if not len(gone):
            return self.root
        out = _left_of(self.root[:, list(gone)], self.root)
        out[:, list(gone)] = 0.0
        return out


def _left_of(columns: Float[Tensor, "R C"], rows: Float[Tensor, "R M"]) -> Float[Tensor, "S M"]:
    """Combinations of rows in which some columns do not occur: of their left null space."""
    size = columns.norm(dim=0)
    u, values, _ = torch.linalg.svd(columns[:, size > 0] / size[size > 0], full_matrices=True)
    rank = int((values > NOTHING * values[:1].sum().clamp(min=1.0)).sum())
    return u[:, rank:].T @ rows


def coefficient_keys(effect: str, names: Sequence[str]) -> list[str]:
    """Names by which coefficients of an effect are known, e.g. `viscous_friction Fv3`."""
    return [f"{effect} {name}" for name in names]


def to_mapping(knowledge: Knowledge) -> dict[str, list[str]]:
    """As a robot's yaml has it."""
    out = {
        "sources": list(knowledge.sources),
        "coefficients": list(knowledge.coefficients),
        "rows": [" ".join(map(repr, row)) for row in knowledge.root.tolist()],
    }
    if knowledge.left is not None:
        out["left"] = [repr(x) for x in knowledge.left.tolist()]
    if knowledge.between:
        out["between_sessions"] = [f"{name} {std!r}" for name, std in knowledge.between.items()]
    if knowledge.log is not None:
        out["log"] = list(knowledge.log)
    return out


def from_mapping(data: Any, n: int, source: str) -> Knowledge:
    """Knowledge from the parsed yaml of a robot with n links; `source` names it in errors.

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
    left = [_number(x, f"{where}.left") for x in texts["left"]]
    pairs = [text.rpartition(" ") for text in texts["between_sessions"]]
    if len(texts["log"]) not in (0, 2):
        raise RobotError(f"{where}.log: must be a file and its SHA-256.", got=texts["log"])
    return Knowledge(
        n,
        names,
        root,
        tuple(texts["sources"]),
        numbers(left, (n,), f"{where}.left") if left else None,
        {name: _number(std, f"{where}.between_sessions") for name, _, std in pairs},
        (texts["log"][0], texts["log"][1]) if texts["log"] else None,
    )


def _number(text: str, where: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise RobotError(f"{where}: not a number.", got=text) from error
