"""Algorithm 1: many runs of a population search under a growing penalty.

    p_0 = LB + (UB - LB) u,  xi_1 = 0
    for k = 1..K:  minimise phi(p) + xi_k gamma(p) within the bounds, starting from p_{k-1}

Each run ends at the set of nearly the least loss that is nearest to its p_K (`convex.finish`).
All runs advance together: every generation of all of them is one call of the loss. A large search
has several such blocks of runs, which know nothing of each other, so that any worker may do them.
The state between two stages is kept in a file that survives an interruption.
"""

import hashlib
import itertools
import time
import zipfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from torchid.errors import TorchidError
from torchid.extraction.cma.batched import minimise
from torchid.extraction.cma.search import SearchState, default_population, start
from torchid.extraction.convex.finish import attainable, finished
from torchid.extraction.found import Extraction
from torchid.extraction.penalty import gamma
from torchid.extraction.problem import Problem
from torchid.extraction.settings import SearchSettings
from torchid.files import atomic_write
from torchid.parallel.workers import Executor, Workers, each, opened
from torchid.typing import Float, Tensor

Report = Callable[[int, int], None]

BLOCK = 1 << 17
"""Numbers in a generation of a block at least: 117 runs of a KUKA with its default population. Each
block costs a millisecond a generation for torch's calls alone, here 5 % of the time of that many
runs, 15 % of that of 25. Who works does not change the blocks: other rows together would be other
sums in other orders."""

_FIRST_SIGMA = 0.3
_LEAST_SIGMA = 1e-3
"""Step size with which a stage begins at least: the minimum has moved, and a search that has
converged on the old one would be stuck there."""


_DAMAGED = (OSError, ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile)
"""What NumPy raises on a file that is none of its own, or half of one."""


@dataclass(frozen=True, eq=False)
class Progress:
    """Where a search is.

    Attributes:
        stage: how many stages are done.
        state: of the searches.
        phi, gamma: (R, stage) of the best so far, after each stage.
    """

    stage: int
    state: SearchState
    phi: Float[Tensor, "R K"]
    gamma: Float[Tensor, "R K"]


def save(path: Path, now: Progress, problem: Problem, settings: SearchSettings) -> None:
    """Write the state; an earlier file is replaced only when the new one is whole.

    Raises:
        TorchidError: the file cannot be written.
    """
    arrays = now.state.to_arrays()
    # Another search of the same folder may have ended, and taken the folder away.
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path, "wb") as stream:
        np.savez(
            stream,
            stage=np.asarray(now.stage),
            phi=now.phi.numpy(),
            gamma=now.gamma.numpy(),
            of=np.asarray(fingerprint(problem, settings)),
            allow_pickle=False,
            **{f"state_{name}": value for name, value in arrays.items()},
        )


def load(path: Path, problem: Problem, settings: SearchSettings) -> Progress | None:
    """The state in the file; None if there is no file.

    Raises:
        TorchidError: not a checkpoint, or one of another problem or of other settings.
    """
    if not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        of, stage = str(arrays["of"]), int(arrays["stage"])
        phi, violated = torch.from_numpy(arrays["phi"]), torch.from_numpy(arrays["gamma"])
        state = SearchState.from_arrays(
            {k.removeprefix("state_"): v for k, v in arrays.items() if k.startswith("state_")}
        )
    except (*_DAMAGED, TorchidError) as error:
        raise TorchidError(f"'{path}' is not a checkpoint of an extraction.", got=error) from error
    if of != fingerprint(problem, settings):
        raise TorchidError(
            f"the checkpoint '{path}' belongs to another extraction.",
            got="other base parameters, bounds, conditions or settings",
            expected="the ones it was started with",
            hint="repeat the first command, or start anew without `resume=True`",
        )
    return Progress(stage, state, phi, violated)


def fingerprint(problem: Problem, settings: SearchSettings) -> str:
    """What a search depends on, as a SHA-256."""
    digest = hashlib.sha256(repr(settings).encode())
    c, target = problem.conditions, problem.target
    for tensor in (
        problem.box, target.weight, target.offset, target.base.grouping,
        c.com_box, c.round_centre, c.round_axes, c.round_radius, c.total_mass,
    ):  # fmt: skip
        digest.update(np.ascontiguousarray(tensor.cpu().numpy()).tobytes())
    return digest.hexdigest()


def require_possible(problem: Problem) -> None:
    """Say before the search that no point of the bounds meets the conditions.

    Raises:
        TorchidError: naming the conditions.
    """
    _, against = attainable(problem)
    if against:
        raise TorchidError(
            f"no point of the bounds '{problem.bounds.name}' meets the conditions: the search has "
            "no feasible set to find.",
            got=", ".join(against),
            expected="bounds that overlap the boxes of the centres of mass, the shapes and the "
            "total mass",
            hint='other `bounds=...` or `geometry=...`; `penalty="partial"`; or '
            "`search_anyway=True`",
        )


def extract(
    problem: Problem,
    settings: SearchSettings | None = None,
    *,
    checkpoint: Path | None = None,
    resume: bool = False,
    keep: bool = False,
    device: torch.device | str = "cpu",
    workers: Workers = 1,
    report: Report | None = None,
) -> Extraction:
    """Search for parameter sets (Algorithm 1).

    Args:
        problem: loss, bounds, conditions.
        settings: of the search; the defaults if None.
        checkpoint: file that keeps the state after every stage, and is removed at the end.
        keep: leave the checkpoint, so that a search that is part of something longer can be
            resumed when it is over.
        resume: continue from the checkpoint if there is one. The result is the same, bit for bit,
            as without the interruption.
        device: where the population is evaluated.
        workers: who searches, where the search is large enough to be done in blocks of runs (twice
            `BLOCK`); see torchid.parallel.workers. The result is the same, bit for bit, for any
            number of them.
        report: called with (stages done, stages in all).

    Raises:
        TorchidError: a checkpoint of another problem or of other settings.

    >>> from torchid import load_robot, problem_of
    >>> from torchid.identification.values import nominal_base
    >>> robot = load_robot("3r")
    >>> problem, _ = problem_of(robot, nominal_base(robot))
    >>> found = extract(problem, SearchSettings(runs=2, stages=3, generations=20))
    >>> found.sets.parameters.mass.shape, bool((found.phi < 1e-12).all())
    (torch.Size([2, 3]), True)
    """
    settings = settings or SearchSettings()
    began = time.monotonic()
    now = load(checkpoint, problem, settings) if resume and checkpoint is not None else None
    if now is None:
        generator = torch.Generator().manual_seed(settings.seed)
        shape = (settings.runs, problem.size)
        uniform = torch.rand(shape, generator=generator, dtype=problem.box.dtype)
        now = Progress(0, start(uniform, _FIRST_SIGMA), uniform[:, :0], uniform[:, :0])
    blocks = _blocks(problem, settings, device)
    with opened(workers if len(blocks) > 1 else 1, _advanced) as (pool, _):
        while now.stage < settings.stages:
            now = _next_stage(problem, settings, now, blocks, pool, device)
            if checkpoint is not None:
                save(checkpoint, now, problem, settings)
            if report is not None:
                report(now.stage, settings.stages)
        searched, full = problem.physical(now.state.best), settings.penalty == "full"
        jobs = [(problem, searched[block], full) for block in blocks]
        ends = torch.cat(each(_finished, jobs, pool))
    weight = 10.0 * settings.stages if full else 0.0
    # A run without such a set stays as the search left it.
    before, after = (problem.phi(x) + weight * gamma(problem, x) for x in (searched, ends))
    p = torch.where((after <= before).unsqueeze(-1), ends, searched)
    phi, violated = problem.phi(p), gamma(problem, p)
    if checkpoint is not None and not keep:
        checkpoint.unlink(missing_ok=True)
    return Extraction(
        problem=problem,
        settings=settings,
        sets=problem.sets(p, [f"run_{k + 1}" for k in range(settings.runs)]),
        phi=phi,
        gamma=violated,
        history_phi=now.phi,
        history_gamma=now.gamma,
        contradictions=attainable(problem)[1],
        seconds=time.monotonic() - began,
    )


def _blocks(problem: Problem, settings: SearchSettings, device: torch.device | str) -> list[slice]:
    """Which runs advance together; on a GPU, which has room for them, all."""
    numbers = (
        settings.runs * problem.size * (settings.population or default_population(problem.size))
    )
    count = numbers // BLOCK if torch.device(device).type == "cpu" else 1
    count = min(max(1, count), settings.runs)
    ends = [settings.runs * k // count for k in range(count + 1)]
    return [slice(a, b) for a, b in itertools.pairwise(ends)]


@dataclass(frozen=True, eq=False)
class _Block:
    """A stage of some of the runs.

    Attributes:
        problem, settings, device: as given to `extract`.
        stage: 0, 1, ...
        state: of these runs.
        first: number of the first of them.
    """

    problem: Problem
    settings: SearchSettings
    device: torch.device | str
    stage: int
    state: SearchState
    first: int


def _advanced(block: _Block) -> SearchState:
    """The state after the stage."""
    problem, settings = block.problem, block.settings
    weight = settings.weight(block.stage)

    def loss(unit: Tensor) -> Tensor:
        p = problem.physical(unit)
        value = problem.phi(p)
        return value if weight == 0 else value + weight * gamma(problem, p, exact=False)

    sigma = block.state.sigma.clamp(min=_LEAST_SIGMA)
    found = minimise(
        loss,
        replace(block.state, sigma=sigma).to(block.device),
        generations=settings.generations,
        seed=settings.seed,
        population=settings.population,
        first=block.first,
    )
    return found.to("cpu")


def _finished(job: tuple[Problem, Float[Tensor, "R D"], bool]) -> Float[Tensor, "R D"]:
    """The ends of some of the runs."""
    problem, searched, full = job
    return finished(problem, searched, conditions=full)


def _next_stage(
    problem: Problem,
    settings: SearchSettings,
    now: Progress,
    blocks: Sequence[slice],
    pool: Executor,
    device: torch.device | str,
) -> Progress:
    jobs = [
        _Block(problem, settings, device, now.stage, now.state.part(block), block.start)
        for block in blocks
    ]
    found = SearchState.joined(each(_advanced, jobs, pool))
    p = problem.physical(found.best)
    phi = torch.cat([now.phi, problem.phi(p).unsqueeze(-1)], -1)
    violated = torch.cat([now.gamma, gamma(problem, p).unsqueeze(-1)], -1)
    return Progress(now.stage + 1, found, phi, violated)
