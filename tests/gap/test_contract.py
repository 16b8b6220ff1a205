"""torchid.gap/2 as other programs may rely on it, whatever the status: checked on diagnoses of
small simulated logs."""

import copy
import json
import math
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import numpy as np
import pytest

from tests.gap.small_logs import NOISE, ONCE, ROBOT, Recording, arm, carrying, friction, logged
from tests.marks import some
from torchid.effects.registry import FAMILIES, effect_kind
from torchid.gap.settings import GapSettings
from torchid.gap.torque import diagnose_torque
from torchid.robot.model import Robot

pytestmark = pytest.mark.usefixtures("types_unchecked")

STATUSES = (
    "no_gap", "negligible", "parametric_only", "explained", "detected_unexplained", "not_testable",
)  # fmt: skip
CLOSES = ("explained", "parametric_only")
BODY = ("m", "mx", "my", "mz", "Jxx", "Jxy", "Jxz", "Jyy", "Jyz", "Jzz")


def holds(record: dict[str, Any], seconds: float | None = None) -> list[str]:
    """What of the contract a record of torchid.gap/2 breaks, one sentence each.

    Args:
        record: as `--json` writes it.
        seconds: length of the longest trajectory, where it is known [s].
    """
    n = len(record["where"]["joints"])
    said = [*_status(record), *_budget(record), *_shares(record), *_how_far(record, n)]
    for entry in record["which"]:
        said += [f"{entry['effect']} {entry['joints']}: {s}" for s in _entry(entry, record, n)]
        if entry["effect"] == "payload":
            said += [f"payload: {s}" for s in _body(entry)]
        if entry["effect"] == "thermal_friction_drift":
            said += [f"thermal drift: {s}" for s in _warming(entry, seconds)]
    said += _physical(record["corrected"])
    return said


def _number(x: Any) -> bool:
    return isinstance(x, int | float) and not isinstance(x, bool) and math.isfinite(x)


def _status(record: dict[str, Any]) -> Iterator[str]:
    status, closed = record["status"], record["how_far"]["closed"]
    if status not in STATUSES:
        yield f"status '{status}' is none of {STATUSES}"
    accepted = bool(record["answer"]["causes"])
    names = {(e["effect"], *e["joints"]) for e in record["which"]}
    for small in record["answer"]["small"]:
        if (small["effect"], *small["joints"]) in names:
            yield f"{small['effect']} is named, and called small"
    if status == "no_gap" and accepted:
        yield "no_gap, and something is accepted"
    if status in CLOSES and not accepted:
        yield f"{status}, and nothing is accepted"
    if status == "parametric_only" and any(e["effect"] != "link_inertia" for e in record["which"]):
        yield "parametric_only, and an effect is named"
    if status == "explained" and not record["which"]:
        yield "explained, and no effect is named"
    if status in CLOSES and closed is None:
        yield f"{status}, and closed is null"


def _budget(record: dict[str, Any]) -> Iterator[str]:
    shares = record["budget"]
    if set(shares) < {"parametric", "structural", "unexplained"}:
        yield "the budget lacks a share"
    if not all(_number(x) for x in shares.values()):
        yield f"the budget holds no numbers: {shares}"
        return
    if not record["answer"]["causes"]:
        # What is answered closes nothing, whatever was tried on the way.
        if abs(shares["structural"]) > 1e-6:
            yield f"nothing is accepted, and the structural share is {shares['structural']:.3g}"
        if (record["how_far"]["closed"] or 0.0) > 1e-6:
            yield f"nothing is accepted, and closed is {record['how_far']['closed']:.3g}"
    if record["status"] in CLOSES:
        if abs(sum(shares.values()) - 1) > 1e-6:
            yield f"the budget sums to {sum(shares.values()):.6g}"
        if not any(shares.values()):
            yield "the budget is all zero"


def _shares(record: dict[str, Any]) -> Iterator[str]:
    """Of names, of what friction laws hold beside them, and of terms without a name: they add up to
    what the error has fallen by, unless parameters were refitted in any case."""
    far = record["how_far"]
    if record["status"] not in CLOSES or record["settings"].get("refitted"):
        return
    total = sum(e["share"] for e in record["answer"]["causes"])
    total += sum(law["unnamed"] for law in record["friction"])
    total += sum(e["share"] or 0.0 for e in record["answer"]["suspects"])
    less = 1 - far["rms_after"] / far["rms_before"]
    if abs(total - less) > 1e-6:
        yield f"shares add up to {total:.4f} of an error that has lost {less:.4f}"


def _how_far(record: dict[str, Any], n: int) -> Iterator[str]:
    far = record["how_far"]
    closed, interval = far["closed"], far["closed_ci95"]
    if record["status"] in CLOSES and closed is not None:
        if interval is None or not all(_number(x) for x in interval):
            yield f"closed without an interval: {interval}"
        # Resampling may round an end that coincides with the value.
        elif not interval[0] - 1e-6 <= closed <= interval[1] + 1e-6:
            yield f"closed {closed:.4f} lies outside {interval}"
        elif not closed <= 1:
            yield f"closed is {closed:.4f}, more than all"
    if [e["joint"] for e in far["per_joint"]] != list(range(1, n + 1)):
        yield "per_joint is not of joints 1..n"
    # One gap and one noise a joint, wherever they stand.
    for place, own in zip(record["where"]["joints"], far["per_joint"], strict=True):
        if abs(place["gap_rms"] - own["before"]) > 1e-6 * own["before"]:
            yield f"joint {place['joint']}: gap {place['gap_rms']:.3g} and {own['before']:.3g}"
        if place["noise_floor_rms"] != own["noise_floor_rms"]:
            yield f"joint {place['joint']}: two noises"
    low, high = far["noise_floor_rms"]
    if not 0 <= low <= (low if high is None else high):
        yield f"the noise floor is {low}..{high}"


def _entry(entry: dict[str, Any], record: dict[str, Any], n: int) -> Iterator[str]:
    name = entry["effect"]
    if FAMILIES.get(name) != entry["family"]:
        yield f"family '{entry['family']}' is not that of the effect"
    if not all(1 <= j <= n for j in entry["joints"]):
        yield "joints are not 1..n"
    if not _number(entry["how_sure"]) or not 0.5 <= entry["how_sure"] <= 1:
        yield f"named, and sure to {entry['how_sure']}"
    for coefficient, std in entry["std"].items():
        value = entry["parameters"][coefficient]
        # What the log does not determine is null.
        if value is not None and not (_number(std) and std > 0):
            yield f"{coefficient} = {value} +- {std}"
    if name in (entry["ambiguous_with"] or ()):
        yield "ambiguous with itself"


def _body(entry: dict[str, Any]) -> Iterator[str]:
    """A body: positive mass, positive semidefinite pseudo-inertia."""
    m, mx, my, mz, xx, xy, xz, yy, yz, zz = (entry["parameters"][k] for k in BODY)
    if not m > 0:
        yield f"its mass is {m:.3g} kg"
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    pseudo = np.empty((4, 4))
    # Wensing, Kim and Slotine 2018: the matrix of second moments of the mass distribution.
    pseudo[:3, :3] = np.trace(inertia) / 2 * np.eye(3) - inertia
    pseudo[3, :3] = pseudo[:3, 3] = mx, my, mz
    pseudo[3, 3] = m
    least, largest = np.linalg.eigvalsh(pseudo)[[0, -1]]
    if least < -1e-9 * largest:
        yield f"no body has it: least eigenvalue of its pseudo-inertia {least:.3g}"


def _warming(entry: dict[str, Any], seconds: float | None) -> Iterator[str]:
    constant = entry["parameters"]["T"]
    (shape,) = (s for s in effect_kind("thermal_friction_drift").shapes if s.name == "T")
    if not shape.low * 1.001 < constant < shape.high / 1.001:
        yield f"T = {constant:g} s is an end of its range"
    if seconds is not None and not constant < 3 * seconds:
        yield f"T = {constant:g} s in a log of {seconds:g} s"


def _physical(corrected: dict[str, Any]) -> Iterator[str]:
    """What physics forbids to be negative is not, in the corrected model as a whole."""
    total: dict[tuple[str, str, Any], float] = {}
    for entry in corrected.get("effects", ()):
        for c in effect_kind(entry["effect"]).coefficients:
            if c.non_negative and entry.get(c.name) is not None:
                key = (entry["effect"], c.name, entry.get("joint"))
                total[key] = total.get(key, 0.0) + entry[c.name]
    for (name, coefficient, joint), value in total.items():
        if value < -1e-12:
            yield f"{name} of joint {joint}: {coefficient} = {value:.3g} in all"


LIBRARY = (
    "viscous_friction", "coulomb_friction", "torque_offset", "stribeck_friction", "joint_spring",
    "payload", "thermal_friction_drift", "backlash",
)  # fmt: skip
SETTINGS = GapSettings(effects=LIBRARY)

VISCOUS = arm(friction(2, Fv=0.5))
COULOMB = arm(friction(1, Fc=0.5), friction(3, Fc=0.3))
TWO = arm(friction(1, Fv=0.6), friction(2, Fc=0.5))
FAINT = arm(friction(2, Fc=NOISE))
LOADED = carrying(0.8, (0.05, -0.02, 0.03), 0.002)

LOGS: dict[str, tuple[Robot, Recording]] = {
    "nothing, white": (ROBOT, Recording()),
    "nothing, coloured": (ROBOT, Recording(colour_hz=3.0)),
    "nothing, no repeats": (ROBOT, Recording(runs=ONCE)),
    "nothing, coloured, no repeats": (ROBOT, Recording(runs=ONCE, colour_hz=3.0)),
    "nothing, one run": (ROBOT, Recording(runs=(0,), duration=20.0)),
    "nothing, too short": (ROBOT, Recording(runs=(0,), duration=4.0)),
    "viscous, white": (VISCOUS, Recording()),
    "viscous, coloured, no repeats": (VISCOUS, Recording(runs=ONCE, colour_hz=3.0)),
    "coulomb on two joints, white": (COULOMB, Recording()),
    "coulomb on two joints, no repeats": (COULOMB, Recording(runs=ONCE)),
    "payload, white": (LOADED, Recording()),
    "payload, coloured, no repeats": (LOADED, Recording(runs=ONCE, colour_hz=3.0)),
    "noise as large, white": (FAINT, Recording()),
    "noise as large, coloured, no repeats": (FAINT, Recording(runs=ONCE, colour_hz=3.0)),
    "two effects, white": (TWO, Recording()),
    "two effects, no repeats": (TWO, Recording(runs=ONCE)),
}
"""What is in the arm and not in the model, and how it is logged: 20 to 32 s at 125 Hz."""


@cache
def diagnosed(name: str) -> dict[str, Any]:
    real, how = LOGS[name]
    found = diagnose_torque(ROBOT, logged(real, how), settings=SETTINGS)
    return json.loads(json.dumps(found.plain(), allow_nan=False))


QUICK = ("nothing, coloured, no repeats", "nothing, too short", "payload, white")


@pytest.mark.parametrize(
    "name", some([*QUICK, *(n for n in LOGS if n not in QUICK)], slow=2, quick=len(QUICK))
)
def test_diagnoses_keep_the_contract(name) -> None:
    broken = holds(diagnosed(name), LOGS[name][1].duration)
    assert not broken, "\n".join(broken)


SOUND: dict[str, Any] = {
    "status": "explained",
    "where": {
        "joints": [
            {"joint": j, "gap_rms": 1.0, "noise_floor_rms": [0.1, 0.2]} for j in (1, 2)
        ]
    },
    "which": [
        {"effect": "coulomb_friction", "family": "sign", "joints": [2], "ambiguous_with": [],
         "parameters": {"Fc": -0.3, "smoothing": 0.0}, "std": {"Fc": 0.01}, "how_sure": 0.99,
         "notes": [], "share": 0.5},
        {"effect": "payload", "family": "inertia", "joints": [2], "ambiguous_with": [],
         "parameters": dict(zip(BODY, (1, 0.1, 0, 0, 0.01, 0, 0, 0.02, 0, 0.02), strict=True)),
         "std": {"m": 0.1}, "how_sure": 0.99, "notes": [], "share": 0.2},
        {"effect": "thermal_friction_drift", "family": "time", "joints": [1],
         "ambiguous_with": [], "parameters": {"dFv": 0.1, "dFc": 0.0, "T": 20.0},
         "std": {"dFv": 0.01, "dFc": 0.01}, "how_sure": 0.99, "notes": [], "share": -0.1},
    ],
    "friction": [{"unnamed": 0.15}],
    "budget": {"parametric": 0.1, "structural": 0.8, "unexplained": 0.1},
    "how_far": {"closed": 0.9, "closed_ci95": [0.85, 0.95], "noise_floor_rms": [0.1, 0.2],
                "rms_before": 2.0, "rms_after": 0.4,
                "per_joint": [{"joint": j, "before": 1.0, "noise_floor_rms": [0.1, 0.2]}
                              for j in (1, 2)]},
    "settings": {},
    "corrected": {"effects": [{"effect": "coulomb_friction", "joint": 2, "Fc": 0.5}]},
}  # fmt: skip
SOUND["answer"] = {
    "causes": SOUND["which"],
    "small": [],
    "suspects": [{"share": 0.05}, {"share": None}],
}
"""As much of a record as the contract speaks of."""


def _set(*path: Any) -> Callable[[dict[str, Any]], None]:
    """A change of a record: keys, then the value."""

    def change(found: Any) -> None:
        *keys, last, value = path
        for key in keys:
            found = found[key]
        found[last] = value

    return change


def test_a_sound_record_keeps_it() -> None:
    assert holds(SOUND, 30.0) == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (_set("status", "fine"), "is none of"),
        (_set("status", "no_gap"), "something is accepted"),
        (_set("status", "parametric_only"), "an effect is named"),
        (_set("answer", "causes", []), "nothing is accepted"),
        (_set("how_far", "closed", None), "closed is null"),
        (_set("how_far", "closed", 0.5), "lies outside"),
        (_set("how_far", "closed_ci95", None), "without an interval"),
        (_set("how_far", "per_joint", 0, "joint", 0), "not of joints 1..n"),
        (_set("how_far", "per_joint", 0, "before", 1.1), "joint 1: gap 1 and 1.1"),
        (_set("where", "joints", 1, "noise_floor_rms", [0.1, 0.3]), "joint 2: two noises"),
        (_set("answer", "small", [{"effect": "payload", "joints": [2]}]), "called small"),
        (_set("budget", "structural", 0.5), "sums to 0.7"),
        (_set("budget", "structural", None), "no numbers"),
        (_set("budget", {"parametric": 0, "structural": 0, "unexplained": 0}), "all zero"),
        (_set("answer", "suspects", 0, "share", 0.01), "shares add up to 0.7600"),
        (_set("which", 0, "how_sure", 0.4), "sure to 0.4"),
        (_set("which", 0, "how_sure", None), "sure to None"),
        (_set("which", 0, "joints", [0]), "joints are not 1..n"),
        (_set("which", 0, "joints", [3]), "joints are not 1..n"),
        (_set("which", 0, "std", "Fc", 0.0), "+- 0.0"),
        (_set("which", 0, "std", "Fc", None), "+- None"),
        (_set("which", 0, "family", "time"), "is not that of the effect"),
        (_set("which", 1, "parameters", "m", -1), "mass is -1"),
        (_set("which", 1, "parameters", "Jxx", 0.05), "no body has it"),
        (_set("which", 2, "parameters", "T", 5.0), "an end of its range"),
        (_set("which", 2, "parameters", "T", 91.0), "in a log of 30 s"),
        (_set("corrected", "effects", 0, "Fc", -0.1), "Fc = -0.1 in all"),
    ],
)
def test_every_clause_can_be_broken(change, said) -> None:
    found = copy.deepcopy(SOUND)
    change(found)
    assert any(said in sentence for sentence in holds(found, 30.0))
