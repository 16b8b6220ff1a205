"""Whether a term belongs into a model: by blocks of the data, and by chance.

Sums of squares are of whitened rows: one unit a row is noise.
"""

from torchid.gap.blocks import block_sums, held_out_gain, mean_bound, sign_flip_p, wald_p
from torchid.gap.fit import ROUNDED
from torchid.gap.problem import PENALTY, Problem, Term
from torchid.gap.projection import Projector, in_all_rows
from torchid.typing import Float, Tensor

FEW_COLUMNS = 4
"""Blocks a column that a Wald test needs: with fewer it finds too much."""
FLIP_LEVEL = 0.02


def few_columns(problem: Problem, count: int) -> bool:
    """Whether a Wald test of so many columns is valid."""
    return FEW_COLUMNS * count <= int(problem.block.max()) + 1


def significantly_better(
    problem: Problem, one: Term, two: Term, model: Projector, confidence: float = 0.95
) -> bool:
    """Whether `one` leaves less than `two`, judged by differences of whole blocks."""
    losses = [block_losses(problem, term, model) for term in (one, two)]
    extra = PENALTY * (len(one.columns) - len(two.columns))
    return mean_bound(losses[1] - losses[0], confidence) > max(0.0, extra)


def block_losses(problem: Problem, term: Term, model: Projector) -> Float[Tensor, " K"]:
    """Sum of squares of every block when a term joins the model."""
    after = model.copy()
    after.add(term.columns, term.place)
    return block_sums(after.r.square().sum(0), problem.block)


def holds_on_blocks(problem: Problem, term: Term, model: Projector) -> bool:
    """Where rows are whitened: random signs of blocks, or coefficients from other folds,
    confirm the gain. Else both coefficients from other folds and a Wald test whose covariance
    is the spread between blocks, at the level shared by all looks (it has no power, and no
    validity, for groups of almost as many columns as there are blocks)."""
    columns, r, block = _projected(problem, term, model)
    scores = block_sums(columns * r, block).T
    if problem.whitened:
        if sign_flip_p(scores, problem.seed) < FLIP_LEVEL:
            return True
    else:
        few = few_columns(problem, len(columns))
        if few and wald_p(columns, r, block) * problem.looks > problem.alpha:
            return False
    return mean_bound(held_out_gain(columns, r, block), 0.95) > 0


def p_value(problem: Problem, term: Term, gain: float, without: Projector) -> float:
    """Family-wise p-value of an accepted term, by the test that judged it: of its gain where
    rows are white, else of the spread between blocks."""
    if problem.whitened:
        return problem.p_value(gain, len(term.columns))
    columns, r, block = _projected(problem, term, without)
    return min(1.0, problem.looks * wald_p(columns, r, block))


def _projected(problem: Problem, term: Term, model: Projector) -> tuple[Tensor, Tensor, Tensor]:
    """A term's columns beside a model, the residual, and the block of each row."""
    columns = in_all_rows(term.columns, term.place, model.n)
    rows = model.rows_of(term.place)
    longest = columns.norm(dim=1).max()
    columns = (columns - (columns @ model.q.T) @ model.q)[:, rows]
    size = columns.norm(dim=1, keepdim=True)
    there = size[:, 0] > ROUNDED * longest
    columns = columns[there] / size[there]
    return columns, model.r.flatten()[rows], problem.blocks_of(term.place)
