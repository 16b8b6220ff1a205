"""What is searched: terms, candidates, and the rows they are judged on."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

from scipy.stats import chi2

from torchid.effects.base import Coefficient, Effect
from torchid.gap.bank import Bank, Place
from torchid.gap.blocks import block_numbers
from torchid.gap.projection import NOISE
from torchid.typing import Bool, Float, Int, Tensor

PHI = 1.3
"""Factor on chi^2: the whitener is estimated, and noise is not exactly Gaussian."""

PENALTY = 4.0
"""Of each column, in whitened squared units."""

BLOCK_SECONDS = 2.0
FEWEST_BLOCKS = 20

BASE = "all_base"
LINK = "link_inertia"
FRICTION = "coulomb_friction+viscous_friction"

RANK = {
    name: k
    for k, name in enumerate(
        (
            "coulomb_friction",
            "viscous_friction",
            "torque_offset",
            "rotor_inertia",
            "payload",
            "base_tilt",
            "torque_gain",
            "time_delay",
            "joint_spring",
            "encoder_offset",
            "load_dependent_friction",
            "power_law_friction",
            "stribeck_friction",
            "presliding_hysteresis",
        )
    )
}
"""Simpler before richer, among equal numbers of columns; unlisted ones come last."""


@dataclass(frozen=True)
class Term:
    """What is in the model: effects that entered together.

    Attributes:
        name, place, effects, columns, coefficients, extra, known: as a Bank's, of the member that
            won.
    """

    name: str
    place: Place
    effects: tuple[Effect, ...]
    columns: Float[Tensor, "C R"]
    coefficients: tuple[Coefficient, ...]
    extra: float = 0.0
    known: tuple[float, ...] = ()

    @property
    def is_inertial(self) -> bool:
        """Whether it corrects the model's own parameters."""
        return self.name in (BASE, LINK)

    def scaled(self, rows: Tensor) -> "Term":
        """The term with every row times that of (n, N) `rows`: weights, or a mask."""
        own = rows.flatten() if self.place is None else rows[self.place]
        return replace(self, columns=self.columns * own)

    @property
    def key(self) -> tuple[str, Place, tuple[str, ...]]:
        """Same effect at the same place, whatever its shape."""
        places = tuple(_window_of(e) or str(e.joints) for e in self.effects)
        sources = tuple(str(getattr(e, "source_joint", "")) for e in self.effects)
        return self.name, self.place, places + sources


def _window_of(effect: Effect) -> str:
    """Contacts at different times are different."""
    start = getattr(effect, "start", None)
    return "" if start is None else f"{start:.0f} s"


def term_of(bank: Bank, member: int = 0) -> Term:
    """A bank's member as a term. Columns below noise at their largest plausible size are zero."""
    columns = bank.columns[member]
    largest = columns.new_tensor([c.largest for c in bank.coefficients])
    felt = columns.square().sum(1) * largest.square() > NOISE
    return Term(
        bank.name,
        bank.place,
        bank.members[member],
        columns if bool(felt.all()) else columns * felt.unsqueeze(1),
        bank.coefficients,
        bank.extra,
        bank.known,
    )


@dataclass(frozen=True)
class Candidate:
    """A member of a bank, and its gain on the present residual."""

    term: Term
    gain: float
    df: int

    @property
    def score(self) -> float:
        """Gain less penalties."""
        return self.gain - PENALTY * self.df - self.term.extra

    @property
    def simplicity(self) -> tuple[int, int]:
        """Simpler ones sort first."""
        return self.df, RANK.get(self.term.name, len(RANK))


@dataclass(frozen=True)
class Problem:
    """Rows and candidates.

    Attributes:
        y: (n, N) whitened gap; rows of other folds are zero.
        keep: (n, N) rows of the folds fitted.
        count: rows that count: in those folds, and moving.
        banks: candidates; their rows that do not count need not be zero.
        fixed: terms that are always in the model (free base parameters, a fitted background).
        bounds: rows of each trajectory.
        interval: seconds between rows.
        refine: from an effect to a bank of shapes around its own, ever finer with `level`; None
            where there is nothing to refine.
        whitened: whether rows are; if not, their noise is as autocorrelated as it likes, and every
            gain must stand out from the spread between blocks.
        alpha: family-wise level.
        seed: of the random signs.
    """

    y: Float[Tensor, "n N"]
    keep: Bool[Tensor, "n N"]
    count: int
    banks: tuple[Bank, ...]
    fixed: tuple[Term, ...]
    bounds: tuple[slice, ...]
    interval: float
    refine: Callable[[Effect, int], Bank | None]
    whitened: bool
    alpha: float = 0.01
    seed: int = 0

    @property
    def noise(self) -> float:
        """Sum of squares that noise has: one a row."""
        return float(self.count)

    @cached_property
    def looks(self) -> float:
        """Tests in one sweep over the candidates."""
        return sum(bank.looks for bank in self.banks)

    def threshold(self, df: int) -> float:
        """Gain that `df` columns must exceed."""
        return PHI * float(chi2.isf(self.alpha / max(1.0, self.looks), max(1, df)))

    def p_value(self, gain: float, df: int) -> float:
        """Family-wise p-value of a gain."""
        return min(1.0, self.looks * float(chi2.sf(gain / PHI, max(1, df))))

    @cached_property
    def block(self) -> Int[Tensor, " N"]:
        """Block of each row."""
        rows = sum(b.stop - b.start for b in self.bounds)
        longest = max(1.0, rows / FEWEST_BLOCKS)
        return block_numbers(
            self.bounds, round(max(2, min(BLOCK_SECONDS / self.interval, longest)))
        )

    def blocks_of(self, place: Place) -> Int[Tensor, " R"]:
        """Block of each row of a place."""
        return self.block if place is not None else self.block.repeat(self.y.shape[0])
