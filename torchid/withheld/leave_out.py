"""Every effect taken out of the library in turn: what is said when the right name is not there?

The answer should be `detected_unexplained`, a member of the same family, or an open one; never
another family's name for sure. Cases come from the simulator of `plant`, one planted effect each;
their folder holds keys, for a diagnosis that is told what to leave out is not a sealed one.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from torchid import __version__
from torchid.effects.registry import FAMILIES, KINDS, effect_kind
from torchid.errors import TorchidError
from torchid.gap.record import plain
from torchid.gap.settings import GapSettings
from torchid.withheld.case_set import ANSWER, LOG, ROBOT, case_id, read_json, write_json
from torchid.withheld.make import CaseJob, write_case
from torchid.withheld.measures import Verdict, row_of, verdict
from torchid.withheld.parallel import each
from torchid.withheld.run import ERROR, Job, run
from torchid.withheld.score import rate

SCHEMA = "torchid.withheld.leave_out/1"
KEY = "key.json"
FAR = 200
"""Numbers looked at for every case wanted before an effect counts as never planted."""

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class LeftOut:
    """One case, and the effect that its diagnosis must do without."""

    effect: str
    number: int

    @property
    def case(self) -> str:
        """Name of its folder."""
        return case_id(self.number)


def leave_out(
    folder: Path,
    seed: int,
    *,
    effects: Sequence[str] | None = None,
    per_effect: int = 1,
    jobs: int = 1,
    again: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Diagnose cases of every effect with a library that lacks it.

    What is in the folder already is kept, so that an interrupted run goes on.

    Args:
        folder: of cases, keys and answers; made if it does not exist.
        seed: of the cases.
        effects: names; all that the simulator plants if None.
        per_effect: cases of each.
        jobs: processes.
        again: as `run.run`.
        progress: called with (stage, done, total).

    Raises:
        TorchidError: an unknown effect, or one that is never planted; a folder of another seed.
    """
    for name in effects or ():
        effect_kind(name)
    say = progress or (lambda stage, done, total: None)
    wanted = list(KINDS if effects is None else dict.fromkeys(effects))
    todo = chosen(seed, wanted, per_effect)
    absent = sorted(set(wanted) - {one.effect for one in todo})
    if effects is not None and absent:
        raise TorchidError("the simulator never plants these alone.", got=", ".join(absent))
    folder.mkdir(parents=True, exist_ok=True)
    keys = _written(folder, seed, todo, jobs, say)
    made = [_job(folder, one) for one in todo]
    answers = run(made, jobs=jobs, again=again, progress=progress)
    return summary(seed, todo, keys, answers, absent)


def chosen(seed: int, effects: Sequence[str], per_effect: int) -> list[LeftOut]:
    """The first cases of a seed in which one of these effects is planted alone."""
    missing = dict.fromkeys(effects, per_effect)
    out = []
    for number, name in _planted_alone(seed, FAR * per_effect):
        if missing.get(name, 0) > 0:
            out.append(LeftOut(name, number))
            missing[name] -= 1
        if not any(missing.values()):
            break
    order = {name: k for k, name in enumerate(effects)}
    return sorted(out, key=lambda one: (order[one.effect], one.number))


def _written(
    folder: Path, seed: int, todo: Sequence[LeftOut], jobs: int, say: Progress
) -> dict[str, dict[str, Any]]:
    """Keys of all cases; those that are not there yet are simulated."""
    keys: dict[str, dict[str, Any]] = {}
    new = []
    for one in todo:
        path = folder / one.case / KEY
        if not path.is_file():
            new.append(CaseJob(seed, one.number, folder))
            continue
        key = read_json(path, "a key")
        if key.get("seed") != seed:
            raise TorchidError(
                f"'{folder}' holds cases of another seed.", got=key.get("seed"), expected=seed
            )
        keys[one.case] = key
    say("simulating cases", 0, len(new))
    for k, (job, key) in enumerate(each(write_case, new, jobs)):
        case = case_id(job.number)
        keys[case] = {**key, "seed": seed}
        write_json(keys[case], folder / case / KEY)
        say("simulating cases", k + 1, len(new))
    return keys


def _job(folder: Path, one: LeftOut) -> Job:
    place = folder / one.case
    rest = tuple(name for name in KINDS if name != one.effect)
    settings = GapSettings(effects=rest, rollout=False)
    return Job(one.case, place / ROBOT, place / LOG, place / ANSWER, settings)


def summary(
    seed: int,
    todo: Sequence[LeftOut],
    keys: Mapping[str, Mapping[str, Any]],
    answers: Mapping[str, Mapping[str, Any]],
    absent: Sequence[str] = (),
) -> dict[str, Any]:
    """Verdicts in all, by effect, and case by case."""
    cases = [_verdict(one, keys[one.case], answers[one.case]) for one in todo]
    judged = [c for c in cases if c["verdict"] != ERROR]
    by_effect = {
        name: dict(Counter(c["verdict"] for c in cases if c["effect"] == name))
        for name in dict.fromkeys(one.effect for one in todo)
    }
    return plain(
        {
            "schema": SCHEMA,
            "seed": seed,
            "version": __version__,
            "verdicts": {v: rate(c["verdict"] == v for c in judged) for v in get_args(Verdict)},
            "by_effect": by_effect,
            "never_planted": list(absent),
            "errors": [c["case"] for c in cases if c["verdict"] == ERROR],
            "cases": cases,
        }
    )


def _verdict(one: LeftOut, key: Mapping[str, Any], answer: Mapping[str, Any]) -> dict[str, Any]:
    row = row_of(key, answer)
    said = ERROR if row.status == ERROR else verdict(row, FAMILIES, every=False)
    return {
        "case": one.case,
        "effect": one.effect,
        "family": FAMILIES[one.effect],
        "size": row.planted[0].size,
        "verdict": said,
        "status": row.status,
        "named": [
            {"name": c.name, "joints": c.place or c.joints, "ambiguous_with": c.ambiguous}
            for c in row.claims
        ],
    }


def _planted_alone(seed: int, most: int) -> Iterator[tuple[int, str]]:
    """(number, effect) of the cases of a seed with one effect of the library."""
    from torchid.withheld.plant.case import draw_case

    for number in range(most * len(KINDS)):
        spec = draw_case(seed, number)
        if spec.kind == "single":
            yield number, spec.effects[0].name
