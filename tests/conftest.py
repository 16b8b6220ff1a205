# ruff: noqa: E402 (threads are set, and types checked, before what they act on is imported)
"""Tests' surroundings: one thread, checked types, fixed seeds, and the oracles' robots."""

import os

# Before torch or numpy is imported: their thread pools read these once.
for _name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import random
import zlib
from collections.abc import Iterator

import jaxtyping
import numpy as np
import pytest
import torch

# Annotations of torchid are checked in every call of some tests: shapes, dtypes and the rest; an
# int is a float, as in PEP 484. Scalars are imported before that: they are called a million times,
# which would double the time of the tests, and have no shapes. JAXTYPING_DISABLE=1 leaves torchid
# as it is, for what could be checked takes time even where it is not: the checks of a function
# inside of another are compiled in each call.
import torchid.dynamics.scalars  # noqa: F401

if not jaxtyping.config.jaxtyping_disable:
    jaxtyping.install_import_hook(
        "torchid", "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))"
    )

from tests.arms import ARMS, arm
from tests.oracles import MujocoOracle, PinocchioOracle
from torchid.robot.model import Robot

CHECKED = 4
"""Types are checked in one of so many quick tests: a function is called by many of them."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--device", type=str, default="cpu", help="where the tests' tensors live")
    parser.addoption("--all-types", action="store_true", help="check types in every quick test")


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


@pytest.fixture
def types_checked() -> None:
    """For tests in which types are checked always."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Types are checked in some quick tests alone, for checks make computations half as long again;
    in the fixtures of a test, also those that it shares with others, as in the test itself."""
    before = jaxtyping.config.jaxtyping_disable
    names: list[str] = getattr(item, "fixturenames", [])
    # Of a test's name, so that it is the same tests every time.
    drawn = zlib.crc32(item.nodeid.encode()) % CHECKED == 0 or item.config.getoption("--all-types")
    quick = item.get_closest_marker("slow") is None and "types_unchecked" not in names
    checked = "types_checked" in names or (quick and drawn)
    jaxtyping.config.update("jaxtyping_disable", before or not checked)
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
