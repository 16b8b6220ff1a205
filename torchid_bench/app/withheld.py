"""`torchid withheld make, run, score`: sealed cases of the independent plant."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer

from torchid.app import options as opt
from torchid.app.inputs import PLACE
from torchid.app.output import Kept, Printed
from torchid.app.signature import Switch, command
from torchid.files import staged

SetArgument = Annotated[
    Path,
    typer.Argument(metavar="DIR", help="A set of cases, from `torchid withheld make`."),
    PLACE,
]


@dataclass(frozen=True)
class Workers:
    """Who does the work.

    Attributes:
        jobs: Processes, of one thread each (default: all cores).
    """

    jobs: Annotated[int | None, typer.Option(min=1)] = None

    @property
    def count(self) -> int:
        """Number of processes: by default one a core that this one may use."""
        from joblib import cpu_count

        return self.jobs or cpu_count()


@command
def make_command(
    *,
    out: opt.Folder,
    cases: Annotated[int, typer.Option(min=1, max=9999)],
    seed: opt.Seed,
    kind: Literal["torque", "position"] = "torque",
    mix: Literal["mixed", "release"] = "mixed",
    robots: Literal["arms", "tree", "quadruped", "two_arms", "torso"] = "arms",
    background: Annotated[float | None, typer.Option(min=0.0)] = None,
    keys: opt.Written = None,
    workers: Workers,
    output: Printed,
) -> None:
    """Simulate arms with planted effects, independently of torchid, and seal what was planted.

    Example: `torchid withheld make --out cases --cases 200 --seed 4711`

    Args:
        out: Folder of the set.
        cases: Number of cases.
        keys: What was planted (default: DIR.keys.json).
        kind: What the logs have: torques, or commands and positions alone.
        mix: Kinds of cases: of every sort, or those that a release is judged by.
        robots: Arms; robots that branch, their base held in the air; or one of these.
        background: Small things that every arm has: as large, after all usual laws are fitted, as
            so many times a cause.
    """
    from torchid_bench.withheld.case_set import keys_beside, make

    sealed = keys_beside(out) if keys is None else keys
    with output.progress() as progress, staged(None):  # what a stopped one has made is kept
        made = make(
            out, cases, seed, kind=kind, mix=mix, robots=robots, background=background,
            keys=sealed, jobs=workers.count, progress=progress,
        )  # fmt: skip
    output.write_json(
        {"folder": str(out), "keys": str(sealed), "keys_sha256": made.keys_sha256, "seed": seed},
        "make.json",
    )
    output.say(f"{cases} cases in {out}, keys in {sealed}")
    output.say(f"SHA-256 of the keys: {made.keys_sha256}")


@command
def run_command(
    *,
    folder: SetArgument,
    again: Switch = False,
    workers: Workers,
    output: Printed,
) -> None:
    """Ask `torchid.diagnose` of every case of a set; no key is read. What is answered stays.

    Example: `torchid withheld run cases --jobs 2`

    Args:
        again: Replace answers of another torchid, or with other settings.
    """
    from torchid.gap.settings import GapSettings
    from torchid_bench.withheld.case_set import read_cases
    from torchid_bench.withheld.run import UNANSWERED, jobs_of, run

    cases = read_cases(folder)
    todo = jobs_of(cases, GapSettings())
    with output.progress() as progress, staged(None):
        answers = run(todo, jobs=workers.count, again=again, progress=progress)
    failed = {case: a["error"] for case, a in answers.items() if a["status"] in UNANSWERED}
    statuses = dict(Counter(answer["status"] for answer in answers.values()))
    output.write_json({"folder": str(folder), "statuses": statuses, "errors": failed}, "run.json")
    output.say(f"{len(answers) - len(failed)} of {len(answers)} cases diagnosed in {folder}")
    output.warn(tuple(f"{case}: {answers[case]['status']}: {e}" for case, e in failed.items()))


@command
def score_command(
    *,
    folder: SetArgument,
    keys: opt.File = None,
    partial: Switch = False,
    workers: Workers,
    output: Annotated[Kept, "score.json"],
) -> None:
    """Open the keys and score the answers.

    Example: `torchid withheld score cases --keys cases.keys.json --out result`

    Args:
        keys: What was planted (default: DIR.keys.json).
        partial: Leave out cases that have no answer yet.
    """
    from torchid_bench.report.withheld import report_of_summary
    from torchid_bench.withheld.case_set import keys_beside, read_answers, read_cases, read_keys
    from torchid_bench.withheld.score import require_answers, summary

    cases = read_cases(folder)
    opened = read_keys(cases, keys_beside(folder) if keys is None else keys)
    answers = read_answers(cases)
    require_answers(cases, answers, partial=partial)
    result = summary(cases, opened, answers)
    if cases.background is not None:
        from torchid_bench.withheld.background_score import background_scores
        from torchid_bench.withheld.decidable import classes_of, servo_classes

        with output.progress() as progress:
            classes = (
                servo_classes(opened)
                if cases.kind == "position"
                else classes_of(cases, jobs=workers.count, progress=progress)
            )
        result["scores"]["background"] = background_scores(opened, answers, classes)
    output.give(result, "score.json", report_of_summary)
