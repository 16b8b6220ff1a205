"""What is read back predicts, and knows, what was computed."""

import json

import pytest
import torch

import torchid
from tests.identification.test_record import KINDS, result
from torchid.errors import TorchidError


@pytest.fixture
def state():
    return torch.randn(3, 50, 3, dtype=torch.float64)


@pytest.mark.parametrize("kind", KINDS)
def test_it_can_do_what_was_saved(kind, tmp_path, state):
    found = result(kind=kind)
    found.save(tmp_path / "identification.json")
    again = torchid.load(tmp_path / "identification.json")
    torch.testing.assert_close(again.predict(*state), found.predict(*state))
    tau = torch.ones(50, 3, dtype=torch.float64)
    torch.testing.assert_close(again.residual(*state, tau), found.residual(*state, tau))
    assert again.placed == found.effects
    assert (again.base.names, again.base.units) == (found.base.names, found.base.units)
    assert again.base.independent == found.base.independent
    assert torch.equal(again.free, found.free)
    for level in (0.5, 0.95):
        torch.testing.assert_close(again.interval(level), found.interval(level))
    torch.testing.assert_close(
        again.relative_std_percent, found.relative_std_percent, equal_nan=True
    )
    known = [k for k, name in enumerate(found.base.names) if name not in found.undetermined]
    weights = found.base.grouping[known[0]]
    assert again.combination(weights) == pytest.approx(found.combination(weights))
    assert (again.knowledge is None) == (found.knowledge is None)
    if found.knowledge is not None:
        assert torch.equal(again.knowledge.root, found.knowledge.root)


def test_an_older_file_without_its_robot_says_so(tmp_path, state):
    data = {k: v for k, v in result().plain().items() if k != "model"}
    (tmp_path / "old.json").write_text(json.dumps(data))
    old = torchid.load(tmp_path / "old.json")
    assert len(old.std) == len(old.base)
    with pytest.raises(TorchidError, match="does not hold its robot") as caught:
        old.predict(*state)
    assert "identify" in str(caught.value)


def test_a_file_that_contradicts_itself_predicts_nothing(tmp_path, state):
    data = result().plain()
    data["grouping"]["parameters"][0] = "m9"
    (tmp_path / "strange.json").write_text(json.dumps(data))
    with pytest.raises(TorchidError, match="not a complete identification"):
        torchid.load(tmp_path / "strange.json").predict(*state)
