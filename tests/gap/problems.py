"""Small searches whose answer is known: the 3R, short runs, white noise."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import torch

from tests.gap.motions import ROBOT, motion_at, noises, segment_of, times
from torchid.design.columns import Columns, Model
from torchid.design.repeats import Repeats, find_repeats
from torchid.design.segments import Samples, Segment, moving_samples
from torchid.effects.base import Effect, Motion
from torchid.effects.registry import Valued, model_torque
from torchid.gap.causes.candidates import Library, Term
from torchid.gap.causes.search import Search
from torchid.gap.data import Data, sharp_direction
from torchid.gap.describe.model import Explanation
from torchid.gap.folds import make_folds
from torchid.gap.problem import Problem
from torchid.gap.settings import GapSettings
from torchid.gap.wanted import Wanted
from torchid.identification.base_parameters import BaseParameters, base_parameters
from torchid.robot.model import Robot
from torchid.statistics.blocks import block_numbers
from torchid.typing import Tensor

CUTOFF = 8.0
NOISE = 0.05
SETTINGS = GapSettings()
SIMPLE = ("viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia")


@cache
def base_of_3r() -> BaseParameters:
    return base_parameters(ROBOT)


@cache
def motions(count: int = 2, duration: float = 10.0) -> tuple[Motion, ...]:
    """Different trajectories of the 3R, one after the other, with sharp directions."""
    out = []
    for k in range(count):
        m = motion_at(times(duration), seed=k)
        m = m._replace(t=m.t + k * (duration + 1))
        still = torch.zeros(m.q.shape[1], dtype=torch.float64)
        out.append(m._replace(direction=sharp_direction(segment_of(m), still)))
    return tuple(out)


def measured(
    effects: Sequence[Valued],
    *,
    real: Robot = ROBOT,
    noise: float = NOISE,
    hz: float | None = None,
    seed: int = 0,
    count: int = 2,
    duration: float = 10.0,
) -> Data:
    """What is measured of a robot with effects: as `prepare` would make it."""
    quiet = [
        segment_of(m, model_torque(real, effects, m), f"run{k}")
        for k, m in enumerate(motions(count, duration))
    ]
    noisy = zip(quiet, noises(quiet, seed, hz, noise), strict=True)
    return data_of([replace(s, tau=s.tau + z) for s, z in noisy])


def data_of(segments: Sequence[Segment]) -> Data:
    """Segments as data of which every sample counts in which the joint moves."""
    samples = Samples(segments, CUTOFF)
    slides = torch.ones(samples.n, dtype=torch.bool)
    missing = frozenset({"velocity", "age"})
    exact = torch.zeros(samples.n, dtype=torch.float64)
    return Data(samples, moving_samples(samples), slides, missing, (), (), 20.0, 0.0, exact, ())


def wanted_of(names: Sequence[str], *, free: bool = False, inertial: bool = False) -> Wanted:
    return Wanted(tuple(names), free, (), inertial, base_of_3r())


def two_folds(data: Data) -> Tensor:
    """Two folds, a half of every run each; a few samples are between them."""
    parts = torch.ones(len(data.samples), dtype=torch.long)
    for own in data.samples.bounds:
        middle = (own.start + own.stop) // 2
        parts[middle : own.stop] = 2
        parts[middle - 3 : middle + 3] = 0
    return parts


def search_of(
    data: Data,
    names: Sequence[str] = SIMPLE,
    *,
    given: Sequence[Valued] = (),
    events: Sequence[Effect] = (),
    inertial: bool = False,
    robot: Robot = ROBOT,
) -> Search:
    """A search, not begun, for the gap between data and a robot with given effects."""
    wanted = wanted_of(names, inertial=inertial)
    return Search(Library(problem_of(data, wanted, robot, given), events))


def term(search: Search, effect: Effect) -> Term:
    """The candidate that is an effect; one with this shape where there is none."""
    library = search.library
    every = [t for t in library.terms if t.effect == effect] or [library.of_effect(effect)]
    assert every[0] is not None
    return every[0]


def on_joint(search: Search, name: str, joint: int) -> Term:
    """The first candidate of this name on a joint."""
    return next(t for t in search.library.terms if (t.name, t.joints) == (name, (joint,)))


def explanation_of(search: Search, terms: Sequence[Term]) -> Explanation:
    """Terms, with as many samples as are independent in what they leave."""
    fit = search.again(search.evidence.fit(terms, search.library.rows))
    return Explanation.of(search.library.problem, search, fit)


def problem_of(
    data: Data,
    wanted: Wanted,
    robot: Robot = ROBOT,
    given: Sequence[Valued] = (),
    repeats: Repeats | None = None,
    block: int = 50,
) -> Problem:
    """The gap between data and a robot with given effects, with blocks of so many samples."""
    repeats = find_repeats(data.segments) if repeats is None else repeats
    columns = Columns(Model(robot, tuple(given)), data.samples)
    left = [s.tau - columns.model.torque(s, data.samples) for s in data.segments]
    return Problem(
        given=columns,
        data=data,
        judged=None,
        folds=make_folds(data.samples, 5, repeats.groups(len(data.segments))),
        block=block_numbers(data.samples.bounds, block),
        repeats=repeats,
        apart=tuple(repeats.segments(data.segments, left)),
        wanted=wanted,
        settings=SETTINGS,
        fitted_first=False,
    )
