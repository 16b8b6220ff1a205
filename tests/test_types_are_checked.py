"""The annotations of all modules are checked in the tests, not only written."""

import importlib
import pkgutil

import jaxtyping
import pytest
import torch

import torchid
from torchid.log.model import Log

UNCHECKED = {"torchid", "torchid.dynamics", "torchid.dynamics.scalars"}  # see conftest.py
pytestmark = [
    pytest.mark.usefixtures("types_checked"),
    pytest.mark.skipif(jaxtyping.config.jaxtyping_disable, reason="JAXTYPING_DISABLE"),
]


def test_a_wrong_shape_or_dtype_is_refused() -> None:
    with pytest.raises(jaxtyping.TypeCheckError, match="T=3"):
        Log(torch.zeros(3), torch.zeros(4, 2))
    with pytest.raises(jaxtyping.TypeCheckError, match="trajectory"):
        Log(torch.zeros(3), torch.zeros(3, 2), trajectory=torch.zeros(3))


def test_every_module_is_checked_but_for_the_scalars() -> None:
    names = [m.name for m in pkgutil.walk_packages(torchid.__path__, "torchid.")]
    modules = [importlib.import_module(n) for n in names if not n.endswith("__main__")]
    plain = {m.__name__ for m in modules if type(m.__loader__).__name__ != "_JaxtypingLoader"}
    assert plain <= UNCHECKED
