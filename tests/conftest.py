# ruff: noqa: E402 (threads are set, and types checked, before what they act on is imported)
"""Tests' surroundings: one thread, checked types, fixed seeds, and the oracles' robots."""

import os

# Before torch or numpy is imported: their thread pools read these once.
for _name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import random
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import jaxtyping
import numpy as np
import pytest
import torch
import typer.main
from hypothesis import settings

# A slow machine is no fault of what is tested.
settings.register_profile("torchid", deadline=None)
settings.load_profile("torchid")

# Annotations, of shapes, dtypes and the rest, are checked in the packages that TORCHID_TYPES names,
# by the tests of these packages: where shapes are the subject in `make test`, in all of torchid
# nightly. An int is a float, as in PEP 484. Elsewhere torchid is as users have it: checks make
# tests half as long again. Scalars are imported before: they are called a million times, and have
# no shapes.
import torchid.dynamics.scalars

CHECKED = os.environ.get("TORCHID_TYPES", "").split()
if CHECKED:
    # Compiled: nothing can be put around its functions.
    import torchid.simulation.servo_kernel  # noqa: F401

    jaxtyping.install_import_hook(
        CHECKED, "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))"
    )

# The command line is built once a process: typer would build it anew for every call.
typer.main.get_command = cache(typer.main.get_command)

from tests.arms import QUICK_ARMS, arm
from tests.oracles import MujocoOracle, PinocchioOracle
from torchid.robot.model import Robot


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--device", type=str, default="cpu", help="where the tests' tensors live")


TYPES = "test_types_are_checked.py"
"""The tests of the checks."""

LONG = ("test_readme.py", "test_notebooks.py", "test_bad_inputs.py", "test_real_logs.py")
"""Modules of few long tests: they begin first, or one process would end long after the other."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: item.path.name not in LONG)


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


def _of_checked(item: pytest.Item) -> bool:
    """Whether a test's subject is one of the checked packages, or the checks themselves."""
    room = item.path.relative_to(Path(__file__).parent).parts[0]
    return "torchid" in CHECKED or f"torchid.{room}" in CHECKED or room == TYPES


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Types are not checked in tests of other packages and in those that ask for it, nor in their
    fixtures."""
    before = jaxtyping.config.jaxtyping_disable
    unchecked = "types_unchecked" in getattr(item, "fixturenames", []) or not _of_checked(item)
    jaxtyping.config.update("jaxtyping_disable", before or unchecked)
    try:
        return (yield)
    finally:
        jaxtyping.config.update("jaxtyping_disable", before)


@pytest.fixture(scope="session")
def device(pytestconfig: pytest.Config) -> torch.device:
    """For tests whose subject is device-agnostic; `pytest --device cuda` runs them on a GPU."""
    return torch.device(pytestconfig.getoption("device"))


@pytest.fixture(scope="session", params=QUICK_ARMS)
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
