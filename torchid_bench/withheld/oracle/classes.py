"""What can be known of an effect that was planted, by an oracle that knows its torque.

No diagnosis can be asked to name an effect whose torque another one makes as well. The oracle has
a log twice, with the effect and without, so it knows the torque that was planted, whatever the form
of its law: one column with one coefficient. Beside it stands what else the effect of this name
makes, where the library has one: nobody knows the ratios of its coefficients beforehand. The truth
is held against nothing and against every other effect of the library, at every place and with the
likeliest of its shapes. What counts is the evidence (`evidence.py`), in nats. Truth over a rival is
the better of truth alone and of both, over the rival alone: what a rival explains beside the truth
speaks for neither.

    below        less than 1 % of the joint's torque on every joint, while it acts
    undecidable  5 nats over nothing, or less
    ambiguous    more, but 3 nats or less over the best rival
    decidable    more than that

Asked *in practice*, all that the model leaves open is fitted beside: its base parameters and its
own effects, as far as they are not known, and what was there before anything was planted; what is
left is noise. Asked *ideally*, the background is known: the gap is what was planted, and the
sensors' noise. Of several effects each is judged beside the others' torques. Nothing here is taken
from the diagnosis, torchid.gap.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from torchid.effects.base import JointEffect
from torchid_bench.withheld.oracle.evidence import Terms, comparable, independent, nats
from torchid_bench.withheld.oracle.library import (
    TIMES_GAP,
    Candidate,
    Group,
    Half,
    candidate,
    grouped,
    left_open,
    precisions,
    restored,
    shaped,
)

OVER_NOTHING, OVER_RIVAL = 5.0, 3.0
"""Nats above which the truth is told from nothing, and from its best rival."""


ALREADY_THERE = 10.0
"""Nats over nothing above which something was there before anything was planted: the logarithm of a
thousand effects, places and shapes that are looked at, and three more."""

MOST_THERE = 10
"""Of such causes at most."""

RANKED, FITTED, REFINED = 30, 8, 4
"""Rivals that are fitted, those of them that are compared with the truth on samples of the pair's
own, and those whose shapes are refined."""


@dataclass(frozen=True, eq=False)
class Truth:
    """An effect that was planted.

    Attributes:
        names: of effects, or of their families, that are right for it.
        joints: located at and felt by, from 0; none of the whole arm.
        torque: (n, N) samples of what it adds to the gap [N m; N].
    """

    names: frozenset[str]
    joints: frozenset[int]
    torque: np.ndarray

    @classmethod
    def of(
        cls, names: Sequence[str], joints: Sequence[int], planted: Half, without: Half
    ) -> "Truth":
        """What a log has that the same one without this effect has not; each may have a robot's
        file of its own."""
        gaps = (half.columns.gap.numpy() for half in (planted, without))
        return cls(frozenset(names), frozenset(joints), np.subtract(*gaps) * planted.keep)

    def holds(self, c: Candidate) -> bool:
        """Whether a candidate names it, or a part of it."""
        near = not c.joints or not self.joints or not self.joints.isdisjoint(c.joints)
        return near and any(not self.names.isdisjoint((e.name, e.family)) for e in c.effects)

    def scaled(self, half: Half, law: Candidate | None = None) -> np.ndarray:
        """Its column (1, n, N) per standard deviation, none of a torque that is zero; and columns
        of what else its law makes."""
        size = np.maximum(half.gap.rows, 1.0) * (TIMES_GAP * half.size) ** 2
        precision = ((self.torque**2).sum(1) / size).sum(keepdims=True)[:, None]
        into = independent(precision)
        out = into[into.any(1)][..., None] * self.torque[None]
        if law is None or not len(out):
            return out
        unit, more = out[0] / np.linalg.norm(out), law.scaled(half)[0]
        return np.concatenate([out, more - np.tensordot(more, unit, 2)[:, None, None] * unit])

    def share(self, half: Half) -> float:
        """Its torque over the joint's, both RMS, while it acts; of the joint with the largest."""
        acts = np.abs(self.torque) > 0.01 * np.abs(self.torque).max(1, keepdims=True)
        mean = (self.torque**2).sum(1) / np.maximum((acts & half.keep).sum(1), 1)
        return float((np.sqrt(mean) / np.maximum(half.torque, 1e-300)).max())


Class = dict[str, Any]
"""`class` of an effect; its `share_of_torque`; nats `over_nothing` and `over_rival`, the best one;
and `rivals` within `OVER_RIVAL`, or the best: each its name, joints from 1, and nats over it."""


def in_practice(
    planted: Half,
    bare: Half,
    truths: Sequence[Truth],
    there: Sequence[Sequence[Mapping[str, Any]]] | None = None,
) -> list[Class]:
    """Classes of effects where all else is unknown.

    Args:
        planted: the log with all of them.
        bare: the same log without any.
        truths: the effects.
        there: what was there before, as `already_there` finds it on `bare`; looked for if None.
    """
    found = already_there(bare) if there is None else there
    rest = [restored(planted, records) for records in found]
    known = [c for c in rest if not any(truth.holds(c) for truth in truths)]
    base = left_open(planted)
    for c in known:
        base = base.with_(c.scaled(planted)[0])
    return [_classified(planted, base, truths, k) for k in range(len(truths))]


def ideally(planted: Half, quiet: Half, truths: Sequence[Truth]) -> list[Class]:
    """Classes of effects where all else is known.

    Args:
        planted: the log with all of them.
        quiet: the same log of an arm that its file describes: its gap is the sensors' noise.
        truths: the effects.
    """
    noise = quiet.columns.gap.numpy()
    half = planted.explaining(noise + sum(truth.torque for truth in truths))
    base = Terms.of(half.gap, np.zeros((0, *half.gap.y.shape)))
    return [_classified(half, base, truths, k) for k in range(len(truths))]


def _classified(half: Half, base: Terms, truths: Sequence[Truth], number: int) -> Class:
    """One effect beside the others."""
    truth = truths[number]
    for other in (*truths[:number], *truths[number + 1 :]):
        base = base.with_(other.scaled(half))
    effective = comparable(base.with_(truth.scaled(half)), base)
    # The likeliest first: what is right for it, and its rivals.
    order = ranked(half, base, half.library, effective)
    laws = (possible(half, base, c, effective) for c in order if truth.holds(c))
    law = next((refined(half, base, p, effective)[0] for p in laws if p is not None), None)
    true = base.with_(truth.scaled(half, law))
    nothing, effective = nats(true, base), comparable(true, base)
    # Rivals of the same torque beside the truth add nothing.
    some = (possible(half, base, c, effective) for c in order if not truth.holds(c))
    each = list(itertools.islice((p for p in some if p is not None), RANKED))
    alone = true.fit(effective).evidence

    def instead(c: Candidate) -> float:
        x = c.scaled(half)[0]
        both = true.with_(x).fit(effective).evidence
        return base.with_(x).fit(effective).evidence - max(alone, both)

    each = sorted(each, key=lambda p: -instead(p[0]))[:FITTED]
    each += [refined(half, base, p, effective) for p in each[:REFINED]]
    rivals: dict[object, tuple[float, Candidate]] = {}
    for c, _ in each:
        x = c.scaled(half)[0]
        rival = base.with_(x)
        over = max(nats(true, rival), nats(true.with_(x), rival))
        if c.key not in rivals or over < rivals[c.key][0]:
            rivals[c.key] = over, c
    nearest = sorted(rivals.values(), key=lambda r: r[0])
    over = nearest[0][0] if nearest else np.inf
    share = truth.share(half)
    out = {
        "class": class_of(share, nothing, over),
        "share_of_torque": round(share, 4),
        "over_nothing": round(nothing, 2),
    }
    if nearest:
        near = [r for r in nearest if r[0] <= OVER_RIVAL] or nearest[:1]
        out["over_rival"] = round(over, 2)
        out["rivals"] = [[c.name, [j + 1 for j in c.joints], round(x, 2)] for x, c in near]
    return out


def class_of(share: float, nothing: float, rival: float) -> str:
    """Class of a case whose torque is such a share of its joint's, so many nats over nothing and
    over the best rival."""
    # 0.01: share of a joint's torque below which no cause is worth a name
    if share < 0.01:
        return "below"
    if nothing <= OVER_NOTHING:
        return "undecidable"
    return "ambiguous" if rival <= OVER_RIVAL else "decidable"


# Candidates.


def ranked(
    half: Half,
    base: Terms,
    groups: Sequence[Group],
    effective: np.ndarray,
    crosses: dict[int, np.ndarray] | None = None,
) -> list[Candidate]:
    """Candidates by the rise of the evidence to first order, the best shape of each alone; none
    whose one coefficient would be one that no arm has.

    Args:
        half, base, groups, effective: what is asked.
        crosses: products of the groups' columns with the base's, which is the one that these are of
            or begins with it; they are brought up to it.
    """
    of, crosses = base.fit(effective), {} if crosses is None else crosses
    weight, left, best = effective / of.losses, base.left(of), dict[object, Any]()
    for number, (some, x) in enumerate(groups):
        felt = list(some[0].felt)
        w, every = weight[felt], np.stack([c.products for c in some])
        count = len(some), x.shape[1] // len(some)
        into = independent(precisions(half, some, every))
        turned = into.swapaxes(1, 2)
        right = np.tensordot(w, x @ left[felt][..., None], 1).reshape(*count, 1)
        # What of their products the base leaves.
        products = np.einsum("m,smcd->scd", w, every)
        known = crosses.get(number, np.zeros((len(felt), 0, x.shape[1])))
        new = base.columns[felt, known.shape[1] :] @ x.transpose(0, 2, 1)
        crosses[number] = np.concatenate([known, new], 1)
        u = np.tensordot(w, crosses[number], 1)
        parts = ((of.covariance @ u).reshape(-1, *count), u.reshape(-1, *count))
        whole = products - np.einsum("ksc,ksd->scd", *parts)
        inverse = np.linalg.inv(np.eye(count[1]) + turned @ whole @ into)
        b = turned @ right
        explained = (b.swapaxes(1, 2) @ inverse @ b)[:, 0, 0]
        rises = 0.5 * (explained + np.linalg.slogdet(inverse)[1])
        values, covariances = (into @ inverse @ b)[..., 0], into @ inverse @ turned
        for c, rise, value, covariance in zip(some, rises, values, covariances, strict=True):
            none = len(value) == 1 and c.forbids(value, covariance).all()
            if not none and (c.key not in best or rise > best[c.key][0]):
                best[c.key] = rise, c
    return [c for _, c in sorted(best.values(), key=lambda p: -p[0])]


def possible(
    half: Half, base: Terms, c: Candidate, effective: np.ndarray
) -> tuple[Candidate, np.ndarray] | None:
    """A candidate and its coefficients (C,) beside the base, without those that no arm has; None
    where it is nothing or another effect without them."""
    essential = {k for e in c.effects for k in e.essential}
    while True:
        x, into = c.scaled(half)
        of = base.with_(x).fit(effective)
        value = into @ of.z[-into.shape[1] :]
        own = of.covariance[-into.shape[1] :, -into.shape[1] :]
        wrong = c.forbids(value, into @ own @ into.T)
        wrong &= c.columns.any((1, 2))
        if not wrong.any():
            return c, value
        columns = c.columns * ~wrong[:, None, None]
        if not columns.any() or any(wrong[k] for k in essential):
            return None
        c = replace(c, columns=columns)


def finer(half: Half, c: Candidate, values: np.ndarray, level: int) -> list[Candidate]:
    """A candidate with shapes around its own, or with its secant at its estimate."""
    e = c.effects[0]
    if len(c.effects) > 1:
        return []
    if isinstance(e, JointEffect):
        shapes = e.finer(half.columns.motions, level, half.columns.samples.cutoff)
        return [] if shapes is None else shaped(half, type(e), e.joint, shapes)
    at = e.at_estimate(values.tolist())
    return [] if at == e else [candidate(half, [at])]


def refined(
    half: Half, base: Terms, pair: tuple[Candidate, np.ndarray], effective: np.ndarray
) -> tuple[Candidate, np.ndarray]:
    """The likeliest of a candidate's shapes."""
    for level in range(2):
        near = finer(half, *pair, level)
        first = ranked(half, base, grouped([pair[0], *near]), effective)[:1] if near else []
        better = [p for c in first if (p := possible(half, base, c, effective)) is not None]
        if not better or better[0][0] is pair[0]:
            break
        pair = better[0]
    return pair


def already_there(half: Half) -> list[list[dict[str, Any]]]:
    """What is there before anything is planted: one after the other, the likeliest first, each as
    the records of its effects."""
    base, out, rows = left_open(half), list[Candidate](), half.gap.rows
    crosses: dict[int, np.ndarray] = {}
    while len(out) < MOST_THERE:
        keys = {c.key for c in out}
        some = (
            possible(half, base, c, rows)
            for c in ranked(half, base, half.library, rows, crosses)
            if c.key not in keys
        )
        each = list(itertools.islice((p for p in some if p is not None), FITTED))
        each = [refined(half, base, p, rows) for p in each]
        gains = [nats(base.with_(c.scaled(half)[0]), base) for c, _ in each]
        if not gains or max(gains) < ALREADY_THERE:
            break
        out.append(each[int(np.argmax(gains))][0])
        base = base.with_(out[-1].scaled(half)[0])
    return [[e.record([0.0] * len(e.coefficients)) for e in c.effects] for c in out]
