"""What can be known of an effect that was planted into a real log, by an oracle that knows it.

    python -m torchid_bench.benchmarks.planted_oracle DATA --work DIR [--logs panda,ur10e]
                                     [--effects coulomb_friction,...] [--sizes 2] [--again]

DIR is the work folder of `gap_planted.py`. No diagnosis can be asked to name an effect whose torque
another one makes as well. So the true effect, at its place and with its true shape, is fitted beside
all that the model leaves open: its base parameters and its own effects, as far as they are not known,
and what was there before anything was planted. What counts is the evidence (`planted_evidence.py`),
in nats, over nothing and over the best rival. Truth over a rival is the better of truth alone and of
both, over the rival alone: what a rival explains beside the truth speaks for neither.

    below        less than 1 % of the joint's torque on every joint, while it acts
    undecidable  5 nats over nothing, or less
    ambiguous    more, but 3 nats or less over the best rival
    decidable    more than that

Answers are frozen: `planted_oracle.json` is written once, and a case that is there is not computed
again. So nothing here is taken from the diagnosis, torchid.gap.
"""

import itertools
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from torchid.effects.base import JointEffect
from torchid.effects.registry import KINDS, effect_from_record
from torchid.log.model import Log
from torchid.robot.library import load_robot
from torchid_bench.benchmarks.planted_cases import SOURCES, Case, cases, halves
from torchid_bench.benchmarks.planted_evidence import (
    Terms,
    comparable,
    held_out,
    independent,
    nats,
)
from torchid_bench.benchmarks.planted_library import (
    Candidate,
    Half,
    candidate,
    half_of,
    left_open,
    library,
    restored,
    shaped,
)
from torchid_bench.benchmarks.runner import command

STORED = Path(__file__).with_suffix(".json")

OVER_NOTHING, OVER_RIVAL = 5.0, 3.0
"""Nats above which the truth is told from nothing, and from its best rival."""


ALREADY_THERE = 10.0
"""Nats over nothing above which something was there before anything was planted: the logarithm of a
thousand effects, places and shapes that are looked at, and three more."""

MOST_THERE = 10
"""Of such causes at most."""

RANKED, FITTED, REFINED = 30, 8, 4
"""Rivals that are fitted, those of them that are compared with the truth on samples of the pair's own,
and those whose shapes are refined."""


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
    half: Half, base: Terms, pair: tuple[Candidate, np.ndarray], effective: np.ndarray
) -> tuple[Candidate, np.ndarray]:
    """The likeliest of a candidate's shapes."""
    for level in range(2):
        near = finer(half, *pair, level)
        first = ranked(half, base, [pair[0], *near], effective)[:1] if near else []
        better = [p for c in first if (p := possible(half, base, c, effective)) is not None]
        if not better or better[0][0] is pair[0]:
            break
        pair = better[0]
    return pair


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
    """Class of a case whose torque is such a share of its joint's, so many nats over nothing and
    over the best rival."""
    # 0.01: share of a joint's torque below which no cause is worth a name
    if share < 0.01:
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


def main(
    data: Path,
    *,
    work: Path,
    logs: tuple[str, ...] = tuple(SOURCES),
    effects: tuple[str, ...] = tuple(KINDS),
    sizes: Sequence[float] = (2.0,),
    again: bool = False,
) -> None:
    """Classes of all cases that have none yet, or of all."""
    for label in logs:
        document, source, folder = stored(), SOURCES[label], work / label
        names = {c.name: f"{label}-{c.name}" for c in cases(folder, effects, sizes)}
        asked = [n for n, key in names.items() if again or key not in document["cases"]]
        if not asked:
            continue
        robot, second = load_robot(str(folder / "model.yaml")), halves(source, data)[2]
        half = half_of(robot, second, source.cutoff)
        known = Known(half, library(half))
        if again or label not in document["there"]:
            there = already_there(half, known.offered)
            document["there"][label] = [
                [e.record([0.0] * len(e.coefficients)) for e in c.effects] for c in there
            ]
        known = replace(known, there=document["there"][label])
        print(label, "there:", document["there"][label], flush=True)
        for case in (Case.read(folder / f"{name}.npz") for name in asked):
            started = time.process_time()
            row = classified(known, case, case.log(second), source.cutoff)
            # Written at once: a night's run may be interrupted.
            document["cases"][names[case.name]] = row
            keep(document)
            print(label, case.name, row, f"{time.process_time() - started:.1f} s", flush=True)


if __name__ == "__main__":
    command(main)
