"""Laws of no library, of the size asked for."""

import pytest
import torch

from tests.torchid_bench.withheld.into_logs.test_drawing import moving
from torchid.effects.registry import KINDS
from torchid_bench.withheld.into_logs.drawing import Scene
from torchid_bench.withheld.into_logs.forms import FORMS, formed

__all__ = ["moving"]


@pytest.mark.parametrize("name", FORMS)
def test_a_form_has_its_size_while_it_acts(moving: Scene, name: str) -> None:
    assert set(FORMS[name].right) <= set(KINDS)
    torques, key = formed(moving, name, 3.0, 1)
    torque = torch.cat(torques) / moving.noise
    acts = torque.abs() > 1e-12 * torque.abs().max()
    size = (torque.square().sum(0) / acts.sum(0).clamp(min=1)).sqrt()
    assert float(size.max()) == pytest.approx(3.0)
    assert [len(x) for x in torques] == [len(m.q) for m in moving.motions]
    assert int(size.argmax()) + 1 in key["felt_by"]
    assert key["joints"] == ([] if FORMS[name].of_arm else [2])


def test_a_table_pushes_only_where_the_tool_is_low(moving: Scene) -> None:
    torque = torch.cat(formed(moving, "table", 3.0, 1)[0])
    acts = (torque.abs() > 0).any(1).double().mean()
    assert 0.01 < float(acts) < 0.1
