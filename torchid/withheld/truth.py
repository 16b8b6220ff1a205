"""How far a corrected model really closes a gap: on new motions, seen by ideal sensors.

The arm of a case, with its effects, moves along other trajectories of the same kind, read without
noise, counts and jitter: what a diagnosis says is how far the gap shrinks on data that it was not
fitted on. The noise's part in (L0 - L*) / (L0 - Ln) is then zero, and the closed share is
1 - L*/L0, with L the mean square of the gap below the report's band away from reversals, joints
weighted by their noise. It belongs to scoring: who knows the seed knows the keys.
"""

from collections.abc import Mapping
from functools import partial
from typing import Any

import torch

from torchid.design.columns import Model
from torchid.effects.registry import EVENTS, effect_from_record, nominal_effects
from torchid.errors import TorchidError
from torchid.gap.data import prepare
from torchid.gap.validate.folds import traces
from torchid.json_data import read_json
from torchid.log.columns import log_from_columns
from torchid.log.model import Log
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.withheld.case_set import CaseSet
from torchid.withheld.compare import beside
from torchid.withheld.run import Job, Progress, default_settings, run, written


def true_shares(
    cases: CaseSet,
    keys: list[dict[str, Any]],
    answers: Mapping[str, Mapping[str, Any]],
    jobs: int,
    progress: Progress | None,
) -> dict[str, float]:
    """True closed shares, by case, where a diagnosis gave an interval of one.

    Args:
        cases, keys, answers: of the set; keys opened.
        jobs: processes.
        progress: called with (stage, done, total).
    """
    folder = beside(cases, "truth")
    todo = []
    for key in keys:
        case = str(key["id"])
        known = (answers.get(case, {}).get("how_far") or {}).get("closed_ci95") is not None
        events = any(effect["name"] in EVENTS for effect in key["effects"])
        if known and not events:
            files = cases.robot(case), cases.log(case), folder / f"{case}.json"
            todo.append(Job(case, *files, default_settings()))
    found = run(todo, method=partial(truth_case, cases), jobs=jobs, again=True, progress=progress)
    return {case: float(f["closed"]) for case, f in found.items() if f.get("closed") is not None}


def truth_case(cases: CaseSet, job: Job) -> dict[str, Any]:
    """The true closed share of one case, written like an answer."""

    def answer() -> dict[str, Any]:
        given = read_json(cases.answer(job.case), "an answer")
        from torchid.withheld.plant.case import draw_case, simulate_case

        number = cases.ids.index(job.case)
        ideal = simulate_case(draw_case(cases.seed, number), ideal=True, fresh=True)
        # The arm must be the one that was diagnosed.
        if ideal.urdf != job.robot.read_text(encoding="utf-8"):
            raise TorchidError(f"{job.case} is simulated differently now than when it was made.")
        log = log_from_columns(ideal.columns, job.log)
        robot = load_robot(job.robot)
        noise = torch.tensor(ideal.key["noise_std"], dtype=torch.float64)
        return {
            "status": "done",
            "closed": closed_share(robot, log, given["corrected"], noise, given["band_hz"]),
        }

    return written(job, answer)


def closed_share(
    robot: Robot,
    log: Log,
    corrected: Mapping[str, Any],
    noise: torch.Tensor,
    band: float,
) -> float | None:
    """1 - L*/L0 of a corrected model on a log without noise; None where there is no gap.

    Args:
        robot: the nominal model.
        log: as ideal sensors see it.
        corrected: parameters and effects of the corrected model, as in an answer.
        noise: (n,) standard deviations that weigh the joints.
        band: of the report [Hz].
    """
    given = prepare(robot, log, None)
    pi = torch.tensor(corrected["pi"], dtype=torch.float64)
    better = robot.with_parameters(InertialParameters(pi))
    effects = [effect_from_record(record, better) for record in corrected["effects"]]
    before = Model(robot, tuple(nominal_effects(robot)))
    after = Model(better, tuple(effects))
    losses = torch.zeros(2, dtype=torch.float64)
    # At a reversal the arm may stick, whatever its model: no effect closes that.
    for t in traces(given.samples, None, [before], [after], band):
        for k, predicted in enumerate((t.before, t.after)):
            left = (t.measured - predicted) * t.counting / noise
            losses[k] += left.square().sum()
    return float(1 - losses[1] / losses[0]) if losses[0] > 0 else None
