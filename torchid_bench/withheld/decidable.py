"""What can be known of the cases of a set with a background: classes of its effects by the oracle,
ideally and in practice; of servos by how much they change the positions.

Classes of a set are kept beside its keys, DIR.classes.json; those of sets that figures are stated
of are in the package, `classes`, and are not made again.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from torchid.json_data import picked, read_json, write_json
from torchid.log.readers import read_log
from torchid.parallel.workers import Progress, each
from torchid.robot.library import load_robot
from torchid_bench.withheld.case_set import ROBOT, CaseSet
from torchid_bench.withheld.oracle.classes import Truth, ideally, in_practice
from torchid_bench.withheld.oracle.library import Half, half_of
from torchid_bench.withheld.plant.background_case import Files, of_background
from torchid_bench.withheld.plant.draw import BackgroundSpec, draw_case

FIXED = Path(__file__).with_name("classes")
"""Of sets that figures are stated of, by the SHA-256 of their keys."""

Classes = dict[str, list[dict[str, Any]]]
"""By case: of each effect its classes `ideally` and `in_practice`."""


SHOWN = 2.0
"""Least change of positions that an effect of servos makes, over what their encoders round to [1];
in practice it is larger than what plain servos leave of the background too."""


def servo_classes(keys: Sequence[Mapping[str, Any]]) -> Classes:
    """Classes of all effects of a set of arms of servos, from its keys."""

    def known(effect: Mapping[str, Any], over: float) -> dict[str, str]:
        shown = effect["size"] >= SHOWN and over > 1.0
        return {"class": "decidable" if shown else "undecidable"}

    return {
        key["id"]: [
            {"in_practice": known(e, e["over_background"]), "ideally": known(e, np.inf)}
            for e in key["effects"]
        ]
        for key in keys
    }


def classes_of(cases: CaseSet, *, jobs: int = 1, progress: Progress | None = None) -> Classes:
    """Classes of all effects of a set, those that are kept as they are.

    Args:
        cases: with a background.
        jobs: processes.
        progress: called with (stage, done, total).
    """
    beside = cases.folder.parent / f"{cases.folder.name}.classes.json"
    kept: Classes = {}
    for path in (FIXED / f"{cases.keys_sha256[:16]}.json", beside):
        if path.is_file():
            known = read_json(path, "classes of planted effects")
            if known["keys_sha256"] == cases.keys_sha256:
                kept |= known["classes"]
    numbers = [k for k, case in enumerate(cases.ids) if case not in kept]
    judge = partial(judged, cases.seed, float(cases.background or 0.0))
    for first in range(0, len(numbers), 2 * jobs):  # what is stopped goes on from here
        some = numbers[first : first + 2 * jobs]
        new = each(judge, some, jobs, f"asking the oracle, from {first + 1}", progress)
        kept |= {cases.ids[k]: one for k, one in zip(some, new, strict=True)}
        write_json({**picked(cases, "seed background keys_sha256"), "classes": kept}, beside)
    return kept


def judged(seed: int, background: float, number: int) -> list[dict[str, Any]]:
    """Classes of the effects of one case: it is simulated with all of them, without each, without
    any, and as its file describes it."""
    spec = draw_case(seed, number, mix="background", background=background)
    assert isinstance(spec, BackgroundSpec)
    if not spec.effects:
        return []
    every = range(len(spec.effects))
    whole = of_background(spec)
    planted = _half(whole)
    bare = _half(of_background(spec, only=()), planted)
    quiet = _half(of_background(spec, quiet=True), planted)
    truths = []
    for k, effect in enumerate(whole.key["effects"]):
        others = [i for i in every if i != k]
        without = _half(of_background(spec, only=others), planted) if others else bare
        names = (effect["name"], *effect["acceptable"])
        joints = [j - 1 for j in effect["joints"] or effect["felt_by"]]
        truths.append(Truth.of(names, joints, planted, without))
    asked = zip(in_practice(planted, bare, truths), ideally(planted, quiet, truths), strict=True)
    return [{"in_practice": real, "ideally": known} for real, known in asked]


def _half(files: Files, like: Half | None = None) -> Half:
    with TemporaryDirectory() as folder:
        path = Path(folder) / ROBOT
        path.write_text(files.urdf, encoding="utf-8")
        return half_of(load_robot(path), read_log(files.logs), like=like)
