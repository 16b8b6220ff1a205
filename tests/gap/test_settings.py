"""Settings that cannot be are refused with what would be right."""

import pytest

from torchid.errors import TorchidError
from torchid.gap.settings import GapSettings


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"effects": ("coulom_friction",)}, "unknown effect 'coulom_friction'"),
        ({"effects": ()}, "no effect"),
        ({"effects": ("torque_offset", "torque_offset")}, "twice"),
        ({"background": ("viscous_friction", "viscous_friction")}, "twice"),
        ({"background": ("nothing",)}, "unknown effect"),
        ({"cutoff": -1.0}, "cut-off"),
        ({"cutoff": True}, "cut-off"),
        ({"report_band": 0.0}, "band"),
        ({"folds": 1}, "folds"),
        ({"max_effects": 0}, "effects"),
        ({"held_out_fraction": 1.0}, "held-out"),
        ({"seed": -1}, "seed"),
    ],
)
def test_refused(changes, words):
    with pytest.raises(TorchidError, match=words):
        GapSettings(**changes)
