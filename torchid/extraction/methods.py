"""All ways to sets with given base parameters, by their names."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import torch

from torchid.extraction.convex.certificate import certificate_where_possible
from torchid.extraction.extract import extract, require_possible
from torchid.extraction.found import Found, best_set
from torchid.extraction.near import near_set
from torchid.extraction.problem import Problem
from torchid.extraction.settings import SearchSettings
from torchid.parallel.workers import Progress, Workers, stage

Method = Literal["cma-es", "sdp", "near"]


def found_by(
    method: Method,
    problem: Problem,
    settings: SearchSettings,
    *,
    certificate: bool = True,
    search_anyway: bool = False,
    checkpoint: Path | None = None,
    resume: bool = False,
    device: torch.device | str = "cpu",
    workers: Workers = 1,
    progress: Progress | None = None,
) -> Found:
    """Sets by one method, with the certificate of the problem.

    Args:
        method: population search, convex optimum, or the bodies nearest to expected ones.
        problem: loss, bounds and conditions, from `problem_of`.
        settings: of the search.
        certificate: whether the least loss possible is put beside it.
        search_anyway: also where no point of the bounds can be feasible.
        checkpoint, resume, device, workers: of a population search, whose checkpoint is kept; see
            `extract`.
        progress: called with (stage, done, total).

    Raises:
        TorchidError: no set can be feasible, or as the method raises.
    """

    def running(name: str) -> None:
        if progress is not None:
            progress(name, 0, 0)

    if settings.penalty == "full" and not search_anyway:
        require_possible(problem)
    proof, told = None, tuple[str, ...]()
    if certificate or method == "sdp":
        running("the certificate")
        proof, told = certificate_where_possible(problem)
    if method == "sdp":
        running("the best set")
        found = best_set(problem, proof=proof, search_anyway=search_anyway)
    elif method == "near":
        running("the nearest bodies")
        found = near_set(problem, proof=proof)
    else:
        found = extract(
            problem, settings, checkpoint=checkpoint, resume=resume, keep=True, device=device,
            workers=workers, report=stage(progress, "stages"),
        ).found  # fmt: skip
    return replace(found, proof=proof, warnings=(*told, *found.warnings))
