"""Members of one effect at one place: one set of whitened columns a shape."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from torchid.effects.base import Coefficient, Effect
from torchid.typing import Float, Tensor

Place = int | None
"""A joint, from 0, whose rows alone the columns are in; or None for the rows of all joints."""


@dataclass(frozen=True)
class Bank:
    """Members of one effect at one place, which differ in shape parameters.

    Attributes:
        name: of the effect, or a composite's, e.g. `coulomb_friction+viscous_friction`.
        place: whose rows the columns are in.
        members: per member the effects whose coefficients the columns belong to, in order.
        columns: (S, C, N) or, on all joints, (S, C, n N); whitened rows.
        coefficients: C; signs and sizes that physics allows. Base parameters have none.
        looks: tests this bank counts for: its members, or fewer where they are strongly related.
        extra: penalty beyond that of its columns (see select.PENALTY).
        known: what the model as given has of each coefficient: a correction may be negative down
            to minus that. Zeros if empty.
    """

    name: str
    place: Place
    members: tuple[tuple[Effect, ...], ...]
    columns: Float[Tensor, "S C R"]
    coefficients: tuple[Coefficient, ...]
    looks: float
    extra: float = 0.0
    known: tuple[float, ...] = ()

    @property
    def size(self) -> int:
        """C."""
        return len(self.coefficients)


def rescaled(bank: Bank, factor: Float[Tensor, " n"]) -> Bank:
    """The bank in rows of which each joint's are that many times larger."""
    if bank.place is not None:
        return replace(bank, columns=bank.columns * factor[bank.place])
    shape = bank.columns.shape
    scaled = bank.columns.reshape(*shape[:2], len(factor), -1) * factor.unsqueeze(-1)
    return replace(bank, columns=scaled.reshape(shape))


def composite(name: str, banks: Sequence[Bank]) -> Bank:
    """Banks of one member each, at one place, as one that enters together."""
    return Bank(
        name,
        banks[0].place,
        (tuple(e for bank in banks for e in bank.members[0]),),
        torch.cat([bank.columns for bank in banks], 1),
        tuple(c for bank in banks for c in bank.coefficients),
        1.0,
        known=tuple(v for bank in banks for v in bank.known),
    )
