"""The noise floor against noise whose size and spectrum are known."""

from dataclasses import replace

import pytest
import torch

from tests.gap.motions import ROBOT, motion_at, noises, segment_of, times
from tests.gap.problems import data_of, explanation_of, problem_of, wanted_of
from tests.marks import quick_first
from torchid.design.columns import Model
from torchid.design.repeats import Repeats, find_repeats
from torchid.design.segments import REACH, Samples, Segment, moving_samples
from torchid.effects.base import Effect
from torchid.effects.friction_laws import ThermalFrictionDrift
from torchid.effects.registry import model_torque
from torchid.gap.causes.candidates import Library
from torchid.gap.causes.search import Search
from torchid.gap.describe.noise import Noise, noise_of
from torchid.typing import Tensor

CUTOFF, REPORT = 8.0, 20.0
COLOURS = [None, 5.0, 1.0]


def runs(seed: int = 0, count: int = 2, same: bool = True) -> list[Segment]:
    """One reference run several times, or several references."""
    out = []
    for k in range(count):
        m = motion_at(times(), seed if same else 10 * seed + k)
        m = m._replace(t=m.t + 30 * k)
        out.append(segment_of(m, model_torque(ROBOT, [], m), name=f"run{k}"))
    return out


def found_with(
    segments: list[Segment],
    residual: list[Tensor],
    repeats: Repeats | None = None,
    least: float = 0.0,
    found: tuple[Effect, list[float]] | None = None,
) -> Noise:
    """Noise beside a model that lacks the residual, where so much torque is worth a name, or has an
    effect that was found."""
    real = [replace(s, tau=s.tau + r) for s, r in zip(segments, residual, strict=True)]
    data = replace(data_of(real), keep=moving_samples(Samples(real, CUTOFF)), band=REPORT)
    problem = problem_of(data, wanted_of(("viscous_friction",)), repeats=repeats)
    solution = explanation_of(Search(Library(problem)), []).solution
    if found is not None:
        columns = problem.given.at(Model(ROBOT, (found,)))
        solution = replace(solution, columns=columns, left=columns.gap * data.keep)
    worth = torch.full((ROBOT.n,), least, dtype=torch.float64)
    return noise_of(problem, solution, worth)


def size(segments: list[Segment], signals: list[Tensor]) -> Tensor:
    """RMS in the band of the report, where joints slide."""
    samples = Samples(segments, REPORT)
    keep = moving_samples(samples, REACH / CUTOFF)
    squares = samples.of([x.T for x in signals]).square() * keep
    return (squares.sum(1) / keep.sum(1)).sqrt()


@pytest.mark.slow
@pytest.mark.parametrize(("hz", "gap"), [(None, 0.0), (5.0, 5.0), (1.0, 5.0)])
def test_repeats_tell_the_noise_and_not_what_repeats(hz, gap):
    """On each of three joints; an effect five times as large as the noise changes nothing."""
    ratios = []
    for seed in range(2):
        segments = runs(seed, count=3)
        z = noises(segments, seed, hz)
        residual = [x + gap * torch.tanh(4 * s.motion.dq) for x, s in zip(z, segments, strict=True)]
        found = found_with(segments, residual).floor
        assert found.source == "repeats"
        assert found.notes == ()
        ratios.append((found.low * found.high).sqrt() / size(segments, z))
    ratio = torch.stack(ratios)
    assert float((ratio - 1).abs().mean()) < 0.07
    assert float((ratio - 1).abs().max()) < (0.2 if hz == 1.0 else 0.12)


@pytest.mark.slow
def test_a_correction_that_differs_at_each_repeat_is_no_noise_of_the_log():
    """Friction that the corrected model lets drift, and the arm does not."""
    segments = runs(1, count=3)
    z = noises(segments, 1, None)
    drift = ThermalFrictionDrift(1, T=30.0), [0.0, 20 * float(size(segments, z)[1])]
    found = found_with(segments, z, found=drift).floor
    alone = found_with(segments, z).floor
    torch.testing.assert_close(found.high, alone.high, rtol=0.1, atol=0.0)


@pytest.mark.nightly
def test_the_interval_of_a_floor_holds_the_noise():
    """Of fifteen joints nine in ten, on average; and it is narrow."""
    inside = 0
    for seed in range(5):
        segments = runs(seed)
        z = noises(segments, seed, 5.0)
        found = found_with(segments, z).floor
        truth = size(segments, z)
        inside += int(((found.low < truth) & (truth < found.high)).sum())
        assert bool((found.high / found.low < 1.4).all())
    assert inside >= 11


def test_what_happens_once_does_not_raise_the_floor():
    """A push in one of two runs: joint 2 is said not to repeat, with the time of the push."""
    segments = runs(2)
    z = noises(segments, 2, 5.0)
    pushed = [x.clone() for x in z]
    pushed[1][:, 1] += 12 * torch.exp(-(((times() - 11.0) / 0.5) ** 2))
    found = found_with(segments, pushed).floor
    middle = (found.low * found.high).sqrt()
    assert torch.allclose(middle / size(segments, z), torch.ones(3), atol=0.25)
    (note,) = found.notes
    assert "joint 2 did not repeat well" in note
    first, last = (float(x) for x in note.split("well at ")[1].split(" s in ")[0].split(" to "))
    assert first - 1 <= 11.0 <= last + 1


@pytest.mark.parametrize("hz", quick_first(COLOURS, 1))
@pytest.mark.parametrize("gap", [0.0, 2.0])
def test_the_bracket_holds_the_noise(hz, gap):
    """Without repeats, with nothing unmodelled and with a smooth function of the motion. The lower
    end is the white level, far below coloured noise; the upper end is of the noise's order."""
    segments = runs(1, count=3, same=False)
    z = noises(segments, 1, hz)
    residual = [
        x + gap * (torch.tanh(s.motion.dq) + s.motion.q.cos())
        for x, s in zip(z, segments, strict=True)
    ]
    found = found_with(segments, residual)
    assert found.floor.source == "bracket"
    truth = size(segments, z)
    assert bool((found.floor.low <= 1.05 * truth).all())
    assert bool((found.floor.high >= 0.93 * truth).all())
    assert bool((found.floor.low >= (0.8 if hz is None else 0.04) * truth).all())
    if gap == 0:
        assert bool((found.floor.high <= 1.07 * truth).all())
        assert float(found.structure.max()) < 0.1
    else:
        assert float((found.floor.high / size(segments, residual)).mean()) < 0.9
        assert int((found.structure > 0.3).sum()) >= 2


@pytest.mark.parametrize("seed", [1, 3])
def test_a_spring_between_two_joints_is_no_noise(seed):
    """A function of two joints' positions is foreseen on a motion that was left out; coloured noise
    is not."""
    segments = runs(seed, count=3, same=False)
    z = noises(segments, seed, 5.0, size=0.02)
    residual = [x.clone() for x in z]
    for x, s in zip(residual, segments, strict=True):
        stretched = s.motion.q[:, 0] + s.motion.q[:, 1]
        x[:, 1] += stretched.sign() * (stretched.abs() - 0.3).clamp(min=0)
    found = found_with(segments, residual)
    left = found.unpredicted / size(segments, residual)
    assert float(left[1]) < 0.4
    assert left[[0, 2]].tolist() == pytest.approx([1.0, 1.0], abs=0.05)


def test_what_is_worth_no_name_is_not_predicted():
    """A smooth function of the motion, smaller than what is worth a name: all of it is noise."""
    segments = runs(1, count=3, same=False)
    residual = [torch.tanh(s.motion.dq) for s in segments]
    small, asked = (found_with(segments, residual, least=x) for x in (2.0, 0.0))
    assert not bool(small.structure.any())
    assert bool((small.floor.high > asked.floor.high).all())


@pytest.mark.slow
def test_structure_is_found_beside_a_floor_from_repeats():
    """What repeats is no noise; a predictor finds it on its joint, and leaves the noise."""
    segments = runs(3, count=3)
    z = noises(segments, 3)
    lacking = torch.tensor([0.0, 3.0, 0.0])
    residual = [x + lacking * s.motion.q.cos() for x, s in zip(z, segments, strict=True)]
    found = found_with(segments, residual)
    assert found.floor.source == "repeats"
    assert float(found.structure[1]) > 0.5
    assert found.structure[[0, 2]].tolist() == pytest.approx([0.0, 0.0], abs=0.05)
    truth, whole = size(segments, z), size(segments, residual)
    assert float(found.unpredicted[1]) < 0.6 * float(whole[1])
    assert float(found.unpredicted[1]) > 0.9 * float(truth[1])


@pytest.mark.slow
def test_repeats_too_short_to_measure_are_none():
    segments = runs(4)
    z = noises(segments, 4)
    pairs = find_repeats(segments).pairs
    short = [
        replace(
            p,
            rows_a=slice(p.rows_a.start, p.rows_a.start + 100),
            rows_b=slice(p.rows_b.start, p.rows_b.start + 100),
        )
        for p in pairs
    ]
    assert found_with(segments, z, Repeats(tuple(short))).floor.source == "bracket"
