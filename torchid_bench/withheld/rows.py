"""What was planted and what was said, as they are in files.

A claim is an effect that was named, or inertial parameters that were said to be wrong; the top
claim is the one with the largest share of the gap. Joints are 1-based, as in files.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from torchid.effects.base import Effect, JointEffect
from torchid.effects.registry import FAMILIES, KINDS
from torchid.effects.variation import OneJointEffect
from torchid.position.effects import EFFECTS
from torchid.statistics.proportion import HALF_95

INERTIAL = ("link_inertia", "all_base")
"""Names of claims that a model's own parameters are wrong."""

IN_BOTH = "in both"
"""Of a cause that the model lacked already on an earlier log."""

POSITION_SCHEMA = "torchid.position_gap/1"

SURE = ("explained", "parametric_only")
"""Statuses of a diagnosis that says it knows the cause."""


@dataclass(frozen=True)
class Claim:
    """A cause that was named.

    Attributes:
        name, family: of the effect.
        place: joints that it is at; empty for the whole arm.
        joints: whose torque it changes.
        ambiguous: names that the data do not tell it from.
        share: of the gap.
        coefficients: name -> (value, standard deviation), of effects without a shape.
        how_sure: probability that was given to the set; None where none was.
        own: to the name itself; None where none was.
        new: whether it is said to be new, where there is an earlier log.
    """

    name: str
    family: str
    place: tuple[int, ...]
    joints: tuple[int, ...]
    ambiguous: tuple[str, ...] = ()
    share: float = 0.0
    coefficients: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    how_sure: float | None = None
    own: float | None = None
    new: bool = True

    @property
    def names(self) -> set[str]:
        """The name, and those that it may be instead."""
        return {self.name, *self.ambiguous}

    def near(self, planted: "Planted") -> bool:
        """Whether they have a joint in common, or one of them is on the whole arm."""
        here, there = set(planted.place), set(self.place)
        return not here or not there or bool(here & there)

    @property
    def structural(self) -> bool:
        """Whether it says more than that inertial parameters are wrong."""
        return not self.names & set(INERTIAL)


@dataclass(frozen=True)
class Planted:
    """A cause that is there.

    Attributes:
        name, family: of the effect; a family `outside` is not in the library.
        place: joints that it is at; empty for the whole arm.
        felt: whose torque it changes beyond noise.
        size: in standard deviations of the torque noise.
        acceptable: names and families that an honest answer may give it as well.
        coefficients: true values.
    """

    name: str
    family: str
    place: tuple[int, ...]
    felt: tuple[int, ...]
    size: float = math.nan
    acceptable: tuple[str, ...] = ()
    coefficients: Mapping[str, float] = field(default_factory=dict)

    @property
    def located(self) -> tuple[int, ...]:
        """Joints that a diagnosis should point at."""
        return self.place or self.felt

    def allows(self, name: str, family: str | None) -> bool:
        """Whether a name is right for it, at least by family."""
        own = () if self.family == "outside" else (self.family,)
        allowed = {self.name, *self.acceptable, *own}
        return name in allowed or family in allowed


@dataclass(frozen=True)
class Row:
    """One case: what was planted and what was said.

    Attributes:
        status: of the diagnosis, or `error`.
        planted: causes that are there.
        claims: causes that were named, new ones first, the largest share first.
        not_testable: (name, joint or None) of effects said to be invisible in these data.
        families: of every effect that the diagnosis can name.
    """

    status: str
    planted: tuple[Planted, ...]
    claims: tuple[Claim, ...]
    not_testable: tuple[tuple[str, int | None], ...] = ()
    families: Mapping[str, str] = field(default_factory=lambda: FAMILIES, repr=False)

    @property
    def top(self) -> Claim | None:
        """The first claim."""
        return self.claims[0] if self.claims else None

    @property
    def alarm(self) -> bool:
        """Whether it says that something is there."""
        return bool(self.claims) or self.status in (*SURE, "detected_unexplained")


def named_record(row: Row) -> list[dict[str, Any]]:
    """What was named, as plain data."""
    return [
        {"name": c.name, "joints": c.place or c.joints, "ambiguous_with": c.ambiguous}
        for c in row.claims
    ]


def row_of(key: Mapping[str, Any], answer: Mapping[str, Any]) -> Row:
    """A case from its key and its answer, as they are in files."""
    servos = answer.get("schema") == POSITION_SCHEMA
    claims = _servo_claims(answer) if servos else _torque_claims(answer)
    return Row(
        str(answer["status"]),
        tuple(map(_planted, key["effects"])),
        tuple(sorted(claims, key=lambda c: (not c.new, -c.share))),
        tuple((x["effect"], x["joint"]) for x in answer.get("not_testable", ()) if not servos),
        {effect.name: effect.family for effect in EFFECTS} if servos else FAMILIES,
    )


def _torque_claims(answer: Mapping[str, Any]) -> list[Claim]:
    """Effects of an answer on torques, and inertial parameters that no link alone explains."""
    claims = [_claim(c) for c in answer.get("which", ())]
    for c in answer.get("answer", {}).get("causes", ()):
        if c["effect"] == INERTIAL[0] and not c["joints"]:
            share, others = float(c["share"] or 0.0), tuple(c["ambiguous_with"])
            own = c.get("probabilities", {}).get(INERTIAL[0])
            new = c.get("when") != IN_BOTH
            claims.append(Claim("all_base", "inertia", (), (), others, share, own=own, new=new))
    return claims


def _servo_claims(answer: Mapping[str, Any]) -> list[Claim]:
    """Effects of an answer on commands and positions, which has an entry for each joint that an
    effect is on: of each effect one claim, with all of its joints."""
    entries: dict[str, list[Mapping[str, Any]]] = {}
    for cause in answer["which"]:
        entries.setdefault(cause["effect"], []).append(cause)
    n = len(answer["where"]["joints"])
    claims = []
    for name, own in entries.items():
        place = tuple(sorted(j for cause in own for j in cause["joints"]))
        # Squares of errors in mrad, of one joint or in the mean of all.
        gain = sum(
            (cause["error_without_mrad"] ** 2 - cause["error_with_mrad"] ** 2)
            * (1 if cause["joints"] else n)
            for cause in own
        )
        others = sorted({other for cause in own for other in cause["ambiguous_with"]} - {name})
        joints, family = place or tuple(range(1, n + 1)), own[0]["family"]
        values = _from_intervals(own[0]) if len(own) == 1 else {}
        # What is said of a set is said of no name in it.
        sure = None if others else max(cause.get("how_sure") or 0.0 for cause in own)
        claims.append(Claim(name, family, place, joints, tuple(others), gain, values, own=sure))
    return claims


def _from_intervals(cause: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Values and standard deviations of what has a 95 % interval."""
    out = {}
    for name, (low, high) in cause["ci95"].items():
        if low is not None and high is not None:
            out[name] = (cause["parameters"][name], (high - low) / (2 * HALF_95))
    return out


def _claim(cause: Mapping[str, Any]) -> Claim:
    name, joints = cause["effect"], tuple(cause["joints"])
    at_joints = issubclass(KINDS.get(name, Effect), JointEffect | OneJointEffect)
    located = at_joints or name in INERTIAL
    std = {} if cause.get("shape") else cause.get("std", {})
    # What was planted is beside what the robot's file has.
    values = {c: x - cause.get("file", {}).get(c, 0.0) for c, x in _numbers(cause).items()}
    return Claim(
        name,
        cause["family"],
        joints if located and not cause.get("common") else (),
        joints,
        tuple(cause["ambiguous_with"]),
        cause.get("share") or 0.0,
        {c: (values[c], float(s)) for c, s in std.items() if s is not None and c in values},
        cause.get("how_sure"),
        cause.get("probabilities", {}).get(name),
        cause.get("when") != IN_BOTH,
    )


def _planted(effect: Mapping[str, Any]) -> Planted:
    return Planted(
        effect["name"],
        effect["family"],
        tuple(effect["joints"]),
        tuple(effect.get("felt_by", ())),
        effect.get("size", math.nan),
        tuple(effect.get("acceptable", ())),
        _numbers(effect),
    )


def _numbers(entry: Mapping[str, Any]) -> dict[str, float]:
    """Parameters of an entry that are numbers, not lists or words."""
    given = entry.get("parameters", {}).items()
    return {name: float(value) for name, value in given if type(value) in (int, float)}
