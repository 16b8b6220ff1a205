"""Causes planted in what an answer leaves: their size, their place, and what becomes of them."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
import torch

from tests.gap.test_diagnose import QUICK, REAL, ROBOT, logged
from torchid.errors import TorchidError
from torchid.gap.data import prepare
from torchid.gap.torque import diagnose_torque
from torchid.log.filtering import ZeroPhaseFilter
from torchid.withheld.planted import OUTSIDE, TIMES, Bed, _plantings, calibrate, with_torque

pytestmark = pytest.mark.usefixtures("types_unchecked")

LOG = logged(REAL, (3, 4, 3), 5)


@pytest.fixture(scope="module")
def diagnosis():
    """Friction of joint 2; the library is small, to be quick."""
    effects = ("coulomb_friction", "viscous_friction", "torque_offset", "joint_spring")
    return diagnose_torque(ROBOT, LOG, settings=replace(QUICK, effects=effects))


def test_torque_on_a_grid_is_added_at_the_log_s_own_stamps():
    segments = prepare(ROBOT, LOG, None).segments
    grids = [torch.arange(len(s.tau)) / s.rate for s in segments]
    added = [torch.stack([g, 2 * g, -g][: LOG.n], 1).double() for g in grids]
    moved = with_torque(LOG, [s.rate for s in segments], added)
    for rows in LOG.slices():
        t = (LOG.t[rows] - LOG.t[rows][0]).numpy()
        change = (moved.tau[rows] - LOG.tau[rows]).numpy()
        np.testing.assert_allclose(change[:-1, 0], t[:-1], atol=1e-9)
        np.testing.assert_allclose(change[:-1, 1], 2 * t[:-1], atol=1e-9)


def test_every_cause_is_as_large_as_asked_for_and_on_one_joint(diagnosis):
    bed = Bed(diagnosis.corrected, LOG, diagnosis.settings)
    segments = prepare(ROBOT, LOG, None).segments
    plantings = list(islice(_plantings(diagnosis, bed, segments, TIMES), 14))
    left = diagnosis.how_far.rms_after
    for one in plantings:
        low = (ZeroPhaseFilter(s.rate, min(diagnosis.band, 0.4 * s.rate)) for s in segments)
        seen = torch.cat([f.apply(x.T).T for f, x in zip(low, one.torque, strict=True)])
        sizes = seen.square().mean(0).sqrt()
        assert float(sizes[one.joint]) == pytest.approx(TIMES * float(left[one.joint]), rel=1e-6)
        assert int((sizes > 0).sum()) == 1
    # What is of no library is among them, and what the answer names comes first.
    assert sum(p.name == OUTSIDE for p in plantings) >= 2
    assert plantings[0].name == diagnosis.which[0].effect


@pytest.mark.slow
def test_what_is_planted_is_named_and_what_no_library_has_is_not(diagnosis):
    """Far larger than what is left, on the joint that leaves most."""
    found = calibrate(diagnosis, LOG, count=6, times=20.0)
    inside = [p for p in found.planted if p.effect != OUTSIDE and p.effect in QUICK_LIBRARY]
    assert inside
    assert all(p.in_set for p in inside)
    outside = [p for p in found.planted if p.effect == OUTSIDE]
    assert outside
    assert not any(p.named or p.in_set for p in outside)
    data = found.plain()
    assert data["schema"] == "torchid.gap.calibration/1"
    assert data["planted"][0]["joint"] == found.planted[0].joint + 1


QUICK_LIBRARY = ("coulomb_friction", "viscous_friction", "torque_offset", "joint_spring")


def test_what_would_plant_nothing_is_refused(diagnosis):
    with pytest.raises(TorchidError, match="plants causes"):
        calibrate(diagnosis, LOG, count=0)
