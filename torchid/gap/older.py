"""Diagnoses of older versions as they are written now."""

import math
from collections.abc import Iterable, Mapping
from typing import Any, get_args

from torchid.gap.record import Regime
from torchid.results.cause import LINK

Json = dict[str, Any]

RENAMED = {"velocity_reversal": "reversal", "low_speed": "slow", "high_speed": "fast"}
"""Regimes, where they have other names now; others of gap/1 are left out where they are gone."""


def from_first(data: Json) -> Json:
    """A document of torchid.gap/1: causes are of one kind, with the arm's numbers, errors name
    their data, and the covariance is of one model."""
    of_file = [*(data.get("model") or {}).get("effects", ())]
    which = [_named(entry, of_file) for entry in data["which"]]
    refitted = [_bodies(p) for p in data.get("parametric", ()) if not p["links"]]
    where = data["where"] | {"regimes": [*_regimes(data["where"]["regimes"])]}
    far = data["how_far"] | {"on": data.get("trajectories", []), "how": "left out in turn"}
    fits = data.get("joint_fits") or ()
    new = data | {"schema": "torchid.gap/2", "where": where, "which": which, "how_far": far}
    if fits:
        names = [{key: c[key] for key in ("effect", "names")} for c in fits[0]["coefficients"]]
        new["covariance"] = {"coefficients": names, "matrix": fits[0]["covariance"]}
    if data.get("answer") is not None:
        small, suspects = (
            [_nameless(entry, of_file, role) for entry in data.get(key, ())]
            for key, role in (("small", "small"), ("suspects", "suspect"))
        )
        causes = sorted([*which, *refitted], key=lambda c: -(c["share"] or 0.0))
        new["answer"] = with_errors(data["answer"], far["on"]) | {
            "causes": causes, "small": small, "suspects": suspects,
        }  # fmt: skip
    return new


def of_positions(data: Json) -> Json:
    """A document of torchid.position_gap/1 of before its answer had causes of one kind."""
    answer = data.get("answer")
    if answer is None or isinstance(answer["before"], dict):
        return data
    lists = {key: [*map(_brief, answer.get(key, ()))] for key in ("causes", "suspects", "small")}
    return data | {"answer": with_errors(answer, []) | lists}


def of_pair(data: Json) -> Json:
    """A document of torchid.pair/1: an effect had its numbers on either side."""
    which = data["which"]
    if which is not None:
        which = [
            {key: value for key, value in one.items() if key not in ("simulator", "arm")}
            | {"parameters": one["arm"], "file": one["simulator"]}
            for one in which
        ]
    return data | {"schema": "torchid.pair/2", "which": which}


def with_errors(answer: Json, on: list[str]) -> Json:
    """An answer whose errors are numbers, with the data that they are of."""
    more = {"unit": answer["unit"], "on": on, "how": "left out in turn"}
    return answer | {key: {"value": answer[key], **more} for key in ("before", "after")}


def _regimes(old: Iterable[Json]) -> Iterable[Json]:
    known = get_args(Regime)
    for one in old:
        name = one["regime"] if one["regime"] in known else RENAMED.get(one["regime"])
        if name in known:
            yield one | {"regime": name}


def _named(entry: Json, of_file: list[Json]) -> Json:
    """What was an accepted effect, with its one probability, and the branch where that is wide."""
    branch, sure, wide = (entry.get(key) for key in ("branch", "how_sure", "branch_sure"))
    # Probability of a branch of causes from which on gap/1 named it in the place of its likeliest
    least_sure = 0.9
    is_wide = (wide or 0.0) >= least_sure and (
        entry.get("one_of_a_set") or (sure or 0.0) < least_sure
    )
    cause = _with_file(entry, of_file) | {
        "branch": branch if is_wide else "",
        "how_sure": wide if is_wide else sure,
        "located": entry.get("located", entry["joints"]),
    }
    gone = ("p_value", "branch_sure", "one_of_a_set", "changed")
    return {key: value for key, value in cause.items() if key not in gone}


def _bodies(entry: Json) -> Json:
    """What was a change of all base parameters."""
    kept = ("share", "how_sure", "alone", "ambiguous_with")
    return {"effect": LINK, "family": "inertia", "joints": []} | {k: entry.get(k) for k in kept}


def _nameless(entry: Json, of_file: list[Json], role: str) -> Json:
    """What was an effect without a name."""
    cause = _with_file(entry, of_file) | {"role": role, "remedy": entry.get("settles", "")}
    return {key: value for key, value in cause.items() if key != "settles"}


def _with_file(entry: Json, of_file: list[Json]) -> Json:
    """With the arm's numbers, which were changes of what the model has, and the model's."""
    numbers = dict(entry["parameters"])
    known = {c["name"].rpartition(" ")[2]: c for c in entry.get("changed", ())}
    own = _of_file(entry, of_file)
    file = {name: float(own[name]) for name in entry["std"] if name in own}
    std = dict(entry["std"])
    for name, was in file.items():
        numbers[name] = was + (numbers[name] or 0.0)
        sure = known.get(f"{name}{'_'.join(map(str, entry['joints']))}", {})
        std[name] = sure.get("after_std", std[name])
    return entry | {"parameters": numbers, "file": file, "std": std}


def _of_file(entry: Json, of_file: list[Json]) -> Mapping[str, Any]:
    """What the model as given has of the same effect, at the same place and of the same shape."""
    joint = entry["joints"][:1] if not entry.get("common") else []
    for one in of_file:
        shape = (one.get(name) == entry["parameters"].get(name) for name in entry.get("shape", ()))
        place = "joint" not in one or [one["joint"]] == joint
        if one.get("effect") == entry["effect"] and place and all(shape):
            return one
    return {}


def _brief(cause: Json) -> Json:
    """A cause of an answer of positions, whose numbers were a list."""
    sizes = cause.pop("sizes", [])
    return {
        **{k: v for k, v in cause.items() if k != "closes"},
        "share": cause.get("closes", math.nan),
        "parameters": {s["name"]: s["value"] for s in sizes},
        "std": {s["name"]: s["std"] for s in sizes},
        "unit": {s["name"]: s["unit"] for s in sizes},
        "file": {s["name"]: s["was"] for s in sizes if s["was"] is not None},
    }
