"""The constraints of `make test-lowest`."""

import pytest

from tests.versions import constraints, lowest


def test_what_is_named_takes_the_place_of_the_lowest():
    found = constraints("lowest", ["torch==9.9"])
    assert [x for x in found if x.startswith("torch=")] == ["torch==9.9"]
    assert any(x.startswith("numpy==") for x in found)
    assert any(x.startswith("h5py==") for x in found)  # of an extra
    assert not any(x.startswith(("ruff", "pytest")) for x in found)  # tools
    assert constraints("newest", ["torch==9.9"]) == ["torch==9.9"]


@pytest.mark.parametrize("requirement", ["numpy", "numpy<3"])
def test_a_requirement_without_a_lower_bound_is_refused(requirement):
    with pytest.raises(SystemExit, match="no lower bound"):
        list(lowest({"dependencies": [requirement], "optional-dependencies": {}}))
