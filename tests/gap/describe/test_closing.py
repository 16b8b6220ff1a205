"""The closed share on traces whose gap and noise are known."""

from dataclasses import replace

import pytest
import torch

from tests.gap.diagnoses import NOISE, coulomb, floor, trace
from torchid.gap.describe.closing import budget, closing, known_noise, noise_variance
from torchid.gap.record import NoiseFloor


def exact(n: int = 3) -> NoiseFloor:
    """A bracket whose middle is the noise's variance."""
    level = torch.full((n,), NOISE, dtype=torch.float64)
    return NoiseFloor(0.9 * level, (2 - 0.9**2) ** 0.5 * level, "repeats")


def left(share: float):
    return lambda motion, model: share * coulomb(motion, model)


def several(share: float, count: int = 3, correlation: float = 0.0):
    return [
        trace(coulomb, left(share), seed=k, correlation=correlation, seconds=40.0)
        for k in range(count)
    ]


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 1.0])
def test_the_closed_share_is_that_of_the_errors(share):
    found = closing(several(share), exact(), seed=0)
    assert found.closed == pytest.approx(1 - share, abs=0.005)
    low, high = found.closed_ci95
    assert low - 1e-9 <= found.closed <= high + 1e-9
    assert low - 0.01 < 1 - share < high + 0.01


@pytest.mark.parametrize("least", [0.1, 0.4, 1.0])
@pytest.mark.parametrize("share", [0.0, 0.05, 0.3])
def test_without_repeats_the_interval_spans_what_the_noise_may_be(share, least):
    """Of coloured noise the lower bound is a tenth: the share without any noise is in the interval,
    which is no wider than noise makes it."""
    traces = several(share, correlation=0.95)
    size = torch.cat([(t.measured - t.after)[t.valid] for t in traces]).square().mean(0).sqrt()
    noise = torch.full((3,), NOISE, dtype=torch.float64)
    floor = NoiseFloor(least * noise, torch.minimum(noise, size), "bracket")
    found = closing(traces, floor, seed=0, unpredicted=floor.high)
    low, high = found.closed_ci95
    assert low - 1e-9 <= found.closed <= high + 1e-9
    assert low - 0.005 < 1 - share < high + 0.005
    assert high - low < 0.2


def test_motions_that_differ_widen_what_others_may_show():
    """Of four motions one is closed by half: another one may be, too. Repeats are no other motions,
    and whether these motions' gap shrinks stays the same question."""
    traces = [*several(0.0), *several(0.5, count=1)]
    blocks = closing(traces, exact(), seed=0)
    apart = closing(traces, exact(), seed=0, motions=range(4))
    alike = closing([traces[0]] * 4, exact(), seed=0, motions=(0, 0, 0, 0))
    assert apart.closed == blocks.closed
    assert apart.improves == blocks.improves
    low, high = apart.closed_ci95
    assert low < 0.6 < blocks.closed_ci95[0]
    assert high > 0.98 > blocks.closed_ci95[1]
    assert alike.closed_ci95 == pytest.approx(
        closing([traces[0]] * 4, exact(), seed=0).closed_ci95, abs=0.01
    )


def test_worse_is_no_improvement():
    assert closing(several(0.0), exact(), seed=0).improves
    assert not closing(several(1.2), exact(), seed=0).improves


def test_rms_before_and_after():
    traces = several(0.25)
    found = closing(traces, exact(), seed=0)
    for which, rms in (("before", found.rms_before), ("after", found.rms_after)):
        gaps = [(t.measured - getattr(t, which))[t.valid] for t in traces]
        assert torch.allclose(rms, torch.cat(gaps).square().mean(0).sqrt())
    assert float(found.rms_before[0]) == pytest.approx(NOISE, rel=0.1)
    assert float(found.rms_before[1]) > 5 * NOISE


@pytest.mark.parametrize("correlation", [0.0, 0.95])
def test_no_gap_no_share(correlation):
    """Noise, white and coloured, as large as the floor says."""
    quiet = [trace(None, None, seed=k, seconds=40.0, correlation=correlation) for k in range(3)]
    # The floor is what the traces hold, so that only their spread speaks.
    size = torch.cat([(t.measured - t.before)[t.valid] for t in quiet]).square().mean(0).sqrt()
    found = closing(quiet, NoiseFloor(size, size, "repeats"), seed=0)
    assert found.closed is None
    assert found.closed_ci95 is None


@pytest.mark.parametrize("source", ["repeats", "bracket"])
def test_a_share_is_never_above_that_of_the_errors_but_for_noise(source):
    """Whatever the joints' sizes and noises: no share is above what the shown errors say, by more
    than the noise that is taken out of both."""
    rng = torch.Generator().manual_seed(3)
    for _ in range(20):
        sizes, lefts = torch.rand(2, 3, generator=rng, dtype=torch.float64)
        factor = 10 ** (2 * sizes)
        one = several(float(lefts.mean()), count=1)[0]
        made = replace(
            one,
            measured=one.measured * factor,
            before=one.before * factor,
            after=one.before * factor + (one.after - one.before) * factor * lefts,
        )
        rms = torch.stack([(made.measured - x).square().mean(0).sqrt()
                           for x in (made.before, made.after)])  # fmt: skip
        noise = NoiseFloor(0.2 * rms[1], 0.9 * rms[1], source)
        found = closing([made], noise, seed=0)
        before, after = found.rms_before.norm(), found.rms_after.norm()
        taken = known_noise(noise).sum()
        least = ((after**2 - taken).clamp(min=0) / (before**2 - taken)).sqrt()
        assert found.closed is None or found.closed <= 1 - least + 1e-9
        shares = budget([made], [made], noise)
        assert shares.parametric + shares.structural <= 1 - least + 1e-9
        if source == "bracket":  # a twenty-fifth of the squares at most is taken out
            assert found.closed is None or found.closed <= 1 - after / before * 0.96**0.5 + 1e-9


def test_the_noise_is_the_middle_of_an_interval_and_the_top_of_a_bracket():
    assert torch.allclose(noise_variance(exact()), torch.full((3,), NOISE**2))
    known = NoiseFloor(floor().low, floor().high, "repeats")
    middle = 0.5 * (known.low.square() + known.high.square())
    assert torch.allclose(noise_variance(known), middle)
    bracket = NoiseFloor(floor().low, floor().high, "bracket")
    assert torch.allclose(noise_variance(bracket), bracket.high.square())


@pytest.mark.parametrize(("refitted", "final"), [(0.4, 0.1), (1.0, 0.2), (0.1, 0.1)])
def test_the_budget_sums_to_one(refitted, final):
    made = budget(several(refitted), several(final), exact())
    assert made.parametric + made.structural + made.unexplained == pytest.approx(1.0)
    assert made.parametric == pytest.approx(1 - refitted, abs=0.01)
    assert made.structural == pytest.approx(refitted - final, abs=0.01)
    assert made.unexplained == pytest.approx(final, abs=0.01)


def test_a_refit_that_makes_it_worse_closes_nothing():
    made = budget(several(1.7), several(0.2), exact())
    assert made.parametric == pytest.approx(0.0, abs=1e-12)
    assert made.structural == pytest.approx(0.8, abs=0.01)


def test_a_refit_that_is_better_than_the_effects_leaves_them_nothing():
    made = budget(several(0.05), several(0.2), exact())
    assert made.structural == pytest.approx(0.0, abs=1e-12)
    assert made.parametric + made.unexplained == pytest.approx(1.0)


def test_shares_of_no_gap_are_zero():
    quiet = [trace(None, None, noise=0.5 * NOISE)]
    made = budget(quiet, quiet, exact())
    assert (made.parametric, made.structural, made.unexplained) == (0.0, 0.0, 0.0)
