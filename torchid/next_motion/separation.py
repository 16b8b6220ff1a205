"""What a motion tells of explanations of a gap.

Two explanations a, b have columns X_a, X_b along a motion; what else the model fits has columns Z
(other accepted effects, and base parameters where they are free). If a is true with coefficients
c_a, b can imitate all of X_a c_a but

    D_ab = ||(I - P_[Z X_b]) X_a c_a||^2 / sigma^2,

twice the logarithm of the likelihood ratio that the motion is expected to give. A diagnosis also
asks that it stand out from its spread between blocks of the log, and that it be more than a small
share of ||(I - P_Z) X_a c_a||^2: no law fits an arm better.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch

from torchid.effects.base import Effect
from torchid.effects.inertia import WEIGHED
from torchid.effects.registry import KINDS
from torchid.excitation.fourier import FourierTrajectory
from torchid.next_motion.rows import Group, Rows, Setting, directions, without
from torchid.typing import Float, Tensor

DECISIVE = 9.0
"""Expected difference of the squared residuals, in noise units, from which a motion decides if it
tells as much all the time, """
SAME_SHARE = 4e-3
"""if it is also more than this share of what the true explanation explains: twice what a diagnosis
neglects."""


SAME_DIFFERENCE = 1e-3
"""D below which two explanations are the same."""

FITTED = "take it from the maker's data, or trust the inertial parameters and diagnose again"
"""What settles a question where an effect knows nothing better."""


@dataclass(frozen=True)
class Explanation:
    """Effects that share their coefficients, and these."""

    effects: Group
    values: tuple[float, ...]

    @property
    def effect(self) -> Effect:
        """The first effect of the group."""
        return self.effects[0]


@dataclass(frozen=True)
class Rival:
    """An explanation that is true, and what it must not be taken for.

    Attributes:
        truth: effect and coefficients.
        others: shapes of the other effect, any of which may be fitted; or its several places.
            Empty: base parameters, or nothing at all (is the effect seen?).
        name: of the other; empty for nothing at all.
        leaving: the accepted effect in whose place either of them is.
    """

    truth: Explanation
    others: tuple[Group, ...]
    name: str
    leaving: Group = ()


def name_pairs(rivals: Iterable[Rival]) -> str:
    """Pairs for a sentence, the joints of each gathered."""
    places: dict[tuple[str, str], list[str]] = {}
    for r in rivals:
        joints = r.truth.effect.joints[:1] if len(r.truth.effects) == 1 else ()
        own = places.setdefault((r.truth.effect.name, r.name), [])
        own += [str(j + 1) for j in joints if str(j + 1) not in own]
    said = []
    for (name, other), own in places.items():
        place = f" of joint {', '.join(own)}" if own else ""
        said.append(name + place + (f" against {other}" if other else ""))
    return "; ".join(said)


def other_means(names: Iterable[str]) -> str:
    """What else would tell these effects, in one sentence; refitted base parameters (`all_base`)
    are bodies too."""
    advice: dict[str, list[str]] = {}
    for name in dict.fromkeys(names):
        kind = KINDS.get(name)
        own = kind.beyond if kind is not None else WEIGHED if name == "all_base" else None
        advice.setdefault(own or FITTED, []).append(name)
    return "; ".join(f"{', '.join(own)}: {text}" for text, own in advice.items())


class Discrimination(NamedTuple):
    """What a motion tells of a pair: D, and how much of what decides that is, in D and in share."""

    difference: float
    reached: float


def separations(
    setting: Setting, rivals: Sequence[Rival], trajectory: FourierTrajectory
) -> list[Discrimination]:
    """What a trajectory tells of every pair; the other's least favourable shape counts."""
    rows = Rows(setting, trajectory)
    return [_separation(rows, rival) for rival in rivals]


def torque_of(truth: Explanation, rows: Rows, leaving: Group) -> Float[Tensor, " R"]:
    """Torque of an explanation along a motion, beside a model without some effects."""
    return rows.columns(truth.effects, leaving) @ torch.tensor(truth.values, dtype=torch.float64)


def _separation(rows: Rows, rival: Rival) -> Discrimination:
    gone = rival.leaving
    whole = torque_of(rival.truth, rows, gone)
    own = rows.beside(whole, gone)
    if not rival.name:
        difference = float(own.square().sum())
        # 42.0: D at the smallest detectable size that a diagnosis reports: twice 1.3 times chi^2's
        # quantile for 400 tests at 1 %,
        # 0.02: if more than this share of its column is no combination of what is fitted
        return Discrimination(difference, min(difference / 42.0, _share(own, whole) / 0.02))
    if rival.others:
        nearest = rival.others[int(left_by_forms(rows, rival, own).argmin())]
        other = rows.beside(rows.columns(nearest, gone), gone)
        left, columns = without(own, directions(other)), 0
    else:
        left, columns = rows.beside(whole, gone, base=True), rows.base_columns
    samples = _in_blocks(left.reshape(rows.torque.shape).square().sum(0), columns)
    return Discrimination(float(left.square().sum()), min(samples, _share(left, own) / SAME_SHARE))


def _in_blocks(square: Float[Tensor, " R"], columns: int) -> float:
    """How much of what decides a difference of squared residuals is, by its spread between blocks.

    A diagnosis asks that the lower confidence bound of the blocks' mean m be positive. Noise makes
    their variance 4 m, the motion more where it tells much in few of them; spread evenly, this is
    D / 9. The other has `columns` more that fit noise.
    """
    # Into which a diagnosis divides a log of less than 40 s
    blocks = 20
    d = torch.stack([part.sum() for part in square.tensor_split(blocks)])
    mean = max(0.0, float(d.mean()) - columns / blocks)
    spread = float(d.var()) + 4 * float(d.mean())
    return 4 * blocks * mean**2 / (DECISIVE * max(spread, 1e-300))


def _share(part: Tensor, of: Tensor) -> float:
    return float(part.square().sum() / of.square().sum().clamp(min=1e-300))


def left_by_forms(rows: Rows, rival: Rival, own: Tensor) -> Float[Tensor, " F"]:
    """What each form of the other cannot explain of `own`, squared, by normal equations: every form
    has a few columns, of length one."""
    forms = [rows.columns(x, rival.leaving) for x in rival.others]
    x = rows.beside(torch.cat(forms, 1), rival.leaving)
    x = x / torch.linalg.vector_norm(x, dim=0).clamp(min=1e-9)
    x = x.T.reshape(len(forms), -1, len(own))
    values, vectors = torch.linalg.eigh(x @ x.mT)
    along = ((x @ own).unsqueeze(-2) @ vectors).squeeze(-2)
    # Eigenvalue of a form's columns below which a direction is rounding
    tiny = 1e-11
    held = torch.where(values > tiny, along.square() / values.clamp(min=tiny), 0.0).sum(-1)
    return (own.square().sum() - held).clamp(min=0)


def imitation(
    rows: Rows, truth: Explanation, others: Sequence[Group], leaving: Group = ()
) -> Explanation | None:
    """The shape with which another effect is most like a true one along a motion, its coefficients
    such that it explains as much; None where its columns say nothing beside what is fitted.

    Of an effect that without some coefficients would be a simpler one, only these are used: else a
    joint's spring would imitate a torque offset by having no stiffness.
    """
    left = rows.beside(torque_of(truth, rows, leaving), leaving)
    best: tuple[float, Explanation] | None = None
    for other in others:
        columns = rows.beside(rows.columns(other, leaving), leaving)
        used = list(other[0].essential or range(columns.shape[1]))
        size = torch.linalg.vector_norm(columns[:, used], dim=0)
        if float(size.max()) < SAME_DIFFERENCE:
            continue
        safe = size.clamp(min=1e-12)
        part = columns[:, used] / safe
        x = torch.linalg.lstsq(part, left.unsqueeze(-1), driver="gelsd").solution.flatten()
        like = part @ x
        rest = float((left - like).square().sum())
        if best is None or rest < best[0]:
            values = columns.new_zeros(columns.shape[1])
            values[used] = x / safe * (left.norm() / like.norm().clamp(min=1e-12))
            best = rest, Explanation(tuple(other), tuple(values.tolist()))
    return None if best is None else best[1]
