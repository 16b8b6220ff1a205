# ruff: noqa: E402 (threads are set, and types checked, before what they act on is imported)
"""Tests' surroundings: one thread, checked types, fixed seeds, and the oracles' robots."""

import os

# Before torch or numpy is imported: their thread pools read these once.
for _name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import random
from collections.abc import Iterator

import jaxtyping
import numpy as np
import pytest
import torch

# Every annotation of torchid is checked in every call: shapes, dtypes and the rest; an int is a
# float, as in PEP 484. Scalars are imported before that: they are called a million times, which
# would double the time of the tests, and have no shapes. JAXTYPING_DISABLE=1 checks nothing.
import torchid.dynamics.scalars  # noqa: F401

jaxtyping.install_import_hook(
    "torchid", "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))"
)

from tests.arms import ARMS, arm
from tests.oracles import MujocoOracle, PinocchioOracle
from torchid.robot.model import Robot


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--device", type=str, default="cpu", help="where the tests' tensors live")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest test begins first, or one process would end long after the others."""
    items.sort(key=lambda item: item.path.name != "test_readme.py")


@pytest.fixture(autouse=True, scope="session")
def one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture(autouse=True)
def fixed_seeds() -> None:
    random.seed(0)
    np.random.seed(0)
    torch.manual_seed(0)


@pytest.fixture
def types_unchecked() -> None:
    """For tests of how arguments are refused that the annotations, checked, refuse before, and for
    tests whose fixtures compute for long."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Types are checked in quick tests alone, for checks make long computations half as long again;
    in the fixtures of a test, also those that it shares with others, as in the test itself."""
    before = jaxtyping.config.jaxtyping_disable
    names: list[str] = getattr(item, "fixturenames", [])
    unchecked = before or "types_unchecked" in names or item.get_closest_marker("slow") is not None
    jaxtyping.config.update("jaxtyping_disable", unchecked)
    try:
        return (yield)
    finally:
        jaxtyping.config.update("jaxtyping_disable", before)


@pytest.fixture(scope="session")
def device(pytestconfig: pytest.Config) -> torch.device:
    """For tests whose subject is device-agnostic; `pytest --device cuda` runs them on a GPU."""
    return torch.device(pytestconfig.getoption("device"))


@pytest.fixture(scope="session", params=ARMS)
def robot(request: pytest.FixtureRequest) -> Robot:
    """Every arm of tests/arms.py in turn, each with inertial parameters."""
    return arm(request.param)


@pytest.fixture(scope="session")
def lwr() -> Robot:
    return arm("kuka_lwr4")


@pytest.fixture(scope="session")
def pinocchio(robot: Robot) -> PinocchioOracle:
    return PinocchioOracle(robot)


@pytest.fixture(scope="session")
def mujoco(robot: Robot) -> MujocoOracle:
    return MujocoOracle(robot)
