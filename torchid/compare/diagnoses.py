"""Several gap diagnoses of one type of arm: which effects they share, and whether sizes agree."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import fields
from itertools import combinations
from typing import Any

import torch
from msgspec.structs import replace

from torchid.compare.basis import refuse_other_kinematics
from torchid.compare.reading import Compared
from torchid.compare.record import (
    ComparedCoefficient,
    GapComparison,
    Named,
    Shared,
    State,
)
from torchid.compare.scatter import holm, scatter
from torchid.compare.torque import common_motion, described_model, torque_spread
from torchid.effects.registry import KINDS
from torchid.gap.record import FoundEffect, GapRecord
from torchid.log.model import Log
from torchid.robot.model import Robot

BLOCKS = 20
"""Fewest blocks that a diagnosis takes its standard deviations from."""

ALPHA = 0.05


def compare_diagnoses(
    results: Sequence[Compared[GapRecord]], *, on: Log | None = None, seed: int = 0
) -> GapComparison:
    """Compare two or more gap diagnoses.

    Raises:
        TorchidError: diagnoses of other kinematics, or incomplete ones.
    """
    records = [r.record for r in results]
    entries = [[_named(entry) for entry in r.which] for r in records]
    # By effect and place that a diagnosis could not test.
    hidden = [
        {
            (e.effect, tuple(j + 1 for j in e.joints[:1])): e.smallest_detectable
            for e in r.not_testable
        }
        for r in records
    ]
    given = [r.model for r in records]
    refuse_other_kinematics([(r.label, r.record.model) for r in results])
    shared = [_shared(group, entries, hidden) for group in _groups(entries)]
    # Adjusted over all coefficients of all causes.
    p = torch.tensor([c.p for s in shared for c in s.coefficients], dtype=torch.float64)
    adjusted = iter(holm(p).tolist())
    shared = [
        replace(s, coefficients=tuple(replace(c, p_holm=next(adjusted)) for c in s.coefficients))
        for s in shared
    ]
    torque, notes = None, []
    corrected = (r.corrected for r in records)
    robots = [r for r in corrected if r is not None and r.parameters is not None]
    if len(robots) == len(results):
        cutoff = min(r.band_hz for r in records) if on is not None else None
        motion = common_motion(robots[0], on, seed, cutoff)
        torque = torque_spread([described_model(robot) for robot in robots], motion)
    else:
        notes.append(
            "no torque: a diagnosis did not record its corrected model; run torchid gap again"
        )
    if any(_other_model(given[0], g) for g in given[1:]):
        notes.append(
            "the simulators as given have different parameters or effects: what is an effect of "
            "one gap may be part of the other's model"
        )
    if len({r.settings.effects for r in records}) > 1:
        notes.append("the diagnoses searched over different effects")
    return GapComparison(
        labels=tuple(r.label for r in results),
        robot=" and ".join(dict.fromkeys(r.robot for r in records)),
        statuses=tuple(r.status for r in records),
        closed=tuple(r.how_far.closed for r in records),
        shared=tuple(sorted(shared, key=lambda s: -sum(n is not None for n in s.named))),
        torque=torque,
        notes=tuple(notes),
    )


def _named(entry: FoundEffect) -> Named:
    name, kind = entry.effect, KINDS.get(entry.effect)
    located = kind is None or name == "link_inertia" or "joint" in {f.name for f in fields(kind)}
    numbers = {k: float(v) for k, v in entry.parameters.items() if isinstance(v, int | float)}
    at = [j + 1 for j in entry.joints] + [int(numbers[p]) for p in entry.places if p in numbers]
    return Named(
        name,
        entry.family,
        () if entry.common or not located else tuple(at),
        entry.ambiguous_with,
        {k: numbers[k] for k in entry.std if k in numbers},
        {k: v for k, v in entry.std.items() if v is not None},
        {k: numbers[k] for k in entry.shape if k in numbers},
        entry.unit,
        entry.share,
    )


Member = tuple[int, int]  # number of a diagnosis, and of its entry


def _groups(entries: Sequence[Sequence[Named]]) -> list[list[Member]]:
    """Entries of different diagnoses that are one cause; at most one of each diagnosis, the best
    matches first."""
    members = [(k, i) for k, own in enumerate(entries) for i in range(len(own))]
    group = {member: {member} for member in members}

    # First those of one name, then those that cannot be told from each other.
    for alike in (True, False):
        for one, two in combinations(members, 2):
            a, b = (entries[k][i] for k, i in (one, two))
            both = group[one] | group[two]
            distinct = len({k for k, _ in both}) == len(both)
            if a.effect == b.effect:
                same = a.place == b.place
            else:
                same = a.place == b.place or not (a.place and b.place)
                same &= a.effect in b.also or b.effect in a.also
            if distinct and same and (a.effect == b.effect) == alike:
                group.update(dict.fromkeys(both, both))
    return [list(g) for g in dict.fromkeys(tuple(sorted(g)) for g in group.values())]


def _shared(
    group: Sequence[Member],
    entries: Sequence[Sequence[Named]],
    hidden: Sequence[Mapping[tuple[str, tuple[int, ...]], Any]],
) -> Shared:
    at = dict(group)
    named = [own[at[k]] if k in at else None for k, own in enumerate(entries)]
    present = [n for n in named if n is not None]
    effects = [name for name, _ in Counter(n.effect for n in present).most_common()]
    place = max((n.place for n in present), key=len)
    states: list[State] = []
    smallest: list[float | None] = []
    for n, own in zip(named, hidden, strict=True):
        unseen = [own[e, place] for e in effects if (e, place) in own]
        states.append("named" if n is not None else "not_testable" if unseen else "not_found")
        smallest.append(unseen[0] if n is None and unseen else None)
    alike = [n if n is not None and n.effect == effects[0] else None for n in named]
    first = next(n for n in alike if n is not None)
    coefficients = []
    for name in first.values:
        given = [
            (n.values[name], n.std[name]) if n is not None and name in n.std else None
            for n in alike
        ]
        known = [pair for pair in given if pair is not None]
        if len(known) < 2:
            continue
        x, s = torch.tensor(known, dtype=torch.float64).T
        found = scatter(x, s, torch.full_like(x, BLOCKS - 1))
        values, std = zip(*(pair or (None, None) for pair in given), strict=True)
        unit = first.units.get(name, "")
        coefficients.append(
            ComparedCoefficient.of(
                found, name=name, unit=unit, values=values, std=std, p_holm=found.p
            )
        )
    return Shared(
        effects=tuple(effects), place=place, everywhere=all(n is not None for n in named),
        states=tuple(states), named=tuple(named), smallest=tuple(smallest),
        coefficients=tuple(coefficients),
    )  # fmt: skip


def _other_model(one: Robot | None, two: Robot | None) -> bool:
    if one is None or two is None:
        return False
    if [dict(e) for e in one.effects] != [dict(e) for e in two.effects]:
        return True
    if one.parameters is None or two.parameters is None:
        return one.parameters is not two.parameters
    return not torch.allclose(one.parameters.pi, two.parameters.pi, rtol=1e-6)
