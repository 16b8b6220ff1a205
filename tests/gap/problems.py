"""Small searches whose answer is known: the 3R, short runs, white noise."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import torch

from tests.gap.motions import ROBOT, motion_at, noises, segment_of, times
from torchid.design.columns import Columns, Model
from torchid.design.repeats import find_repeats
from torchid.design.segments import Samples, Segment, moving_samples
from torchid.effects.base import Effect, Motion
from torchid.effects.registry import Valued, model_torque
from torchid.gap.data import Data, sharp_direction
from torchid.gap.folds import make_folds
from torchid.gap.problem import Problem
from torchid.gap.search.evidence import Question
from torchid.gap.search.terms import Term, Wanted, candidates_of
from torchid.gap.settings import GapSettings
from torchid.identification.base_parameters import BaseParameters, base_parameters
from torchid.robot.model import Robot
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
    return Wanted(tuple(names), free, (), inertial, None, base_of_3r())


def question_of(
    data: Data,
    names: Sequence[str] = SIMPLE,
    *,
    given: Sequence[Valued] = (),
    extra: Sequence[Effect] = (),
    columns: Columns | None = None,
    free: bool = False,
    inertial: bool = False,
    settings: GapSettings = SETTINGS,
) -> Question:
    """Candidates for the gap between data and the 3R with given effects."""
    columns = columns or Columns(Model(ROBOT, tuple(given)), data.samples)
    # The columns' own segments may have another torque.
    torque = [columns.model.torque(s, data.samples) for s in data.segments]
    tau = [s.tau for s in data.segments]
    gap = data.samples.of([(a - b).T for a, b in zip(tau, torque, strict=True)])
    wanted = wanted_of(names, free=free, inertial=inertial)
    model = Model(ROBOT, tuple(given))
    found = candidates_of(columns, gap, data, wanted, model, tuple(extra))
    return Question(found, found.gram.normal, settings)


def two_folds(data: Data) -> Tensor:
    """Two folds, a half of every run each; a few samples are between them."""
    parts = torch.ones(len(data.samples), dtype=torch.long)
    for own in data.samples.bounds:
        middle = (own.start + own.stop) // 2
        parts[middle : own.stop] = 2
        parts[middle - 3 : middle + 3] = 0
    return parts


def term(question: Question, name: str, place: int | None) -> Term:
    """The first candidate of this name and place."""
    return next(t for t in question.candidates.terms if (t.name, t.place) == (name, place))


def named(terms: Sequence[Term]) -> set[tuple[str, int | None]]:
    return {(t.name, t.place) for t in terms}


def problem_of(data: Data, wanted: Wanted, robot: Robot = ROBOT) -> Problem:
    """The gap between data and a robot, with blocks of fifty samples."""
    repeats = find_repeats(data.segments)
    return Problem(
        given=Columns(Model(robot, ()), data.samples),
        data=data,
        judged=None,
        folds=make_folds(data.samples, 5, repeats.groups(len(data.segments))),
        block=torch.arange(len(data.samples)) // 50,
        repeats=repeats,
        wanted=wanted,
        settings=SETTINGS,
        fitted_first=False,
    )
