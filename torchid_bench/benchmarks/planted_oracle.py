"""What can be known of an effect that was planted into a real log, by an oracle that knows it.

    python -m torchid_bench.benchmarks.planted_oracle DATA --work DIR [--logs panda,ur10e]
                                     [--effects coulomb_friction,...] [--sizes 2] [--again]

DIR is the work folder of `gap_planted.py`. No diagnosis can be asked to name an effect whose torque
another one makes as well. So the true effect, at its place and with its true shape, is fitted beside
all that the model leaves open: its base parameters and its own effects, as far as they are not known,
and what was there before anything was planted. What counts is the evidence of a set S of terms
(MacKay 1992, Bayesian interpolation)

    E(S) = -1/2 sum_j n_j log L_j - 1/2 x'Px - 1/2 log|I + P^-1/2 G P^-1/2|

with L_j the squares that S leaves on joint j, x its coefficients, G = sum_j n_j/L_j X_j'X_j, and P the
inverse covariance of x beforehand: of the model's own what is known of it; of any other term a torque
hardly larger than the gap of each joint, and coefficients that are on some arm (g-priors: Zellner
1986). n_j are samples that tell two sets apart: rows over the correlation time of (what the better
one leaves) x (the difference of the two torques) (Bayley and Hammersley 1946), fewer where the noise
is louder where they differ (White 1980). Both sets of a comparison have the same. Nothing is paid
for having looked. Truth over a rival is the better of truth alone and of both, over the rival alone:
what a rival explains beside the truth speaks for neither.

    below        less than 1 % of the joint's torque on every joint, while it acts
    undecidable  5 nats over nothing, or less
    ambiguous    more, but 3 nats or less over the best rival
    decidable    more than that

Answers are frozen: `planted_oracle.json` is written once, and a case that is there is not computed
again. So nothing here is taken from the diagnosis, torchid.gap.
"""

import argparse
import itertools
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchid.design.bands import bands, position_noise, resolved, reversal_speed, sharp_direction
from torchid.design.columns import Columns, Model, Place
from torchid.design.motion import HARDLY, measurements, moves
from torchid.design.segments import EDGE, Samples, moving_samples, segments_of
from torchid.effects.base import Effect, JointEffect, ModelEffect
from torchid.effects.file_mistakes import FileMistake
from torchid.effects.friction import CoulombFriction, ViscousFriction
from torchid.effects.inertia import LinkInertia, Payload
from torchid.effects.registry import KINDS, effect_from_record
from torchid.identification.base_parameters import base_parameters
from torchid.identification.knowledge import known_later, known_names, whole_arm
from torchid.identification.logs import prepared
from torchid.log.model import Log
from torchid.log.sampling import at_rate
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.statistics.autocorrelation import autocorrelation, time_of
from torchid_bench.benchmarks.planted_cases import SOURCES, Case, Source, cases, halves

STORED = Path(__file__).with_suffix(".json")

OVER_NOTHING, OVER_RIVAL = 5.0, 3.0
"""Nats above which the truth is told from nothing, and from its best rival."""

BELOW = 0.01
"""Share of a joint's torque below which no cause is worth a name [1]."""

ALREADY_THERE = 10.0
"""Nats over nothing above which something was there before anything was planted: the logarithm of a
thousand effects, places and shapes that are looked at, and three more."""

MOST_THERE = 10
"""Of such causes at most."""

RANKED, FITTED, REFINED = 30, 8, 4
"""Rivals that are fitted, those of them that are compared with the truth on samples of the pair's own,
and those whose shapes are refined."""

TIMES_GAP = 2.0
"""Torque of a term beforehand, one standard deviation, over the gap of a joint [1]."""

BEYOND = 2.0
"""Standard deviations by which a rival's coefficient may be beyond what any arm has."""

DEPENDENT = 1e-9
"""Share of the largest variance below which a direction of columns is rounding [1]."""

FOLDS = 5
"""Stretches of a log that are held out, each in turn, where it has less than three trajectories."""


# Evidence.


@dataclass(frozen=True, eq=False)
class Gap:
    """What is to be explained.

    Attributes:
        y: (n, N) samples of measured torque less the model's, zero where none counts [N m; N].
        rows: (n,) samples that count.
        bounds: samples of each trajectory.
        fold: (N,) stretch that is held out together, from 0.
    """

    y: np.ndarray
    rows: np.ndarray
    bounds: tuple[slice, ...]
    fold: np.ndarray


@dataclass(frozen=True, eq=False)
class Fit:
    """Coefficients z (K,) in standard deviations, squares left (n,), E, covariance of z (K, K)."""

    z: np.ndarray
    losses: np.ndarray
    evidence: float
    covariance: np.ndarray


@dataclass(frozen=True, eq=False)
class Terms:
    """A set of terms.

    Attributes:
        gap: what they explain.
        columns: (K, n, N) torque per standard deviation of each coefficient [N m; N].
    """

    gap: Gap
    columns: np.ndarray

    @cached_property
    def grams(self) -> np.ndarray:
        """(F, n, K + 1, K + 1) products of columns and gap, fold by fold, joint by joint."""
        a = np.concatenate([self.columns, self.gap.y[None]]).transpose(1, 0, 2)
        parts = (a[..., self.gap.fold == k] for k in range(self.gap.fold.max() + 1))
        return np.stack([x @ x.transpose(0, 2, 1) for x in parts])

    def with_(self, more: np.ndarray) -> "Terms":
        """The same and more columns."""
        return Terms(self.gap, np.concatenate([self.columns, more]))

    def fit(self, effective: np.ndarray) -> Fit:
        """The maximum of E with so many samples (n,)."""
        return fit(self.grams.sum(0), effective)

    def left(self, of: Fit) -> np.ndarray:
        """(n, N) torque that a fit of them leaves."""
        return self.gap.y - np.tensordot(of.z, self.columns, 1)


def fit(gram: np.ndarray, effective: np.ndarray) -> Fit:
    """The maximum of -1/2 sum_j n_j log L_j(z) - 1/2 z'z over z, and its evidence.

    Args:
        gram: (n, K + 1, K + 1) products of K columns, in units of their standard deviations, and of
            the gap, joint by joint.
        effective: (n,) samples.
    """
    k = gram.shape[1] - 1
    floor = 1e-12 * gram[:, k, k] + 1e-300
    losses, eye = gram[:, k, k] + floor, np.eye(k)
    for _ in range(200):
        h = np.tensordot(effective / losses, gram, 1)
        inverse = np.linalg.inv(eye + h[:k, :k])
        z = inverse @ h[:k, k]
        v = np.append(-z, 1.0)
        before, losses = losses, np.maximum(np.einsum("a,nab,b->n", v, gram, v), floor)
        if np.abs(losses - before).max(where=effective > 0, initial=0.0) <= 0:
            break
        if (np.abs(losses / before - 1) < 1e-11)[effective > 0].all():
            break
    h = np.tensordot(effective / losses, gram, 1)[:k, :k]
    occam = np.linalg.slogdet(eye + h)[1]
    evidence = -0.5 * float((effective * np.log(losses)).sum() + z @ z + occam)
    return Fit(z, losses, evidence, np.linalg.inv(eye + h))


def telling(gap: Gap, left: np.ndarray, difference: np.ndarray | None = None) -> np.ndarray:
    """Samples (n,) that tell of a torque in such noise.

    Args:
        gap: with its trajectories.
        left: (n, N) noise.
        difference: (n, N) torque; a constant one if None, or where it is rounding.
    """
    slow = autocorrelation(torch.from_numpy(left), gap.bounds)
    times = time_of(slow).numpy()
    if difference is not None:
        along = autocorrelation(torch.from_numpy(difference), gap.bounds)
        a, b = difference**2, left**2
        product = np.maximum(a.sum(1) * b.sum(1), 1e-300)
        loud = np.maximum((a * b).sum(1) * gap.rows / product, 1.0)
        there = a.sum(1) > DEPENDENT**2 * b.sum(1)
        times = np.where(there, time_of(slow * along).numpy() * loud, times)
    return gap.rows / np.maximum(times, 1.0)


def comparable(one: Terms, other: Terms) -> np.ndarray:
    """Samples (n,) with which both are fitted: those that tell one from the other."""
    effective = one.gap.rows
    for _ in range(2):
        fits = [s.fit(effective) for s in (one, other)]
        left = [s.left(f) for s, f in zip((one, other), fits, strict=True)]
        losses = [float((effective * np.log(f.losses)).sum()) for f in fits]
        effective = telling(one.gap, left[int(losses[1] < losses[0])], left[1] - left[0])
    return effective


def nats(one: Terms, other: Terms) -> float:
    """Evidence of one set over another, with the same samples."""
    effective = comparable(one, other)
    return one.fit(effective).evidence - other.fit(effective).evidence


def held_out(one: Terms, other: Terms) -> float:
    """1/2 sum_j n_j log(L_j(other) / L_j(one)) of squares that both leave on the folds that they are
    not fitted on, fold by fold."""
    effective, losses = comparable(one, other), []
    for terms in (one, other):
        whole, total = terms.grams.sum(0), np.zeros(len(effective))
        for out in terms.grams:
            v = np.append(-fit(whole - out, effective * (1 - 1 / len(terms.grams))).z, 1.0)
            total += np.einsum("a,nab,b->n", v, out, v)
        losses.append(np.maximum(total, 1e-300))
    return 0.5 * float((effective * np.log(losses[1] / losses[0])).sum())


def independent(precision: np.ndarray) -> np.ndarray:
    """T (C, K) with T' precision T = 1: coefficients x = T z of independent standard deviations z;
    without the directions of which the precision (C, C) is rounding."""
    size = np.sqrt(np.maximum(precision.diagonal(), 0))
    if not size.any():
        return np.zeros((len(size), 0))
    unit = np.where(size > 0, 1 / np.where(size > 0, size, 1.0), 0.0)
    values, axes = np.linalg.eigh(precision * unit * unit[:, None])
    there = values > DEPENDENT * values[-1]
    return unit[:, None] * axes[:, there] / np.sqrt(values[there])


# The second half of a log, and what may be there.


@dataclass(frozen=True, eq=False)
class Half:
    """The second half of a log.

    Attributes:
        columns: of the model as the first half makes it.
        keep: (n, N) samples in which the joint moves.
        torque: (n,) measured, RMS over these [N m; N].
        gap: to be explained.
        wide: band of the segments [Hz].
    """

    columns: Columns
    keep: np.ndarray
    torque: np.ndarray
    gap: Gap
    wide: float

    @property
    def robot(self) -> Robot:
        return self.columns.model.robot

    @cached_property
    def size(self) -> np.ndarray:
        """(n,) RMS of the gap [N m; N]."""
        return self.rms(self.gap.y) + 1e-4 * self.torque

    def rms(self, x: np.ndarray) -> np.ndarray:
        """(n,) of samples (n, N), over those that count."""
        return np.sqrt((x**2 * self.keep).sum(1) / np.maximum(self.gap.rows, 1.0))


def half_of(robot: Robot, log: Log, cutoff: float | None, like: Half | None = None) -> Half:
    """A log as samples in a band, that of another half of the same motion if there is one."""
    robot = whole_arm(robot)
    even, _ = prepared(log, robot, standing=True, force=True)
    even = at_rate(even, min(even.rates))
    if like is None:
        highest = resolved(even, position_noise(even, robot), robot.free)
        narrow, wide = bands(even, cutoff, highest)
    else:
        narrow, wide = like.columns.samples.cutoff, like.wide
    measured = measurements(even, wide)
    threshold = reversal_speed(measured)
    segments = [
        replace(s, motion=s.motion._replace(direction=sharp_direction(s, threshold)))
        for s in segments_of(measured, wide)
        if s.length > 4 * EDGE * s.rate / narrow
    ]
    samples = Samples(segments, narrow)
    columns, keep = Columns(Model.of(robot), samples), moving_samples(samples).numpy()
    tau = samples.of([s.tau.T for s in segments]).numpy()
    rows = keep.sum(1).astype(float)
    parts = [np.arange(b.stop - b.start) * FOLDS // (b.stop - b.start) for b in samples.bounds]
    if len(parts) >= 3:
        parts = [np.full(len(p), k) for k, p in enumerate(parts)]
    gap = Gap(columns.gap.numpy() * keep, rows, samples.bounds, np.concatenate(parts))
    torque = np.sqrt((tau**2 * keep).sum(1) / np.maximum(rows, 1.0))
    return Half(columns, keep, torque, gap, wide)


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect at a place, or several with coefficients of their own or in common.

    Attributes:
        name, joints: where they are located, from 0; none of the whole arm.
        effects: one; all joints'; the two of a joint's friction.
        felt: joints whose torque the columns are in: one, or all.
        columns: (C, m, N) per unit coefficient, on these m joints.
        low, high: (C,) least and largest correction of what the model has.
    """

    name: str
    joints: tuple[int, ...]
    effects: tuple[Effect, ...]
    felt: tuple[int, ...]
    columns: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @property
    def key(self) -> tuple[object, ...]:
        """Effect and place, whatever the shape."""
        return self.name, *(e.identity for e in self.effects)

    def is_of(self, key: dict[str, Any]) -> bool:
        """Whether this was planted, or is a part of it."""
        places = {*key["joints"], *key["felt_by"]}
        near = not self.joints or not places or bool(places & set(self.joints))
        return near and key["effect"] in [e.name for e in self.effects]

    def written(self) -> list[Any]:
        """As in the file: name and joints, from 1."""
        return [self.name, [j + 1 for j in self.joints]]

    def forbids(self, value: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """Which of its coefficients (C,) are, with this covariance (C, C), none of any arm."""
        std = BEYOND * np.sqrt(covariance.diagonal())
        return (value < self.low - std) | (value > self.high + std)

    def precision(self, half: Half, products: np.ndarray | None = None) -> np.ndarray:
        """(C, C) of its coefficients beforehand, see `TIMES_GAP`; `products` (m, C, C) of its
        columns with each other, joint by joint, where they are known."""
        if products is None:
            x = self.columns.transpose(1, 0, 2)
            products = x @ x.transpose(0, 2, 1)
        felt = list(self.felt)
        size = np.maximum(half.gap.rows[felt], 1.0) * (TIMES_GAP * half.size[felt]) ** 2
        most = np.maximum(np.abs(self.low), np.abs(self.high)) / 2
        return np.tensordot(1 / size, products, 1) + np.diag(np.maximum(most, 1e-300) ** -2.0)

    def scaled(self, half: Half) -> tuple[np.ndarray, np.ndarray]:
        """Columns (K, n, N) on all joints per standard deviation, and T (C, K)."""
        into = independent(self.precision(half))
        out = np.zeros((into.shape[1], len(half.size), self.columns.shape[-1]))
        out[:, list(self.felt)] = np.tensordot(into.T, self.columns, 1)
        return out, into


def candidate(half: Half, effects: Sequence[Effect], *, common: bool = False) -> Candidate:
    """Effects with their columns; `common` where they share their coefficients."""
    columns, robot = half.columns, half.robot
    every: list[tuple[Place, torch.Tensor]] = [
        (None, columns.regressor[e.link(robot)])
        if isinstance(e, Payload | LinkInertia)
        else columns.of(e)
        for e in effects
    ]
    places = {place for place, _ in every}
    felt = tuple(p for p in places if p is not None)
    if len(places) > 1 or None in places:
        felt = tuple(range(robot.n))
    parts = []
    for place, own in every:
        on = np.zeros((len(own), len(felt), own.shape[-1]))
        on[:, slice(None) if place is None else felt.index(place)] = own.numpy()
        parts.append(on)
    has = dict(columns.model.effects)
    known = [np.array(has.get(e, [0.0] * len(e.coefficients))) for e in effects]
    limits = [np.array(e.ranges).T - v for e, v in zip(effects, known, strict=True)]
    low, high = limits[0] if common else np.concatenate(limits, 1)
    x = np.sum(parts, axis=0) if common else np.concatenate(parts)
    names = dict.fromkeys(e.name for e in effects)
    joints = () if common else effects[0].joints
    return Candidate(
        " + ".join(names), joints, tuple(effects), felt, x * half.keep[list(felt)], low, high
    )


def shaped(
    half: Half, kind: type[JointEffect], joint: int, shapes: torch.Tensor
) -> list[Candidate]:
    """An effect on a joint with each of some shapes (S, P)."""
    names = [s.name for s in kind.shapes]
    every = (dict(zip(names, v, strict=True)) for v in shapes.tolist())
    return [candidate(half, [kind(joint, **given)]) for given in every]


def restored(half: Half, records: Sequence[dict[str, Any]]) -> Candidate:
    """What was there already, as the file has it."""
    effects = [effect_from_record(r, half.robot)[0] for r in records]
    alike = len({e.name for e in effects}) == 1
    return candidate(half, effects, common=alike and len(effects) > 1)


def library(half: Half) -> list[Candidate]:
    """All effects at all places with the shapes that a search begins with, where the log shows
    them. Not what needs a window that must be found; nor what needs the links' own parameters, for
    the model has base parameters alone."""
    columns, robot, samples = half.columns, half.robot, half.columns.samples
    own = all(s.own_velocity for s in samples.segments)
    missing = {"age"} if own else {"age", "velocity"}
    sliding = torch.cat([moves(s.motion, s.moving) for s in samples.segments]).double().mean(0)
    out = []
    for kind in KINDS.values():
        skipped = kind.windowed or kind.of_bodies or issubclass(kind, FileMistake)
        if skipped or kind.needs & missing:
            continue
        if issubclass(kind, JointEffect):
            slides = kind.jumps or kind.family in ("speed", "time")
            for j in (j for j in robot.driven if sliding[j] >= HARDLY or not slides):
                out += shaped(half, kind, j, kind.grid(columns.motions, j, samples.cutoff))
        else:
            assert issubclass(kind, ModelEffect)
            out += [candidate(half, [e]) for e in kind.starts(robot)]
            if kind.shared:
                out.append(candidate(half, kind.candidates(robot), common=True))
    laws = (ViscousFriction, CoulombFriction)
    out += [candidate(half, [law(j) for law in laws]) for j in robot.driven]
    return [c for c in out if c.columns.any()]


def left_open(half: Half) -> Terms:
    """Base parameters and effects of the model, as far as they are not known: within what is known
    of them, and a torque as large as the joint's."""
    robot, columns = half.robot, half.columns
    base = base_parameters(robot, basis="report").by_link
    known = known_later(robot)
    own = [e for e, _ in columns.model.effects if not e.event]
    if known is not None:
        own = [e for e in own if set(known_names(e)) <= set(known.coefficients)]
    x = [columns.regressor.flatten(0, 1)[base], *(columns.on_all_joints(e) for e in own)]
    raw = torch.cat(x).numpy() * half.keep
    flat = raw.transpose(1, 0, 2)
    size = np.maximum(half.gap.rows * half.torque**2, 1e-300)
    precision = np.tensordot(1 / size, flat @ flat.transpose(0, 2, 1), 1)
    if known is not None:
        asked = known.over([name for e in own for name in known_names(e)])
        rows = [*base, *range(asked.rigid, asked.root.shape[1])]
        precision = precision + asked.information[rows][:, rows].numpy()
    return Terms(half.gap, np.tensordot(independent(precision).T, raw, 1))


def ranked(
    half: Half, base: Terms, offered: Sequence[Candidate], effective: np.ndarray
) -> list[Candidate]:
    """Candidates by the rise of the evidence to first order, the best shape of each alone; none
    whose one coefficient would be one that no arm has."""
    of = base.fit(effective)
    weight, left, best = effective / of.losses, base.left(of), dict[object, Any]()
    for felt, group in itertools.groupby(sorted(offered, key=lambda c: c.felt), lambda c: c.felt):
        some, on = list(group), list(felt)
        x = np.concatenate([c.columns for c in some]).transpose(1, 0, 2)
        products, w = x @ x.transpose(0, 2, 1), weight[on]
        a = base.columns[:, on].transpose(1, 0, 2)
        u = np.tensordot(w, a @ x.transpose(0, 2, 1), 1)
        right = np.einsum("m,mcN,mN->c", w, x, left[on])
        whole = np.tensordot(w, products, 1) - u.T @ of.covariance @ u
        first = 0
        for c in some:
            own = slice(first, first := first + len(c.columns))
            into = independent(c.precision(half, products[:, own, own]))
            h = np.eye(into.shape[1]) + into.T @ whole[own, own] @ into
            b = into.T @ right[own]
            inverse = np.linalg.inv(h)
            rise = 0.5 * (b @ inverse @ b - np.linalg.slogdet(h)[1])
            value, covariance = into @ inverse @ b, into @ inverse @ into.T
            if len(value) == 1 and c.forbids(value, covariance).all():
                continue
            if c.key not in best or rise > best[c.key][0]:
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
        first = len(base.columns)
        value = into @ of.z[first:]
        wrong = c.forbids(value, into @ of.covariance[first:, first:] @ into.T)
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
    half: Half, base: Terms, found: tuple[Candidate, np.ndarray], effective: np.ndarray
) -> tuple[Candidate, np.ndarray]:
    """The likeliest of a candidate's shapes."""
    for level in range(2):
        near = finer(half, *found, level)
        first = ranked(half, base, [found[0], *near], effective)[:1] if near else []
        better = [p for c in first if (p := possible(half, base, c, effective)) is not None]
        if not better or better[0][0] is found[0]:
            break
        found = better[0]
    return found


def already_there(half: Half, offered: Sequence[Candidate]) -> list[Candidate]:
    """What is there before anything is planted: one after the other, the likeliest first."""
    base, out = left_open(half), list[Candidate]()
    while len(out) < MOST_THERE:
        keys = {c.key for c in out}
        rest = [c for c in offered if c.key not in keys]
        some = (
            possible(half, base, c, half.gap.rows) for c in ranked(half, base, rest, half.gap.rows)
        )
        each = list(itertools.islice((p for p in some if p is not None), FITTED))
        each = [refined(half, base, p, half.gap.rows) for p in each]
        gains = [nats(base.with_(c.scaled(half)[0]), base) for c, _ in each]
        if not gains or max(gains) < ALREADY_THERE:
            break
        out.append(each[int(np.argmax(gains))][0])
        base = base.with_(out[-1].scaled(half)[0])
    return out


# Classes.


@dataclass(frozen=True, eq=False)
class Known:
    """What all cases of a log have in common: its half as it is, its library, and what is there."""

    half: Half
    offered: list[Candidate]
    there: list[list[dict[str, Any]]] = field(default_factory=list)


def classified(known: Known, case: Case, log: Log, cutoff: float | None) -> dict[str, Any]:
    """The class of a case, and the numbers that it is made of."""
    key, robot = case.key, known.half.robot
    half = half_of(robot, log, cutoff, known.half)
    moved = case.dq is not None
    offered = library(half) if moved else known.offered
    # How large it is on each joint, while it acts.
    torque = (half.gap.y - known.half.gap.y) * half.keep
    acts = np.abs(torque) > 0.01 * np.abs(torque).max(1, keepdims=True)
    mean = (torque**2).sum(1) / np.maximum((acts & half.keep).sum(1), 1)
    share = float((np.sqrt(mean) / np.maximum(half.torque, 1e-300)).max())
    # The truth beside what is there already.
    effect, values = effect_from_record(key["record"], robot)
    truth = candidate(half, [effect.at_estimate(values)])
    base = left_open(half)
    there = [restored(half, records) for records in known.there]
    for c in (c for c in there if not c.is_of(key)):
        base = base.with_(c.scaled(half)[0])
    true = base.with_(truth.scaled(half)[0])
    nothing = nats(true, base)
    effective = comparable(true, base)
    # Rivals, the likeliest first; those of the same torque beside the truth add nothing.
    rest = [c for c in offered if not c.is_of(key)]
    some = (possible(half, base, c, effective) for c in ranked(half, base, rest, effective))
    found = list(itertools.islice((p for p in some if p is not None), RANKED))
    alone = true.fit(effective).evidence

    def instead(c: Candidate) -> float:
        x = c.scaled(half)[0]
        both = true.with_(x).fit(effective).evidence
        return base.with_(x).fit(effective).evidence - max(alone, both)

    found = sorted(found, key=lambda p: -instead(p[0]))[:FITTED]
    found += [refined(half, base, p, effective) for p in found[:REFINED]]
    rivals: dict[object, tuple[float, Candidate, Terms]] = {}
    for c, _ in found:
        x = c.scaled(half)[0]
        rival = base.with_(x)
        over = max(nats(true, rival), nats(true.with_(x), rival))
        if c.key not in rivals or over < rivals[c.key][0]:
            rivals[c.key] = over, c, rival
    each = sorted(rivals.values(), key=lambda r: r[0])
    over = each[0][0] if each else np.inf
    out = {
        "class": class_of(share, nothing, over),
        "planted": key["record"],
        "size": round(key["size"], 3),
        "share_of_torque": round(share, 4),
        "over_nothing": round(nothing, 2),
    }
    if not effect.event:  # which no other stretch foretells
        out["over_nothing_held_out"] = round(held_out(true, base), 2)
    if each:
        near = [r for r in each if r[0] <= OVER_RIVAL] or each[:1]
        out["over_rival"] = round(over, 2)
        if not effect.event:
            out["over_rival_held_out"] = round(held_out(true, each[0][2]), 2)
        out["rivals"] = [[*c.written(), round(x, 2)] for x, c, _ in near]
    return out


def class_of(share: float, nothing: float, rival: float) -> str:
    """Of a case whose torque is such a share of its joint's, so many nats over nothing and over the
    best rival."""
    if share < BELOW:
        return "below"
    if nothing <= OVER_NOTHING:
        return "undecidable"
    return "ambiguous" if rival <= OVER_RIVAL else "decidable"


def stored() -> dict[str, Any]:
    """What the file has: `there`, by log; `cases`, by log, effect and size."""
    return json.loads(STORED.read_text()) if STORED.exists() else {"there": {}, "cases": {}}


def keep(document: dict[str, Any]) -> None:
    """Write the file, a line a case."""
    parts = []
    for name, entries in document.items():
        lines = (f"{json.dumps(k)}: {json.dumps(v)}" for k, v in sorted(entries.items()))
        parts.append(f"{json.dumps(name)}: {{\n" + ",\n".join(lines) + "\n}")
    STORED.write_text("{\n" + ",\n".join(parts) + "\n}\n")


def run(label: str, source: Source, args: argparse.Namespace) -> None:
    """Classes of all cases of a log that have none yet."""
    document, folder = stored(), args.work / label
    names = {c.name: f"{label}-{c.name}" for c in cases(folder, args.effects, args.sizes)}
    asked = [n for n, key in names.items() if args.again or key not in document["cases"]]
    if not asked:
        return
    robot, second = load_robot(str(folder / "model.yaml")), halves(source, args.data)[2]
    half = half_of(robot, second, source.cutoff)
    known = Known(half, library(half))
    if args.again or label not in document["there"]:
        there = already_there(half, known.offered)
        document["there"][label] = [
            [e.record([0.0] * len(e.coefficients)) for e in c.effects] for c in there
        ]
    known = replace(known, there=document["there"][label])
    print(label, "there:", document["there"][label], flush=True)
    for case in (Case.read(folder / f"{name}.npz") for name in asked):
        started = time.process_time()
        found = classified(known, case, case.log(second), source.cutoff)
        # Written at once: a night's run may be interrupted.
        document["cases"][names[case.name]] = found
        keep(document)
        print(label, case.name, found, f"{time.process_time() - started:.1f} s", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--logs", type=lambda s: s.split(","), default=list(SOURCES))
    parser.add_argument("--effects", type=lambda s: s.split(","), default=list(KINDS))
    parser.add_argument("--sizes", type=float, nargs="+", default=[2.0])
    parser.add_argument("--again", action="store_true", help="compute what is stored, too")
    args = parser.parse_args()
    torch.set_num_threads(1)
    for label in args.logs:
        run(label, SOURCES[label], args)


if __name__ == "__main__":
    main()
