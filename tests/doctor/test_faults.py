"""Faults that a search has found, beside what the robot's own parameters say of them."""

from types import SimpleNamespace
from unittest.mock import patch

import pytest

from torchid.doctor.faults import confirmed, denied_faults


@pytest.mark.parametrize(
    ("denied", "where"),
    [((False, False), "end"), ((False, True), "second"), ((True, False), "first")],
)
def test_sizes_are_of_the_motion_before_what_nobody_confirms(denied, where):
    found = [
        SimpleNamespace(move=SimpleNamespace(kind="position sign", before=before))
        for before in ("first", "second")
    ]
    result = SimpleNamespace(found=found, final=SimpleNamespace(hypothesis="end"))
    with patch("torchid.doctor.faults._nominal_objects", side_effect=denied):
        assert confirmed(result, denied_faults(None, result)) == where
