"""Three simple ways to name the cause of a gap, on the columns and rows of the diagnosis.

- `friction`: always Coulomb and viscous friction, on the joint with the largest gap relative to its
  torque.
- `stlsq`: sequentially thresholded least squares (Brunton et al. 2016, PNAS 113(15)) over all
  columns, unit length, ridge 0.05 as in pysindy; of each effect the shape that fits best alone; the
  threshold is the one with the least error on a part of the data that was left out.
- `bic`: forward selection of (effect, joint) while Schwarz's criterion falls.

Rows are those of the diagnosis, divided by the noise but not whitened. Nothing here knows a key.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch

from torchid.effects.registry import KINDS, nominal_effects
from torchid.gap.bank import Bank
from torchid.gap.candidates import Evaluator
from torchid.gap.folds import Folds, make_folds
from torchid.gap.noise import noise_of
from torchid.gap.passages import Rows
from torchid.gap.prepare import prepare, report_band
from torchid.gap.problem import BASE, LINK, Term, term_of
from torchid.gap.projection import Projector, Scanner, in_all_rows
from torchid.gap.settings import GapSettings
from torchid.gap.task import Task, banks_of
from torchid.identification.base_parameters import base_parameters
from torchid.json_data import plain
from torchid.log.model import Log
from torchid.log.readers import read_log
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.typing import Bool, Float, Tensor
from torchid.withheld.run import Job, written

RIDGE = 0.05
THRESHOLDS = (0.02, 0.05, 0.1, 0.2, 0.4)
ITERATIONS = 20
MOST = 20
"""Effects at most, as in the diagnosis."""

FELT_SHARE = 0.01
"""Of an effect's square, from which a joint feels it."""


@dataclass(frozen=True)
class Data:
    """What a baseline sees.

    Attributes:
        y: (n, N) gap in units of the noise; rows that do not count are zero.
        keep: (n, N) rows that count.
        banks: candidates.
        relative: (n,) RMS of the gap as a share of the torque's.
        folds: two, by trajectories or stretches.
    """

    y: Float[Tensor, "n N"]
    keep: Bool[Tensor, "n N"]
    banks: tuple[Bank, ...]
    relative: Float[Tensor, " n"]
    folds: Folds


def data_of(robot: Robot, log: Log, settings: GapSettings) -> Data:
    """Rows and columns of a log."""
    given = prepare(robot, log, None)
    effects = nominal_effects(robot)
    shown = Rows(given.rows.passages, report_band(given.rows, settings.report_band))
    noise = noise_of(robot, effects, given.rows, shown, seed=settings.seed)
    keep = given.counting(noise.repeated)
    evaluator = Evaluator(robot, effects, given.rows, noise.scaling(keep))
    y = evaluator.residual()
    torque = evaluator.on_all([p.tau.T for p in given.rows.passages])
    relative = y.norm(dim=1) / torque.norm(dim=1).clamp(min=1e-12)
    banks = banks_of(
        evaluator,
        Task(
            base=base_parameters(robot),
            names=tuple(KINDS),
            background=(),
            free=False,
            inertial=True,
            own_velocity=given.own_velocity,
            age=given.age,
            whitened=noise.repeated,
            most=MOST,
            alpha=settings.alpha,
            seed=settings.seed,
        ),
    )
    # No composites, no effects common to all joints, not all base parameters at once.
    plain = tuple(b for b in banks if b.name != BASE and b.members and len(b.members[0]) == 1)
    return Data(y, keep, plain, relative, make_folds(given.rows, 2, noise.groups))


def friction(data: Data) -> list[Term]:
    """Coulomb and viscous friction of the joint with the largest relative gap."""
    worst = int(data.relative.argmax())
    wanted = ("coulomb_friction", "viscous_friction")
    return [term_of(b) for b in data.banks if b.name in wanted and b.place == worst]


def bic(data: Data) -> list[Term]:
    """Forward selection while N ln(L / N) + k ln N falls."""
    model = Projector(data.y)
    scanners = [Scanner(bank, data.keep) for bank in data.banks]
    rows = int(data.keep.sum())
    found: list[Term] = []
    taken: set[int] = set()
    while len(found) < MOST:
        best, choice = 0.0, None
        for k, scanner in enumerate(scanners):
            if k in taken:
                continue
            gains = scanner.gains(model)
            left = (model.loss - gains.gain).clamp(min=1e-9 * model.loss)
            change = rows * (left / model.loss).log() + gains.df * math.log(rows)
            if float(change.min()) < best:
                best, choice = float(change.min()), (k, int(change.argmin()))
        if choice is None:
            break
        term = term_of(data.banks[choice[0]], choice[1])
        model.add(term.columns, term.place)
        found.append(term)
        taken.add(choice[0])
    return found


def stlsq(data: Data) -> list[Term]:
    """Columns that survive; an effect is named if one of its own does."""
    start = Projector(data.y)
    terms = []
    for bank in data.banks:
        gain = Scanner(bank, data.keep).gains(start).gain
        if float(gain.max()) > 0:
            terms.append(term_of(bank, int(gain.argmax())))
    if not terms:
        return []
    x = _stacked(terms, data)
    y = data.y.flatten()
    train = data.folds.fitted(0).repeat(len(data.y))
    size = x.norm(dim=1).clamp(min=1e-300)
    x = x / size.unsqueeze(1)
    whole = x @ x.T, x @ (y / y.norm()), float(y.norm())
    part = (x * train) @ x.T, (x * train) @ (y / y.norm()), float(y.norm())
    error, chosen = float((y * ~train).square().sum()), math.inf
    for threshold in THRESHOLDS:
        values = _thresholded(part[0], part[1], threshold) * part[2]
        left = float(((y - values @ x) * ~train).square().sum())
        if left < error:
            error, chosen = left, threshold
    if chosen == math.inf:
        return []
    kept = _thresholded(whole[0], whole[1], chosen) != 0
    owner = torch.tensor([k for k, t in enumerate(terms) for _ in t.columns])
    return [terms[k] for k in sorted(set(owner[kept].tolist()))]


def _thresholded(gram: Tensor, b: Tensor, threshold: float) -> Tensor:
    """Coefficients of unit columns for a target of length one, small ones made zero again and
    again; those that stay are fitted without the ridge."""
    kept = torch.ones(len(b), dtype=torch.bool)
    for _ in range(ITERATIONS):
        values = _ridge(gram, b, kept, RIDGE)
        new = kept & (values.abs() >= threshold)
        if bool((new == kept).all()):
            break
        kept = new
    return _ridge(gram, b, kept, 1e-9)


def _ridge(gram: Tensor, b: Tensor, kept: Tensor, ridge: float) -> Tensor:
    values = torch.zeros_like(b)
    if bool(kept.any()):
        own = gram[kept][:, kept]
        eye = torch.eye(len(own), dtype=own.dtype)
        values[kept] = torch.linalg.solve(own + ridge * eye, b[kept])
    return values


METHODS: dict[str, Callable[[Data], list[Term]]] = {
    "friction": friction,
    "stlsq": stlsq,
    "bic": bic,
}


def answer_of(data: Data, terms: Sequence[Term]) -> dict[str, Any]:
    """Named effects in the form of a diagnosis. Coefficients are fitted on one half of the data for
    the other; what was chosen, was chosen on all of them, in the baseline's favour."""
    which = [_entry(term, part) for term, part in _parts(data, terms)]
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


def _entry(term: Term, part: Float[Tensor, "n N"]) -> dict[str, Any]:
    effect = term.effects[0]
    square = part.square().sum(1)
    felt = (square > FELT_SHARE * square.sum()).nonzero().flatten().tolist()
    return {
        "effect": effect.name,
        "family": effect.family,
        "joints": [j + 1 for j in (effect.joints or felt)],
        "places": ["joint"] if effect.joints else [],
        "ambiguous_with": [],
        "parameters": {},
        "share": float(square.sum()),
    }


def _parts(data: Data, terms: Sequence[Term]) -> list[tuple[Term, Tensor]]:
    """Every term with its part (n, N) of the fitted gap."""
    if not terms:
        return []
    x = _stacked(terms, data)
    values = _solved(x, data.y.flatten())
    pieces = (values.unsqueeze(1) * x).split([len(t.columns) for t in terms])
    return [(t, p.sum(0).reshape(data.y.shape)) for t, p in zip(terms, pieces, strict=True)]


def _closed(data: Data, terms: Sequence[Term]) -> float | None:
    """(L0 - L*) / (L0 - Ln), coefficients fitted on the other fold; None where there is no gap."""
    before, noise = float(data.y.square().sum()), float(data.keep.sum())
    if before <= noise:
        return None
    if not terms:
        return 0.0
    x, y = _stacked(terms, data), data.y.flatten()
    after = 0.0
    for k in range(data.folds.count):
        train = data.folds.fitted(k).repeat(len(data.y))
        held = (data.folds.fold == k).repeat(len(data.y))
        values = _solved(x * train, y * train)
        after += float(((y - values @ x) * held).square().sum())
    return (before - after) / (before - noise)


def _stacked(terms: Sequence[Term], data: Data) -> Float[Tensor, "P nN"]:
    """Columns of all terms in all rows that count."""
    n = len(data.y)
    rows = data.keep.flatten()
    return torch.cat([in_all_rows(t.columns, t.place, n) * rows for t in terms])


def _solved(x: Tensor, y: Tensor) -> Tensor:
    """Least squares, of least norm where columns are dependent; zero for columns that are."""
    size = x.norm(dim=1)
    size = torch.where(size > 0, size, math.inf)
    unit = x / size.unsqueeze(1)
    inverse = torch.linalg.pinv(unit @ unit.T, rtol=1e-7, hermitian=True)
    return (inverse @ (unit @ y)) / size


def baseline_case(job: Job) -> dict[str, Any]:
    """All baselines of one case, written like an answer."""

    def answer() -> dict[str, Any]:
        data = data_of(load_robot(job.robot), read_log(job.log), job.settings)
        methods = {k: answer_of(data, m(data)) for k, m in METHODS.items()}
        return {"methods": plain(methods), "status": "done"}

    return written(job, answer)
