"""Shapes are numbers like others: fitted with the coefficients, known to a standard deviation, and
the same from wherever a search began."""

from dataclasses import replace

import pytest
import torch

from tests.gap.problems import explanation_of, measured, search_of, term
from torchid.effects.base import JointEffect
from torchid.effects.friction import ViscousFriction
from torchid.effects.friction_laws import PowerLawFriction, StribeckFriction
from torchid.effects.hysteresis import PreslidingHysteresis
from torchid.effects.periodic import Cogging
from torchid.effects.spring import JointSpring
from torchid.effects.surroundings import EndStop
from torchid.gap.describe.covariance import covariance_of
from torchid.gap.describe.friction import over_speed
from torchid.gap.describe.model import Explanation
from torchid.gap.problem import Problem
from torchid.gap.record import Coefficient

BESIDE = {"power_law_friction": [(ViscousFriction(1), [2.0])]}
"""What a shape is not told apart from easily."""

SHAPED = [
    (StribeckFriction(1, vs=0.3), [1.5], (0.2, 0.45)),
    (PowerLawFriction(1, a=1.6), [1.0], (1.4, 1.9)),
    (PreslidingHysteresis(1, length=0.08), [1.0], (0.06, 0.12)),
    (Cogging(1, k=9.0), [0.4, 0.3], (8.8, 9.2)),
]
every = pytest.mark.parametrize(
    ("true", "values", "starts"), SHAPED, ids=[one[0].name for one in SHAPED]
)


def explained(
    true: JointEffect, values: list[float], start: float, seed: int = 0
) -> tuple[Explanation, dict[str, float], dict[str, float]]:
    """Of an effect that a search has left with another shape; its numbers, and their standard
    deviations."""
    (shape,) = true.shapes
    beside = BESIDE.get(true.name, [])
    data = measured([(true, values), *beside], seed=seed)
    search = search_of(data, (true.name, *(e.name for e, _ in beside)))
    began = replace(true, **{shape.name: start})
    found = explanation_of(search, [term(search, e) for e in (began, *(e for e, _ in beside))])
    one = found.solution
    names = [c.name for c in true.coefficients]
    numbers = dict(zip(names, one.values[0].tolist(), strict=True))
    std = dict(zip(names, one.std[0].tolist(), strict=True))
    ended = getattr(one.parts[0].effects[0], shape.name)
    return found, numbers | {shape.name: ended}, std | one.of_shapes(0)


@every
def test_another_start_gives_the_same_numbers_to_a_tenth_of_their_std(true, values, starts):
    (_, one, std), (_, other, _) = (explained(true, values, x) for x in starts)
    apart = {name: abs(one[name] - x) / std[name] for name, x in other.items()}
    assert max(apart.values()) < 0.1, apart


@every
def test_standard_deviations_are_those_of_coefficients_and_shape_together(
    true, values, starts, monkeypatch
):
    """The scatter over noise that might have been, and not that beside a known shape."""
    monkeypatch.setattr(Problem, "as_cad", False)  # bodies are right, and are known to be
    (shape,) = true.shapes
    truth = dict(zip([c.name for c in true.coefficients], values, strict=True))
    truth[shape.name] = getattr(true, shape.name)
    every = [explained(true, values, starts[0], seed)[1:] for seed in range(8)]
    off = torch.tensor([[(x[n] - v) / std[n] for n, v in truth.items()] for x, std in every])
    # Of eight standard normal variables the root mean square is .4 to 1.7, but for one in 400.
    rms = off.square().mean(0).sqrt()
    assert bool(((rms > 0.4) & (rms < 1.7)).all()), rms


def test_the_band_of_a_law_is_no_wider_for_a_shape_that_takes_the_place_of_coefficients():
    """Each of the numbers may be unknown where their sum is not: its variance needs the shape's."""
    true, values, starts = SHAPED[1]
    found, _, std = explained(true, values, starts[0])
    solution = found.solution
    (shape,) = solution.shapes
    speed = torch.linspace(0.2, 1.0, 5, dtype=torch.float64)
    parts = [over_speed(p.effects[0], speed) for p in solution.parts]
    low, high = (over_speed(e, speed) for e in shape.around)
    slope = solution.values[0] @ (high - low) / (shape.near[1] - shape.near[0])
    columns = torch.cat([*parts, slope.unsqueeze(0)])
    band = ((solution.covariance @ columns) * columns).sum(0).sqrt()
    assert float(band.max()) < 0.2 * std["F2"]


def test_the_covariance_is_told_with_shapes_behind_the_coefficients():
    true, values, starts = SHAPED[0]
    found, _, std = explained(true, values, starts[0])
    told = covariance_of(found.solution)
    assert told is not None
    assert told.coefficients == tuple(
        Coefficient(effect=true.name, names=(name,)) for name in ("Fs2", "vs2")
    )
    assert told.matrix[1, 1].sqrt() == pytest.approx(std["vs"])


@pytest.mark.parametrize(
    ("effect", "values", "free"),
    [
        (JointSpring(1, 0.0), [1.0, 0.0], []),  # straight is a simpler law, and no number
        (JointSpring(1, 1.0), [1.0, 0.0], ["curvature"]),
        (EndStop(1, limit=0.2, towards=1.0), [5.0], ["limit"]),  # a side is a choice
    ],
)
def test_a_choice_is_no_number(effect, values, free):
    data = measured([(effect, values)])
    search = search_of(data, (effect.name,))
    found = explanation_of(search, [term(search, effect)]).solution
    assert [s.name for s in found.shapes] == free
