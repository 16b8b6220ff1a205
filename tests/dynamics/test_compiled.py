"""Compiled dynamics equals eager, compiles once, and says what is missing."""

import os
from pathlib import Path

import pytest
import torch

from tests.arms import arm, consistent_parameters, mixed_arm, relative, states
from tests.marks import some
from torchid.dynamics import compiled
from torchid.dynamics.compiled import CompiledDynamics, compiled_dynamics
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.dynamics.regressor import regressor_chunks
from torchid.errors import RobotError, TorchidError
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot

CHUNK = 64


@pytest.fixture(scope="module", params=["PR", pytest.param("RPR", marks=pytest.mark.nightly)])
def short_arm(request: pytest.FixtureRequest) -> Robot:
    return mixed_arm(request.param)


@pytest.mark.parametrize("batch", some([(5, 3), (), (1,), (64,), (65,), (200,), (0,)], 1))
def test_torques_equal_eager(short_arm: Robot, batch: tuple[int, ...]) -> None:
    motion = states(short_arm, *batch)
    tau = compiled_dynamics(short_arm, CHUNK).inverse_dynamics(*motion)
    expected = inverse_dynamics(short_arm, *motion)
    assert tau.shape == expected.shape
    torch.testing.assert_close(tau, expected, rtol=0, atol=1e-11)


@pytest.mark.nightly
@pytest.mark.parametrize("samples", some([65, 1, 64, 200], 1))
def test_regressor_equals_eager(short_arm: Robot, samples: int) -> None:
    motion = states(short_arm, samples)
    dynamics = compiled_dynamics(short_arm, CHUNK)
    pairs = [(link, k) for link in range(short_arm.n) for k in range(10)]
    for i in range(short_arm.n):
        ours, eager = (
            torch.cat([chunk.row(i, pairs) for chunk in chunks], -1)
            for chunks in (
                dynamics.regressor_chunks(*motion),
                regressor_chunks(short_arm, *motion),
            )
        )
        assert ours.shape == (len(pairs), samples)
        torch.testing.assert_close(ours, eager, rtol=0, atol=1e-11)


@pytest.mark.nightly
def test_new_parameters_and_lengths_do_not_compile_again(
    short_arm: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    dynamics = compiled_dynamics(short_arm, CHUNK)
    dynamics.inverse_dynamics(*states(short_arm, 3))
    monkeypatch.setattr(compiled, "_compile", None)
    with torch._dynamo.config.patch(error_on_recompile=True):
        for seed, samples in ((1, 10), (2, 100)):
            motion = states(short_arm, samples, seed=seed)
            parameters = consistent_parameters(short_arm.n, seed)
            tau = dynamics.inverse_dynamics(*motion, parameters)
            assert relative(tau, inverse_dynamics(short_arm, *motion, parameters)) < 1e-13


@pytest.mark.nightly
@pytest.mark.parametrize("name", some(["kuka_lwr4", "3r", "panda"], 1))
def test_built_in_arms_equal_eager(name: str) -> None:
    robot = arm(name)
    motion = states(robot, 5000)
    tau = compiled_dynamics(robot).inverse_dynamics(*motion)
    assert relative(tau, inverse_dynamics(robot, *motion)) < 1e-13


@pytest.mark.nightly
def test_float32(short_arm: Robot) -> None:
    motion = [x.float() for x in states(short_arm, 50)]
    tau = compiled_dynamics(short_arm, CHUNK).inverse_dynamics(*motion)
    assert tau.dtype is torch.float32
    assert relative(tau, inverse_dynamics(short_arm, *motion)) < 1e-5


def test_made_once_per_robot() -> None:
    robot = mixed_arm("R")
    assert compiled_dynamics(robot) is compiled_dynamics(robot)
    assert compiled_dynamics(robot) is not compiled_dynamics(mixed_arm("R"))


def test_no_compiler_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CXX", raising=False)
    with pytest.raises(TorchidError, match=r"C\+\+ compiler") as error:
        CompiledDynamics(mixed_arm("R"))
    assert "install" in str(error.value)


def test_a_chosen_compiler_that_is_absent_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CXX", "no-such-compiler")
    with pytest.raises(TorchidError, match="no-such-compiler"):
        CompiledDynamics(mixed_arm("R"))


def test_one_set_of_parameters_at_a_time() -> None:
    robot = mixed_arm("RP")
    sets = InertialParameters(torch.zeros(4, 2, 10, dtype=torch.float64))
    with pytest.raises(TorchidError, match="one set"):
        compiled_dynamics(robot).inverse_dynamics(*states(robot, 4), sets)


def test_without_parameters_says_what_is_missing() -> None:
    robot = mixed_arm("RP").with_parameters(None)
    with pytest.raises(RobotError, match="no inertial parameters"):
        compiled_dynamics(robot).inverse_dynamics(*states(robot, 4))


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({"TORCHINDUCTOR_CACHE_DIR": "given"}, "given"),
        ({"XDG_CACHE_HOME": "caches"}, os.path.join("caches", "torchid", "inductor")),
        ({"HOME": "someone"}, os.path.join("someone", ".cache", "torchid", "inductor")),
    ],
)
def test_cache_folder(
    variables: dict[str, str], expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("TORCHINDUCTOR_CACHE_DIR", "XDG_CACHE_HOME"):
        # Set first, so that the variable the call makes is undone with the rest.
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    compiled._choose_cache_folder()
    assert os.environ["TORCHINDUCTOR_CACHE_DIR"] == expected
