"""Which candidates there are, and what of them is known."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.gap.causes.problems import explanation
from tests.gap.problems import data_of, measured, search_of
from torchid.design.resonance import Swing
from torchid.effects.gravity import TorqueCrosstalk
from torchid.effects.phase import JointElasticity

SWING = Swing(value=2e-4, std=1e-5, damping=20.0, hertz=12.0, explained=0.4, size=0.3)


@pytest.mark.parametrize("logged", [1.0, 0.0])
def test_crosstalk_is_of_a_torque_that_is_logged(logged: float) -> None:
    """What a passive joint, or one without a sensor, would need is read by no other sensor."""
    data = measured([(TorqueCrosstalk(0, 1), [0.02])], noise=0.05, count=1)
    keep = torch.tensor([1.0, logged, 1.0]).double()
    data = data_of([replace(s, tau=s.tau * keep) for s in data.segments])
    terms = search_of(data, ("torque_crosstalk",)).library.terms
    sources = {t.effect.read for t in terms if isinstance(t.effect, TorqueCrosstalk)}
    assert (1 in sources) == (logged > 0)
    assert {0, 2} <= sources


@pytest.mark.parametrize(("explained", "shown"), [(0.4, True), (0.01, False)])
def test_what_a_swing_shows_is_there_however_little_torque_it_has(
    explained: float, shown: bool
) -> None:
    """The compliance is where the swing has it; and is told only where it is worth a name."""
    seen = replace(SWING, explained=explained)
    of = search_of(replace(measured([], noise=2.0), swings={1: seen}), (JointElasticity.name,))
    (own,) = (t for t in of.library.terms if t.seen is not None)
    assert own.joints == (1,)
    assert own.extra > 100
    assert own.shown is shown
    found = explanation(of)
    assert (own.key in {t.key for t in found.fit.terms}) is shown
    fit = of.evidence.fit([own], of.library.rows)
    assert fit.x[0] == pytest.approx(seen.value, abs=3 * seen.std)
    # Its slab is centred there: at its centre it costs no more than being there at all.
    empty = of.evidence.fit([], of.library.rows)
    np.testing.assert_allclose(own.centre, seen.value)
    assert of.evidence.over(fit, empty) > 100


def test_encoders_of_the_links_say_what_the_compliance_is() -> None:
    """Whatever the torque tells of it: a lag in proportion to the load."""
    data = measured([])
    g = torch.Generator().manual_seed(0)
    load = search_of(data).library.columns
    torque = data.samples.of([m.require("torque", "a test").T for m in load.motions])
    noise = 1e-6 * torch.randn(torque.shape, generator=g, dtype=torch.float64)
    of = search_of(replace(data, lag=1e-4 * torque + noise), (JointElasticity.name,))
    seen = [t.seen for t in of.library.terms if t.name == JointElasticity.name]
    assert len(seen) == 3
    for one in seen:
        assert one is not None
        assert one.value == pytest.approx(1e-4, rel=0.05)
