"""`torchid compare` and `torchid excite --for` from the outside."""

import json

import pytest

from tests.fleet.records import several


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    return several(tmp_path_factory.mktemp("results"), 3)


def test_compare_writes_and_says_the_verdict_first(command, results, tmp_path):
    asked = ("--out", tmp_path / "out", "--pictures", "--json", tmp_path / "c.json")
    done = command("compare", *results, *asked)
    assert done.code == 0, done.err
    assert done.out.startswith("3 identifications of 3r_friction")
    data = json.loads((tmp_path / "c.json").read_text())
    assert data == json.loads((tmp_path / "out" / "compare.json").read_text())
    assert data["schema"] == "torchid.compare/2"
    assert (tmp_path / "out" / "parameters.png").read_bytes().startswith(b"\x89PNG")
