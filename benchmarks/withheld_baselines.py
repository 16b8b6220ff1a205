"""Three simple ways to name the cause of a gap, on the columns and rows of the diagnosis.

- `friction`: always Coulomb and viscous friction, on the joint with the largest gap relative to its
  torque.
- `stlsq`: sequentially thresholded least squares (Brunton et al. 2016, PNAS 113(15)) over all
  columns, unit length, ridge 0.05 as in pysindy; of each effect the shape that fits best alone; the
  threshold is the one with the least error on a part of the data that was left out.
- `bic`: forward selection of (effect, joint) while Schwarz's criterion falls.

Samples are those of the diagnosis, joints weighted by their noise, or, in `bic`, by what is left.
Nothing here knows a key.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch

from torchid.design.columns import Columns, Model
from torchid.design.gram import Equations, Folds, Normal
from torchid.design.repeats import find_repeats
from torchid.effects.base import Effect
from torchid.effects.registry import KINDS
from torchid.gap.data import prepare
from torchid.gap.folds import make_folds
from torchid.gap.noise.floor import noise_of, sliding_only
from torchid.gap.search.events import contacts
from torchid.gap.search.evidence import Offer, Question, fit_terms, offers, subset_of
from torchid.gap.search.terms import LINK, Term, Wanted, candidates_of
from torchid.gap.settings import GapSettings
from torchid.gap.validate.closing import noise_variance
from torchid.identification.base_parameters import base_parameters
from torchid.json_data import plain
from torchid.log.model import Log
from torchid.log.readers import read_log
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor
from torchid.withheld.run import Job, written

RIDGE = 0.05
"""Of `stlsq`, of columns and target of unit length [1]."""

THRESHOLDS = (0.02, 0.05, 0.1, 0.2, 0.4)
"""Of `stlsq`, that are tried, of the same coefficients [1]."""

ITERATIONS = 20
"""Of `stlsq` at most: each takes a column away."""

MOST = 20
"""Effects at most, as in the diagnosis."""

FELT_SHARE = 0.01
"""Of an effect's square, from which a joint feels it."""

FOLDS = 2
"""Parts of the data, each judged by what was fitted on the other."""


@dataclass(frozen=True, eq=False)
class Data:
    """What a baseline sees.

    Attributes:
        question: the gap, and the candidates with their normal equations.
        weight: (n,) of each joint's squares: one over the noise's.
        relative: (n,) RMS of the gap as a share of the torque's.
        folds: each judged by the others, by trajectories or stretches.
    """

    question: Question
    weight: Float[Tensor, " n"]
    relative: Float[Tensor, " n"]
    folds: Folds

    @property
    def normal(self) -> Normal:
        """Of all samples that count."""
        return self.question.normal


def data_of(robot: Robot, log: Log, settings: GapSettings) -> Data:
    """Samples and columns of a log, as the diagnosis has them."""
    given = prepare(robot, log, None)
    samples = given.samples
    columns = Columns(Model.of(robot), samples)
    repeats = find_repeats(samples.segments)
    keep = sliding_only(columns, given.keep, samples.cutoff, repeats)
    given, gap = replace(given, keep=keep), columns.gap
    # In the band of the fit.
    share = (samples.cutoff / given.band) ** 2.5
    narrow = replace(given, band=samples.cutoff, positions=given.positions * share)
    noise = noise_of(columns, columns.model, gap * keep, narrow, repeats, settings.seed)
    folds = make_folds(samples, FOLDS, repeats.groups(len(samples.segments)))
    wanted = Wanted(tuple(KINDS), False, (), True, None, base_parameters(robot, basis="report"))
    torque = samples.of([s.tau.T for s in samples.segments])

    def asked(extra: Sequence[Effect]) -> Question:
        found = candidates_of(columns, gap, given, wanted, folds.parts, columns.model, extra)
        return Question(found, found.gram.over(), settings)

    question = asked(())
    pushes = contacts(question)
    if pushes:
        question = asked(pushes)
    return Data(
        question,
        1 / noise_variance(noise.floor),
        (gap * keep).norm(dim=1) / torque.norm(dim=1).clamp(min=1e-12),
        question.candidates.gram.folds(),
    )


def friction(data: Data) -> list[Term]:
    """Coulomb and viscous friction of the joint with the largest relative gap."""
    worst = int(data.relative.argmax())
    wanted = ("coulomb_friction", "viscous_friction")
    terms = data.question.candidates.terms
    return [t for t in terms if t.name in wanted and t.place == worst and not t.instead]


def bic(data: Data) -> list[Term]:
    """Forward selection while sum_j N_j ln L_j + k ln N falls, all samples taken as independent."""
    found: list[Term] = []
    while len(found) < MOST:
        best = next(iter(_offered(data, found)), None)
        if best is None or best.net <= 0:
            break
        found.append(best.term)
    return found


def stlsq(data: Data) -> list[Term]:
    """Columns that survive; an effect is named if one of its own does."""
    shapes: dict[object, Offer] = {}
    for offer in sorted(_offered(data, []), key=lambda o: -o.gain):
        shapes.setdefault(offer.term.key, offer)
    terms = [offer.term for offer in shapes.values()]
    subset = subset_of(data.normal, terms)
    train, test = (equations[0] for equations in data.folds.of(subset))
    least, chosen = float(data.weight @ test.squares), None
    for threshold in THRESHOLDS:
        left = float(data.weight @ test.losses(_sparse(data, train, threshold)))
        if left < least:
            least, chosen = left, threshold
    if chosen is None:
        return []
    kept = _sparse(data, data.normal.of(subset), chosen).split([len(t.at) for t in terms])
    return [t for t, own in zip(terms, kept, strict=True) if bool((own != 0).any())]


def _offered(data: Data, beside: Sequence[Term]) -> list[Offer]:
    """What effects would add to others, the best first: none that all joints share, and not all
    base parameters at once."""
    fit = fit_terms(data.question, beside, data.normal.rows)
    return [o for o in offers(data.question, fit) if len(o.term.effects) == 1]


def _sparse(data: Data, equations: Equations, threshold: float) -> Float[Tensor, " K"]:
    """Coefficients of which those that are small, in units of unit columns and target, are zero."""
    gram, right = equations.weighted(data.weight)
    target = float(data.weight @ equations.squares) ** 0.5
    size = gram.diagonal().sqrt()
    unit = torch.where(size > 0, 1 / size, 0.0)
    values = _thresholded(gram * unit * unit.unsqueeze(1), right * unit / target, threshold)
    return values * unit * target


def _thresholded(gram: Tensor, b: Tensor, threshold: float) -> Tensor:
    """Coefficients of unit columns for a target of length one, small ones made zero again and
    again; those that stay are fitted without the ridge."""
    kept = torch.ones(len(b), dtype=torch.bool)
    for _ in range(ITERATIONS):
        new = kept & (_ridge(gram, b, kept, RIDGE).abs() >= threshold)
        if bool((new == kept).all()):
            break
        kept = new
    return _ridge(gram, b, kept, 1e-9)


def _ridge(gram: Tensor, b: Tensor, kept: Tensor, ridge: float) -> Tensor:
    values = torch.zeros_like(b)
    own = gram[kept][:, kept]
    values[kept] = torch.linalg.solve(own + ridge * torch.eye(len(own)).to(own), b[kept])
    return values


METHODS: dict[str, Callable[[Data], list[Term]]] = {f.__name__: f for f in (friction, stlsq, bic)}


def answer_of(data: Data, terms: Sequence[Term]) -> dict[str, Any]:
    """Named effects in the form of a diagnosis. Coefficients are fitted on one half of the data for
    the other; what was chosen, was chosen on all of them, in the baseline's favour."""
    x = data.normal.of(subset_of(data.normal, terms)).solve(data.weight).x
    parts = x.split([len(t.at) for t in terms]) if terms else ()
    which: list[dict[str, Any]] = []
    for term, part in zip(terms, parts, strict=True):
        effect = term.effects[0]
        square = torch.zeros_like(data.weight)
        for j in range(len(square)) if term.place is None else (term.place,):
            own = data.normal.g[j][term.at.unsqueeze(1), term.at]
            square[j] = data.weight[j] * (part @ own @ part)
        felt = (square > FELT_SHARE * square.sum()).nonzero().flatten().tolist()
        which.append(
            {
                "effect": effect.name,
                "family": effect.family,
                "joints": [j + 1 for j in (effect.joints or felt)],
                "places": ["joint"] if effect.joints else [],
                "ambiguous_with": [],
                "parameters": {},
                "share": float(square.sum()),
            }
        )
    which.sort(key=lambda entry: -entry["share"])
    inertial = bool(which) and all(entry["effect"] == LINK for entry in which)
    status = "parametric_only" if inertial else "explained" if which else "no_gap"
    return {
        "status": status,
        "which": which,
        "parametric": [],
        "not_testable": [],
        "how_far": {"closed": _closed(data, terms), "closed_ci95": None},
    }


def _closed(data: Data, terms: Sequence[Term]) -> float | None:
    """Share of the error beyond noise, joints in units of their noise, that is closed where
    coefficients are fitted on the other fold; None where there is no gap."""
    before = after = 0.0
    fitted, judged = data.folds.of(subset_of(data.normal, terms))
    for k in range(len(data.folds)):
        train, test = fitted[k], judged[k]
        x = train.solve(data.weight).x
        before += float(data.weight @ test.squares)
        after += float(data.weight @ test.losses(x))
    noise = float(data.folds.rows.sum())
    if before <= noise:
        return None
    return 1 - math.sqrt(max(0.0, after - noise) / (before - noise))


def baseline_case(job: Job) -> dict[str, Any]:
    """All baselines of one case, written like an answer."""

    def answer() -> dict[str, Any]:
        data = data_of(load_robot(job.robot), read_log(job.log), job.settings)
        methods = {k: answer_of(data, m(data)) for k, m in METHODS.items()}
        return {"methods": plain(methods), "status": "done"}

    return written(job, answer)
