"""Results as plain data."""

from dataclasses import dataclass

import torch

from torchid.json_data import picked


@dataclass(frozen=True)
class Inner:
    low: float


@dataclass(frozen=True)
class Outer:
    name: str
    values: torch.Tensor
    inner: Inner


def test_attributes_are_picked_in_the_order_and_under_the_names_of_the_schema():
    one = Outer("arm", torch.tensor([1.0, torch.inf]), Inner(0.5))
    found = picked(one, "numbers=values name bottom=inner.low")
    assert list(found.items()) == [("numbers", [1.0, None]), ("name", "arm"), ("bottom", 0.5)]
