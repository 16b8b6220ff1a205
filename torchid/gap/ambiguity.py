"""What else could it be: effects that the data do not separate from an accepted one.

Every accepted effect is taken out, the others refitted, and every candidate put in its place. Those
whose blocks are not significantly worse (a model confidence set at 90 %, Hansen et al. 2011) form
the ambiguity set, with exact aliases that no data of this kind can separate.
"""

from dataclasses import dataclass

from torchid.gap.blocks import block_sums, mean_bound
from torchid.gap.evidence import block_losses
from torchid.gap.problem import BASE, FRICTION, LINK, PENALTY, Candidate, Term
from torchid.gap.select import Search
from torchid.typing import Float, Tensor

CONFIDENCE = 0.9
MORE_COLUMNS = 1
"""An alternative may have so many columns more than the accepted effect."""

NEGLIGIBLE = 2e-3
"""Share of an effect's gain that an alternative may lose and still count as the same, however
significant: no law fits an arm that well, the right one neither."""


@dataclass(frozen=True)
class Alternative:
    """An effect that explains an accepted one's share as well.

    Attributes:
        name: of the effect it stands for.
        term: what it is.
        gain: its gain in the accepted one's place.
        loses: block-wise mean of what it explains less, in whitened units a block.
    """

    name: str
    term: Term
    gain: float
    loses: float


def alternatives(search: Search, term: Term) -> list[Alternative]:
    """Alternatives to an accepted term, the best first, one a name."""
    without = search.model(without=[term])
    kept = search.terms
    search.terms = [t for t in kept if t is not term]
    candidates = search.candidates(without)
    search.terms = kept
    own = block_losses(search.problem, term, without)
    gain = float((block_sums(without.r.square().sum(0), search.problem.block) - own).sum())
    most = len(term.columns) + MORE_COLUMNS
    out: dict[str, Alternative] = {}
    for other in candidates:
        name = other.term.name
        if name == BASE and not term.is_inertial:
            # Refitted parameters would do as well: the effect stands only if they are trusted.
            worse = block_losses(search.problem, other.term, without) - own
            if mean_bound(worse, CONFIDENCE) <= 0 or float(worse.sum()) < NEGLIGIBLE * gain:
                out.setdefault(LINK, Alternative(LINK, other.term, other.gain, float(worse.mean())))
            continue
        if other.term.key == term.key or name in (*out, term.name, BASE, FRICTION):
            continue
        if not _same_place(term, other.term) or other.gain < 0.5 * gain:
            continue
        if name != LINK and len(other.term.columns) > most:
            continue
        worse = block_losses(search.problem, other.term, without) - own
        found = _not_worse(worse, gain, other, term)
        if found:
            out[name] = Alternative(name, other.term, other.gain, float(worse.mean()))
    return sorted(out.values(), key=lambda a: a.loses)


def _not_worse(worse: Float[Tensor, " K"], gain: float, other: Candidate, term: Term) -> bool:
    """Whether blocks do not reject the alternative: it loses next to nothing, or nothing that
    stands out from the blocks' spread; more columns must not merely buy it."""
    extra = PENALTY * max(0, other.df - len(term.columns)) + max(0.0, other.term.extra - term.extra)
    if float(worse.sum()) + extra < NEGLIGIBLE * gain:
        return True
    return mean_bound(worse, CONFIDENCE) + extra <= 0


def _same_place(term: Term, other: Term) -> bool:
    """Alternatives act where the accepted effect does: on its joint, or on several."""
    return term.place is None or other.place is None or term.place == other.place


def aliases(term: Term, n: int) -> tuple[str, ...]:
    """Names that are the same by physics on an arm of n joints, whatever the motion, or that an
    effect has become."""
    if len(term.effects) == 1 and term.effects[0].becomes is not None:
        return (term.effects[0].becomes,)
    joints = term.effects[0].joints if term.effects else ()
    if term.name == LINK and joints == (n - 1,):
        return ("payload",)
    if term.name == "payload":
        return (LINK,)
    if term.name == "kinematic_error" and joints == (0,):
        return ("base_tilt",)
    if term.name == "base_tilt":
        return ("kinematic_error",)
    return ()


def separation(search: Search, term: Term, other: Term) -> Float[Tensor, " K"]:
    """Per block, how much of the accepted effect's contribution the alternative cannot imitate:
    ||(I - P_b) x_a c_a||^2 / sigma^2. The blocks where it is largest are the motion to repeat."""
    model = search.model(without=[term])
    model.add(other.columns, other.place)
    left = model.r
    model.add(term.columns, term.place)
    return block_sums((left - model.r).square().sum(0), search.problem.block)
