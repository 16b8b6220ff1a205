"""Folds keep what is judged apart from what is fitted."""

import pytest
import torch

from tests.gap.motions import ROBOT, motion_at, segment_of, times
from torchid.design.columns import Model
from torchid.design.segments import Samples
from torchid.effects.friction import CoulombFriction, TorqueOffset
from torchid.effects.registry import model_torque
from torchid.gap.describe.traces import traces
from torchid.gap.folds import GAP, make_folds
from torchid.log.filtering import ZeroPhaseFilter

CUTOFF, BAND = 8.0, 20.0


def samples_of(count: int, seconds: float = 8.0) -> Samples:
    out = []
    for k in range(count):
        m = motion_at(times(seconds), seed=k)
        out.append(segment_of(m, model_torque(ROBOT, [], m), f"run{k}"))
    return Samples(out, CUTOFF)


@pytest.mark.parametrize(
    ("groups", "wanted", "count"),
    [((0, 1, 2), 5, 3), ((0, 1, 2, 3, 4, 5), 4, 4), ((0, 1, 0, 3, 1), 5, 3), ((0, 0, 2, 3), 2, 2)],
)
def test_whole_trajectories(groups, wanted, count):
    """No row of a trajectory, nor of its repeats, is in its own fold's fit; all others are."""
    samples = samples_of(len(groups))
    folds = make_folds(samples, wanted, groups)
    assert folds.whole
    assert folds.count == count
    of = [set(folds.fold[b].tolist()) for b in samples.bounds]
    assert all(len(one) == 1 for one in of)
    assert set().union(*of) == set(range(count))
    for k, own in enumerate(samples.bounds):
        (fold,) = of[k]
        fitted = folds.fitted(fold)
        assert not fitted[own].any()
        for other, elsewhere in enumerate(samples.bounds):
            if groups[other] == groups[k]:
                assert not fitted[elsewhere].any()
        assert torch.equal(fitted, folds.fold != fold)
    assert torch.equal(folds.parts, folds.fold + 1)


@pytest.mark.parametrize(("groups", "count"), [((0,), 5), ((0, 0, 0), 3), ((0, 1, 0), 4)])
def test_stretches(groups, count):
    """Fewer than three motions: contiguous stretches of each, and a gap beside them."""
    samples = samples_of(len(groups), seconds=12.0)
    folds = make_folds(samples, count, groups)
    assert not folds.whole
    assert folds.count == count
    gap = GAP / (CUTOFF * samples.interval) / 2
    for own in samples.bounds:
        fold = folds.fold[own]
        assert bool((fold.diff() >= 0).all())
        sizes = torch.bincount(fold, minlength=count)
        assert int(sizes.max()) - int(sizes.min()) <= 1
    for k in range(count):
        held = (folds.fold == k).nonzero().flatten()
        fitted = folds.fitted(k).nonzero().flatten()
        # On both sides of a border the filter mixes what is held with what is fitted.
        for own in samples.bounds:
            inside = held[(held >= own.start) & (held < own.stop)].unsqueeze(1)
            beside = fitted[(fitted >= own.start) & (fitted < own.stop)]
            assert int((inside - beside).abs().min()) > gap
        assert not folds.fitted(k)[folds.fold == k].any()
        # No more is lost than a gap on both sides of every border.
        assert len(fitted) >= len(samples) - len(held) - 2 * (gap + 2) * count * len(groups)
    assert torch.equal(folds.parts == 0, folds.border)
    assert torch.equal(folds.parts[~folds.border], folds.fold[~folds.border] + 1)


def test_every_instant_is_predicted_by_its_own_fold():
    """Models told apart by a constant; the low-pass leaves it as it is away from the borders."""
    samples = samples_of(3)
    folds = make_folds(samples, 3, (0, 1, 2))
    before = [Model(ROBOT, ())] * 3
    after = [Model(ROBOT, ((TorqueOffset(1), [10.0 * (k + 1)]),)) for k in range(3)]
    found = traces(samples, folds, before, after, BAND)
    for k, trace in enumerate(found):
        added = (trace.after - trace.before)[trace.valid]
        assert torch.allclose(
            added[:, 1], torch.tensor(10.0 * (int(folds.fold[samples.bounds[k]][0]) + 1))
        )
        assert float(added[:, [0, 2]].abs().max()) < 1e-9


def test_stretches_are_predicted_by_their_own_fold():
    samples = samples_of(1, seconds=16.0)
    folds = make_folds(samples, 4, (0,))
    after = [Model(ROBOT, ((TorqueOffset(0), [float(k)]),)) for k in range(4)]
    (trace,) = traces(samples, folds, [Model(ROBOT, ())] * 4, after, BAND)
    added = (trace.after - trace.before)[:, 0]
    at = samples.edge + samples.step * torch.arange(len(samples))
    inner = torch.ones(len(samples), dtype=torch.bool)
    for border in (folds.fold.diff() != 0).nonzero().flatten().tolist():
        inner[max(0, border - 3) : border + 5] = False  # where the low-pass mixes two folds
    assert int(inner.sum()) > 0.7 * len(samples)
    assert torch.allclose(added[at][inner], folds.fold[inner].double(), atol=1e-3)


def test_traces_are_low_passed_alike_and_leave_the_edges_out():
    samples = samples_of(1)
    segment = samples.segments[0]
    jump = [(CoulombFriction(0), [1.0])]
    (trace,) = traces(samples, None, [Model(ROBOT, ())], [Model(ROBOT, tuple(jump))], BAND)
    low = ZeroPhaseFilter(segment.rate, BAND)
    assert torch.allclose(trace.measured, low.apply(segment.tau.T).T)
    expected = low.apply(model_torque(ROBOT, jump, segment.motion).T).T
    assert torch.allclose(trace.after, expected)
    assert torch.allclose(trace.before, trace.measured, atol=1e-9)
    assert not trace.valid[: samples.edge].any()
    assert not trace.valid[-samples.edge :].any()
    assert trace.valid[samples.edge : -samples.edge].all()
