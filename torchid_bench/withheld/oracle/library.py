"""What may be in a log: its gap, effects at their places, what is left open.

Beforehand no term has a torque much larger than the gap of any joint, nor a coefficient that is on
no arm (g-priors: Zellner 1986); the model's own are as far from its values as is known of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
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
from torchid.robot.model import Robot
from torchid_bench.withheld.oracle.evidence import Gap, Terms, independent

TIMES_GAP = 2.0
"""Torque of a term beforehand, one standard deviation, over the gap of a joint [1]."""


@dataclass(frozen=True, eq=False)
class Half:
    """A log, or a part of one, as samples.

    Attributes:
        columns: of the model.
        keep: (n, N) samples in which the joint moves.
        torque: (n,) measured, RMS over these [N m; N].
        gap: to be explained.
        alike: another one of the same model and motion, which has the same library; None if none.
    """

    columns: Columns
    keep: np.ndarray
    torque: np.ndarray
    gap: Gap
    alike: "Half | None" = None

    @property
    def robot(self) -> Robot:
        """The arm."""
        return self.columns.model.robot

    @cached_property
    def size(self) -> np.ndarray:
        """(n,) RMS of the gap, over samples that count [N m; N]."""
        mean = (self.gap.y**2).sum(1) / np.maximum(self.gap.rows, 1.0)
        return np.sqrt(mean) + 1e-4 * self.torque

    @cached_property
    def library(self) -> "list[Group]":
        """All that may be in it."""
        return grouped(library(self)) if self.alike is None else self.alike.library

    def explaining(self, y: np.ndarray) -> "Half":
        """The same where another torque (n, N) is to be explained [N m; N]."""
        alike = self.alike or self
        return replace(self, gap=replace(self.gap, y=y * self.keep), alike=alike)


def half_of(robot: Robot, log: Log, cutoff: float | None = None, like: Half | None = None) -> Half:
    """A log as samples in a band, that of another one of the same motion if there is one.

    Args:
        robot: the arm as its file has it.
        log: with torques.
        cutoff: of the band [Hz]; the default's if None.
        like: the other one.
    """
    even, _ = prepared(log, robot, standing=True, force=True)
    even = at_rate(even, min(even.rates))
    if like is None:
        highest = resolved(even, position_noise(even, robot), robot.free)
        narrow, wide = bands(even, cutoff, highest)
    else:
        narrow, wide = like.columns.samples.cutoff, like.columns.samples.segments[0].band
    measured = measurements(even, wide)
    threshold = reversal_speed(measured)
    segments = [
        replace(s, motion=s.motion._replace(direction=sharp_direction(s, threshold)))
        for s in segments_of(measured, wide)
        if s.length > 4 * EDGE * s.rate / narrow
    ]
    samples = Samples(segments, narrow)
    columns, keep = Columns(Model.of(whole_arm(robot)), samples), moving_samples(samples).numpy()
    tau = samples.of([s.tau.T for s in segments]).numpy()
    rows = keep.sum(1).astype(float)
    gap = Gap(columns.gap.numpy() * keep, rows, samples.bounds)
    torque = np.sqrt((tau**2 * keep).sum(1) / np.maximum(rows, 1.0))
    same = like is not None and same_columns(columns, like.columns)
    return Half(columns, keep, torque, gap, like if same else None)


def same_columns(one: Columns, other: Columns) -> bool:
    """Whether two have the same model and motion, so that effects have the same columns in both."""
    signals = [[x for m in c.motions for x in m if x is not None] for c in (one, other)]
    return len(signals[0]) == len(signals[1]) and all(map(torch.equal, *signals))


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

    @cached_property
    def key(self) -> tuple[object, ...]:
        """Effect and place, whatever the shape."""
        return self.name, *(e.identity for e in self.effects)

    def forbids(self, value: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """Which of its coefficients (C,) are, with this covariance (C, C), none of any arm."""
        # 2.0: standard deviations by which a rival's coefficient may be beyond what any arm has
        std = 2.0 * np.sqrt(covariance.diagonal())
        return (value < self.low - std) | (value > self.high + std)

    @cached_property
    def products(self) -> np.ndarray:
        """(m, C, C) of its columns with each other, joint by joint."""
        x = self.columns.transpose(1, 0, 2)
        return x @ x.transpose(0, 2, 1)

    def scaled(self, half: Half) -> tuple[np.ndarray, np.ndarray]:
        """Columns (K, n, N) on all joints per standard deviation, and T (C, K)."""
        into = independent(precisions(half, [self], self.products[None])[0])
        into = into[:, into.any(0)]
        out = np.zeros((into.shape[1], len(half.size), self.columns.shape[-1]))
        out[:, list(self.felt)] = np.tensordot(into.T, self.columns, 1)
        return out, into


def precisions(half: Half, some: Sequence[Candidate], products: np.ndarray) -> np.ndarray:
    """(S, C, C) of the coefficients of a group beforehand, see `TIMES_GAP`; `products` (S, m, C, C)
    of its candidates' columns."""
    felt = list(some[0].felt)
    size = np.maximum(half.gap.rows[felt], 1.0) * (TIMES_GAP * half.size[felt]) ** 2
    most = np.stack([np.maximum(np.abs(c.low), np.abs(c.high)) / 2 for c in some])
    least = np.maximum(most, 1e-300)[..., None] ** -2.0 * np.eye(most.shape[1])
    return np.einsum("m,smcd->scd", 1 / size, products) + least


Group = tuple[list[Candidate], np.ndarray]
"""Candidates with equally many coefficients, S of them, that the same m joints feel; and their
columns (m, S C, N)."""


def grouped(candidates: Sequence[Candidate]) -> list[Group]:
    """All candidates, in groups."""
    groups: dict[object, list[Candidate]] = {}
    for c in candidates:
        groups.setdefault((c.felt, len(c.columns)), []).append(c)
    return [
        (some, np.concatenate([c.columns for c in some]).transpose(1, 0, 2).copy())
        for some in groups.values()
    ]


Felt = tuple[Place, torch.Tensor]
"""Columns of an effect: (C, N) on one joint, or (C, n, N) on all."""


def candidate(
    half: Half, effects: Sequence[Effect], *, common: bool = False, every: Sequence[Felt] = ()
) -> Candidate:
    """Effects with their columns; `common` where they share their coefficients; `every` is what
    they are, where they are known."""
    columns, robot = half.columns, half.robot
    every = every or [
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
    each = (dict(zip(names, v, strict=True)) for v in shapes.tolist())
    x = half.columns.of_shapes(kind, joint, shapes) if len(shapes) else ()
    every = [[(joint, own)] for own in x]
    return [
        candidate(half, [kind(joint, **given)], every=own)
        for given, own in zip(each, every, strict=True)
    ]


def restored(half: Half, records: Sequence[Mapping[str, Any]]) -> Candidate:
    """What was there already, from its records."""
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
            starts: list[Any] = [*kind.starts(robot)]
            body = issubclass(kind, Payload | LinkInertia)
            known = [[x] for x in columns.of_several(starts)] if not body else [()] * len(starts)
            out += [candidate(half, [e], every=x) for e, x in zip(starts, known, strict=True)]
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
    into = independent(precision)
    return Terms.of(half.gap, np.tensordot(into[:, into.any(0)].T, raw, 1))
