"""The annotations of all modules are checked in the tests, not only written."""

import pkgutil
from importlib import import_module

import jaxtyping
import pytest
import torch

from tests.conftest import CHECKED
from torchid.robot.inertia import InertialParameters

NO_SHAPES = ("torchid.dynamics.scalars", "torchid.simulation.servo_kernel")
"""Imported before anything is checked; see conftest.py."""

pytestmark = pytest.mark.skipif(not CHECKED, reason="TORCHID_TYPES names no package")


def test_a_wrong_shape_or_dtype_is_refused() -> None:
    with pytest.raises(jaxtyping.TypeCheckError, match="10"):
        InertialParameters(torch.zeros(3, 9))
    with pytest.raises(jaxtyping.TypeCheckError):
        InertialParameters(torch.zeros(3, 10, dtype=torch.int64))


@pytest.mark.parametrize("package", CHECKED)
def test_every_module_is_checked_but_for_the_scalars(package: str) -> None:
    names = [m.name for m in pkgutil.walk_packages(import_module(package).__path__, f"{package}.")]
    modules = [import_module(n) for n in names if not n.endswith("__main__")]
    assert len(modules) > 1
    plain = {m.__name__ for m in modules if type(m.__loader__).__name__ != "_JaxtypingLoader"}
    above = {name.rpartition(".")[0] for name in NO_SHAPES} | {"torchid.other_packages"}
    assert plain <= above | set(NO_SHAPES)
