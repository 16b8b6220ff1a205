"""C: the generated file compiles without warnings and equals the library to rounding."""

import shutil
import subprocess
from dataclasses import replace

import pytest
import torch

from tests.arms import QUICK_ARMS, arm, mixed_arm
from tests.export.arms import FRICTION, exported, with_other
from tests.marks import quick_first
from torchid.effects.base import Motion
from torchid.effects.registry import KINDS, nominal_effects, on_every_joint
from torchid.errors import TorchidError
from torchid.export.c_code import c_file, effect_code, identifier
from torchid.export.checks import check_c, compiler
from torchid.export.dynamics import Dynamics, of_base, random_states, robot_torque
from torchid.identification.base_parameters import base_parameters, nominal_values
from torchid.identification.values import BaseValues
from torchid.robot.inertia import InertialParameters

pytestmark = pytest.mark.skipif(compiler() is None, reason="no C compiler")

ALL = (
    *FRICTION,
    {"effect": "coulomb_friction", "joint": 3, "Fc": 0.4, "smoothing": 0.05},
    {"effect": "power_law_friction", "joint": 2, "F2": -0.3, "a": 1.5},
    {"effect": "asymmetric_friction", "joint": 3, "dF": 0.1, "dFv": -0.02},
    {"effect": "joint_spring", "joint": 3, "k": 2.0, "c0": 0.3, "curvature": 1.0},
    {"effect": "joint_spring", "joint": 1, "k": 2.0, "c0": -0.3, "curvature": -0.5},
    {"effect": "cogging", "joint": 1, "a_s": 0.2, "a_c": -0.1, "k": 12.0},
    {"effect": "gear_coupling", "joint": 3, "source_joint": 2, "Fvm": 0.2, "Iam": 0.03,
     "Fcm": 0.1, "ratio": -1.0},
    {"effect": "load_dependent_friction", "joint": 2, "mu": 0.05},
    {"effect": "torque_gain", "joint": 1, "gain": -0.04},
    {"effect": "torque_crosstalk", "joint": 3, "source_joint": 1, "C": 0.02},
    {"effect": "saturation", "joint": 2, "clip": 1.0, "limit": 2.0},
    {"effect": "encoder_offset", "joint": 2, "offset": 0.02, "at": 0.03},
)  # fmt: skip
PAST = (
    {"effect": "presliding_hysteresis", "joint": 1, "Fh": 0.3, "length": 0.05},
    {"effect": "time_delay", "joint": 2, "delay": 0.01},
    {"effect": "thermal_friction_drift", "joint": 1, "dFv": 0.1, "dFc": 0.2, "T": 60.0},
)


@pytest.mark.parametrize("name", QUICK_ARMS)
def test_it_equals_the_library(name, tmp_path):
    robot = with_other(arm(name))
    (found,) = exported(robot, "c", tmp_path).comparisons
    assert found.states == 200
    assert found.difference <= 1e-12


def test_every_effect_with_a_closed_form(tmp_path):
    robot = with_other(mixed_arm("RRR", 5), effects=ALL)
    done = exported(robot, "c", tmp_path)
    assert done.left_out == ()
    assert done.comparisons[0].difference <= 1e-12
    text = done.files[0].read_text()
    assert all(words in text for words in done.in_file)


def test_effects_with_a_memory_are_left_out_aloud(tmp_path):
    robot = with_other(arm("3r"), effects=(*FRICTION, *PAST))
    done = exported(robot, "c", tmp_path)
    assert len(done.left_out) == 3
    assert len(done.in_file) == len(FRICTION)
    text = done.files[0].read_text()
    assert "LEFT OUT" in text
    assert all(words in text for words in done.left_out)


@pytest.mark.parametrize("name", quick_first(KINDS, 6))
def test_every_effect_is_written_or_left_out(name, tmp_path):
    """A new effect is one or the other: never silently nothing."""
    effect = KINDS[name].exemplar(1)
    robot = with_other(mixed_arm("RRRR", 5), effects=(effect.record(effect.example.values),))
    code = effect_code(robot, nominal_effects(robot), "rigid")
    written = effect.c_code(effect.example.values) is not None
    assert bool(code.first or code.later) == written
    assert len(code.left_out) == (not written)
    if written:
        done = exported(robot, "c", tmp_path)
        assert done.comparisons[0].difference <= 1e-12


def test_base_parameters_and_their_representative(tmp_path):
    """Negative and zero masses do no harm: the torque is linear in the parameters."""
    robot = replace(arm("kuka_lwr4"), effects=FRICTION[:2])
    effects = tuple(on_every_joint(["viscous_friction", "coulomb_friction"], robot.n))
    base = base_parameters(robot, effects)
    values = nominal_values(robot, base)
    known = torch.ones(len(base), dtype=torch.bool)
    dynamics = of_base(robot, BaseValues(base, effects, values, known, None, None), "a test")
    motion = random_states(robot, 1)
    assert float(dynamics.robot.parameters.mass.min()) == 0.0
    code = c_file(dynamics, "kuka")
    assert check_c(code, "kuka", motion, dynamics.torque(motion)).difference <= 1e-12
    assert check_c(code, "kuka", motion, robot_torque(robot, motion)).difference is not None
    assert "ONE REPRESENTATIVE" in code.source
    assert "physical (masses can be zero or negative" in code.source
    for name in base.names:
        assert name in code.source


@pytest.mark.slow
def test_the_strictest_compiler_takes_it(tmp_path):
    robot = with_other(mixed_arm(), effects=ALL)
    source, header = exported(robot, "c", tmp_path).files
    for flags in (["-std=c99"], ["-std=c11", "-O3"], ["-x", "c++"]):
        if flags[0] == "-x" and shutil.which("c++") is None:
            continue
        done = subprocess.run(
            [str(compiler()), *flags, "-Wall", "-Wextra", "-Werror", "-pedantic", "-c",
             str(source), "-o", str(tmp_path / "out.o")],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
    assert "OUT_JOINTS 6" in header.read_text()


def test_code_that_does_not_agree_is_not_kept(tmp_path, monkeypatch):
    robot = with_other(arm("3r"))
    from torchid.export import write_plain

    def spoiled(*args):  # type: ignore[no-untyped-def]
        code = c_file(*args)
        return code._replace(source=code.source.replace("tau[1] +=", "tau[1] -="))

    monkeypatch.setattr(write_plain, "c_file", spoiled)
    with pytest.raises(TorchidError, match="does not reproduce"):
        exported(robot, "c", tmp_path)
    monkeypatch.setattr(
        write_plain, "c_file", lambda *args: c_file(*args)._replace(source="int x = ;")
    )
    with pytest.raises(TorchidError, match="nothing was kept") as raised:
        exported(robot, "c", tmp_path)
    assert "does not compile" in str(raised.value)
    assert list(tmp_path.iterdir()) == []


def test_without_a_compiler_it_says_so(tmp_path, monkeypatch):
    from torchid.export import checks

    monkeypatch.setattr(checks.shutil, "which", lambda name: None)
    (found,) = exported(with_other(arm("3r")), "c", tmp_path).comparisons
    assert found.difference is None
    assert "not compiled" in found.note


@pytest.mark.parametrize(
    ("name", "taken"), [("ur10e", "ur10e"), ("3r", "robot_3r"), ("my arm-2", "my_arm_2")]
)
def test_names_are_identifiers(name, taken):
    assert identifier(name) == taken


def test_a_joint_that_stands_still(tmp_path):
    """sign(0) is 0, as in the library."""
    robot = with_other(arm("3r"), effects=ALL)
    dynamics = Dynamics(
        robot.with_parameters(InertialParameters(robot.parameters.pi)), "robot", "t"
    )
    q = torch.zeros(1, 3, dtype=torch.float64)
    motion = Motion(q, q, q)
    found = check_c(c_file(dynamics, "still"), "still", motion, dynamics.torque(motion))
    assert found.difference <= 1e-12
