"""Algorithm 1: many runs of a population search under a growing penalty.

    p_0 = LB + (UB - LB) u,  xi_1 = 0
    for k = 1..K:  minimise phi(p) + xi_k gamma(p) within the bounds, starting from p_{k-1}

Each run ends at the set of nearly the least loss that is nearest to its p_K (`convex.finish`).
All runs advance together: every generation of all of them is one call of the loss. A large search
has several such blocks of runs, which know nothing of each other, so that any worker may do them.
"""

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch

from torchid.errors import TorchidError
from torchid.extraction.cma.batched import minimise
from torchid.extraction.cma.search import SearchState, default_population, start
from torchid.extraction.convex.finish import attainable, finished
from torchid.extraction.found import Extraction
from torchid.extraction.penalty import gamma
from torchid.extraction.problem import Problem
from torchid.extraction.settings import SearchSettings
from torchid.parallel.workers import Workers, each, opened
from torchid.typing import Float, Tensor

Report = Callable[[int, int], None]

BLOCK = 1 << 17
"""Numbers in a generation of a block at least: 117 runs of a KUKA with its default population. Each
block costs a millisecond a generation for torch's calls alone, here 5 % of the time of that many
runs, 15 % of that of 25. Who works does not change the blocks: other rows together would be other
sums in other orders."""


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
    device: torch.device | str = "cpu",
    workers: Workers = 1,
    report: Report | None = None,
) -> Extraction:
    """Search for parameter sets (Algorithm 1).

    Args:
        problem: loss, bounds, conditions.
        settings: of the search; the defaults if None.
        device: where the population is evaluated.
        workers: who searches, where the search is large enough to be done in blocks of runs (twice
            `BLOCK`); see torchid.parallel.workers. The result is the same, bit for bit, for any
            number of them.
        report: called with (stages done, stages in all).

    Raises:
        BrokenProcessPool: a worker was killed, as where memory runs out.

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
    generator = torch.Generator().manual_seed(settings.seed)
    shape = (settings.runs, problem.size)
    uniform = torch.rand(shape, generator=generator, dtype=problem.box.dtype)
    # 0.3: first step size, as a share of the box
    state, history = start(uniform, 0.3), list[tuple[Tensor, Tensor]]()
    blocks = _blocks(problem, settings, device)
    with opened(workers if len(blocks) > 1 else 1) as (pool, _):
        for stage in range(settings.stages):
            parts = [
                _Block(problem, settings, device, stage, state.part(block), block.start)
                for block in blocks
            ]
            state = SearchState.joined(each(_advanced, parts, pool))
            searched = problem.physical(state.best)
            history.append((problem.phi(searched), gamma(problem, searched)))
            if report is not None:
                report(stage + 1, settings.stages)
        full = settings.penalty == "full"
        jobs = [(problem, searched[block], full) for block in blocks]
        ends = torch.cat(each(_finished, jobs, pool))
    weight = 10.0 * settings.stages if full else 0.0
    # A run without such a set stays as the search left it.
    before, after = (problem.phi(x) + weight * gamma(problem, x) for x in (searched, ends))
    p = torch.where((after <= before).unsqueeze(-1), ends, searched)
    phi, violated = problem.phi(p), gamma(problem, p)
    history_phi, history_gamma = (torch.stack(values, -1) for values in zip(*history, strict=True))
    return Extraction(
        problem=problem,
        settings=settings,
        sets=problem.sets(p, [f"run_{k + 1}" for k in range(settings.runs)]),
        phi=phi,
        gamma=violated,
        history_phi=history_phi,
        history_gamma=history_gamma,
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

    # 1e-3: step size with which a stage begins at least: the minimum has moved, and a search that
    # has converged on the old one would be stuck there
    sigma = block.state.sigma.clamp(min=1e-3)
    state = minimise(
        loss,
        replace(block.state, sigma=sigma).to(block.device),
        generations=settings.generations,
        seed=settings.seed,
        population=settings.population,
        first=block.first,
    )
    return state.to("cpu")


def _finished(job: tuple[Problem, Float[Tensor, "R D"], bool]) -> Float[Tensor, "R D"]:
    """The ends of some of the runs."""
    problem, searched, full = job
    return finished(problem, searched, conditions=full)
