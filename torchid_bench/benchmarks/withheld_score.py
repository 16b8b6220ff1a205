"""What a score is compared with: the diagnosis that is told, and the truth.

    python -m torchid_bench.benchmarks.withheld_score cases --out score [--no-oracle] [--no-truth]

All of it belongs to scoring: it needs the keys, or the seed, and who knows the seed knows the keys.
Answers lie beside the set, not in it, and are kept as long as the diagnosis does not change.

- The *oracle* is the same diagnosis, told what is there and where: how far the gap could be closed
  at most. Folds, shapes and coefficients are found as ever; only the candidates are those that were
  planted, on their joints, and are accepted at any level.
- The *truth* is how far a corrected model really closes the gap: on new motions, seen by ideal
  sensors. The arm of a case, with its effects, moves along other trajectories of the same kind,
  read without noise, counts and jitter: what a diagnosis says is how far the gap shrinks on data
  that it was not fitted on. The closed share is that of `torchid.gap.describe.closing`, below the
  report's band away from reversals; its noise is what filters and dry friction leave of the same
  arm without the effects, whose model is right.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from joblib import cpu_count

from torchid.design.columns import Columns, Model
from torchid.effects.registry import EVENTS, KINDS, effect_from_record
from torchid.errors import TorchidError
from torchid.gap.data import prepare
from torchid.gap.describe.closing import closed_share, levels
from torchid.gap.describe.noise import stuck
from torchid.gap.describe.traces import traces
from torchid.gap.settings import GapSettings
from torchid.json_data import plain, read_json, write_json
from torchid.log.columns import log_from_columns
from torchid.log.model import Log
from torchid.report.panels import save
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid_bench.benchmarks.runner import command
from torchid_bench.benchmarks.withheld_beside import ALL_LINES, beside, closed_by
from torchid_bench.benchmarks.withheld_figures import figures
from torchid_bench.benchmarks.withheld_page import markdown
from torchid_bench.report.withheld import headline, score_table
from torchid_bench.withheld.case_set import (
    CaseSet,
    keys_beside,
    read_answers,
    read_cases,
    read_keys,
)
from torchid_bench.withheld.run import Job, job_of, run, written_answer
from torchid_bench.withheld.score import require_answers, scored_case, summary

Answers = dict[str, dict[str, Any]]
"""By case."""


def _beside(
    what: str,
    cases: CaseSet,
    wanted: Mapping[str, GapSettings | None],
    method: Callable[[Job], dict[str, Any]] | None,
    jobs: int,
) -> Answers:
    """Answers of a method to cases, each with its settings, in a folder beside the set: they belong
    to it but must not lie in it."""
    folder = cases.folder.parent / f"{cases.folder.name}.{what}"
    folder.mkdir(exist_ok=True)
    todo = [job_of(cases, case, folder / f"{case}.json", own) for case, own in wanted.items()]
    return run(todo, method=method, jobs=jobs, again=True)


def oracle_answers(
    cases: CaseSet, keys: Sequence[dict[str, Any]], wanted: Sequence[str], jobs: int
) -> Answers:
    """Answers of the diagnosis that is told, by case with one effect of the library."""
    single = [key for key in keys if key["kind"] == "single" and key["id"] in wanted]
    settings = {key["id"]: key_settings(key, GapSettings()) for key in single}
    known = {case: own for case, own in settings.items() if own is not None}
    return _beside("oracle", cases, known, None, jobs)


def key_settings(key: Mapping[str, Any], settings: GapSettings) -> GapSettings | None:
    """Settings of the diagnosis that is told the key; None where the library lacks a cause, or
    there is none."""
    planted = key["effects"]
    if not planted or any(effect["name"] not in KINDS for effect in planted):
        return None
    names = tuple(dict.fromkeys(effect["name"] for effect in planted))
    # Joints from 0; None for the whole arm.
    only = [(e["name"], j and int(j) - 1) for e in planted for j in e["joints"] or [None]]
    return replace(
        settings,
        effects=names,
        parameters="auto" if "link_inertia" in names else "trusted",
        max_effects=len(planted),
        only=tuple(only),
    )


def true_shares(
    cases: CaseSet,
    keys: list[dict[str, Any]],
    answers: Mapping[str, Mapping[str, Any]],
    jobs: int,
) -> dict[str, float]:
    """True closed shares, by case of a set with its keys opened, where a diagnosis gave an interval
    of one."""
    lasting = [k["id"] for k in keys if not any(e["name"] in EVENTS for e in k["effects"])]
    far = {case: answers.get(case, {}).get("how_far") or {} for case in lasting}
    wanted = dict.fromkeys(case for case in lasting if far[case].get("closed_ci95") is not None)
    shares = _beside("truth", cases, wanted, partial(truth_case, cases), jobs)
    return {case: float(f["closed"]) for case, f in shares.items() if f.get("closed") is not None}


def truth_case(cases: CaseSet, job: Job) -> dict[str, Any]:
    """The true closed share of one case, written like an answer."""

    def answer() -> dict[str, Any]:
        given = read_json(cases.answer(job.case), "an answer")
        from torchid_bench.withheld.plant.case import draw_case, simulate_case

        number = cases.ids.index(job.case)
        spec = draw_case(cases.seed, number, mix=cases.mix)
        ideal = simulate_case(spec, ideal=True, fresh=True)
        # The arm must be the one that was diagnosed.
        if ideal.urdf != job.robot.read_text(encoding="utf-8"):
            raise TorchidError(f"{job.case} is simulated differently now than when it was made.")
        bare = simulate_case(spec, ideal=True, fresh=True, bare=True)
        log, right = (log_from_columns(one.columns, job.logs[0]) for one in (ideal, bare))
        robot = load_robot(job.robot)
        noise = torch.tensor(ideal.key["noise_std"], dtype=torch.float64)
        return {
            "status": "done",
            "closed": true_share(
                robot,
                log,
                right,
                given["corrected"],
                noise,
                given["band_hz"],
                reversals=given["noise_floor"]["source"] != "repeats",
            ),
        }

    return written_answer(job, answer)


def true_share(
    robot: Robot,
    log: Log,
    bare: Log,
    corrected: Mapping[str, Any],
    noise: torch.Tensor,
    band: float,
    *,
    reversals: bool = True,
) -> float | None:
    """Closed share of a corrected model on a log without noise; None where there is no gap.

    What filters and dry friction at reversals leave of an arm whose model is right counts as noise:
    the error of the nominal model on a log without the effects.

    Args:
        robot: the nominal model.
        log: as ideal sensors see it.
        bare: the same of the arm without the effects.
        corrected: parameters and effects of the corrected model, as in an answer.
        noise: (n,) standard deviations of the torque [N m; N].
        band: of the report [Hz].
        reversals: whether instants count at which a joint with dry friction may stick, as they do
            in an answer about a log without repeats.
    """
    pi = torch.tensor(corrected["pi"], dtype=torch.float64)
    better = robot.with_parameters(InertialParameters(pi))
    effects = [effect_from_record(record, better) for record in corrected["effects"]]
    before, after = Model.of(robot), Model(better, tuple(effects))

    def squares(log: Log) -> list[torch.Tensor]:
        """Errors of both models, squared and summed over joints."""
        samples = prepare(robot, log, None).samples
        reach = None if reversals else stuck(Columns(after, samples), noise)
        seen = traces(samples, None, [before], [after], band, reach=reach)
        return [rms.square().sum() for rms in levels(seen)]

    (first, last), (least, _) = squares(log), squares(bare)
    share = float(closed_share(first, last, least))
    return None if share != share else share


def main(
    folder: Path,
    *,
    out: Path,
    keys: Path | None = None,
    no_oracle: bool = False,
    no_truth: bool = False,
    partial: bool = False,
    jobs: int = cpu_count(),
) -> None:
    """Score a set, and write score.json, score.md and its figures; `partial` leaves out cases
    without an answer."""
    cases = read_cases(folder)
    opened = read_keys(cases, keys or keys_beside(folder))
    answers = read_answers(cases)
    require_answers(cases, answers, partial=partial)
    # Beside answers on commands and positions there is no other method of torques.
    torque, oracle, truth = cases.kind == "torque", None, None
    if torque and not no_oracle:
        oracle = closed_by(oracle_answers(cases, opened, tuple(answers), jobs))
    if torque and not no_truth:
        truth = true_shares(cases, opened, answers, jobs)
    result = summary(cases, opened, answers)
    ours = [scored_case(key, answers[key["id"]]) for key in opened if key["id"] in answers]
    result["scores"] |= plain(beside(ours, oracle, truth))
    out.mkdir(parents=True, exist_ok=True)
    write_json(result, out / "score.json")
    drawn = [save(draw(), out / f"{name}.png").name for name, draw in figures(result).items()]
    (out / "score.md").write_text(markdown(result, drawn), encoding="utf-8")
    print(headline(result, ALL_LINES), score_table(result, ALL_LINES).markdown(), sep="\n\n")


if __name__ == "__main__":
    command(main)
