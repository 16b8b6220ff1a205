"""An effect is one class and its name: everything else follows from them.

The steps are those of CONTRIBUTING.md, followed here with an effect that exists nowhere else.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import pytest
import torch
from torch import Tensor

from docs.draw_effects import effect_text, family_figure
from tests.arms import arm
from tests.documents import ROOT, sources
from tests.export.arms import exported, with_other
from tests.simulation.bodies import bare, reference
from torchid.digits import number
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects import registry
from torchid.effects.base import Coefficient, Example, JointEffect, Motion
from torchid.effects.c_text import add
from torchid.effects.registry import KINDS, effect_from_record, model_torque, on_every_joint
from torchid.export.checks import compiler
from torchid.report.effects import effect_record
from torchid.simulation.closed_loop import closed_loop
from torchid.simulation.open_loop import rollout


@dataclass(frozen=True)
class AirDrag(JointEffect):
    """Torque of the air on a paddle: c |dq| dq."""

    name = "air_drag"
    family = "speed"
    coefficients = (Coefficient("c", "N m", True, "drag of the paddle"),)
    meaning = "A sail on the joint is slowed down by the air."
    equation = "c |dq| dq"
    signature = "grows with the square of the speed"
    experiment = "run the joint at full speed, with and without the sail"
    beyond = "take the sail off"
    remedy = "Take the sail off, or add its drag to the simulator."
    source = "Newton 1687, Principia, book II, section VII"
    example = Example((0.5,), "speed")

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Tensor:
        """|dq| dq."""
        return (motion.dq.abs() * motion.dq).unsqueeze(-1)

    def c_code(self, values: Sequence[float]) -> list[str]:
        """The equation as C."""
        speed = f"dq[{self.joint}]"
        return add(self.joint, f"{number(values[0])} * fabs({speed}) * {speed}")


NEW = ("position_dependent_friction", "motor_ripple")
"""Two that were added as CONTRIBUTING.md tells."""


@pytest.fixture
def registered(monkeypatch):
    """The line in the registry, and what the registry makes of it."""
    monkeypatch.setitem(KINDS, AirDrag.name, AirDrag)
    monkeypatch.setitem(registry.FAMILIES, AirDrag.name, AirDrag.family)
    monkeypatch.setitem(registry.COLUMN_KINDS, AirDrag.name, AirDrag)


@pytest.mark.slow
def test_the_catalogue_tells_it_and_finds_what_it_is_confused_with(registered):
    record = effect_record(AirDrag)
    assert record["equation"] == AirDrag.equation
    assert record["confused_with"][0] == "power_law_friction"
    text = effect_text(AirDrag)
    assert "[power_law_friction](#power_law_friction) exactly" in text  # its exponent 2
    assert "fitted by" not in text  # as most: by `identify` and `gap`
    assert "air_drag" in effect_record(KINDS["power_law_friction"])["confused_with"]


def test_its_picture_is_drawn(registered):
    titles = [axes.get_title() for axes in family_figure("speed").axes]
    assert "air_drag" in titles


def test_a_robot_file_names_it_and_its_columns_are_fitted(registered):
    robot = replace(arm("3r"), effects=({"effect": "air_drag", "joint": 2, "c": 0.7},))
    g = torch.Generator().manual_seed(3)
    q, dq, ddq = torch.randn(3, 50, 3, generator=g, dtype=torch.float64).unbind()
    motion = Motion(q, dq, ddq)
    gap = model_torque(robot, registry.nominal_effects(robot), motion) - inverse_dynamics(
        robot, q, dq, ddq
    )
    columns = torch.stack([e.torque_columns(motion) for e in on_every_joint(["air_drag"], 3)], -1)
    a = columns.reshape(-1, 3)
    found = torch.linalg.lstsq(a, gap.reshape(-1, 1)).solution.flatten()
    expected = torch.tensor([0.0, 0.7, 0.0], dtype=torch.float64)
    torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-9)


def test_a_simulated_arm_feels_it(registered):
    robot = bare("3r")
    law = effect_from_record({"effect": "air_drag", "joint": 2, "c": 3.0}, robot)
    (log,) = closed_loop(robot, [reference(robot, 0.3)], [[law]])
    motion = Motion(log.q, log.dq, log.ddq)
    rigid = inverse_dynamics(robot, *motion.state)
    expected = 3.0 * log.dq[:, 1].abs() * log.dq[:, 1]
    left = (log.tau - rigid)[:, 1] - expected
    assert float(expected.abs().max()) > 0.1
    assert float(left.abs().max()) < 1e-6 * float(log.tau.abs().max())


@pytest.mark.skipif(compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("name", ["air_drag", *NEW])
def test_its_c_code_equals_the_library(registered, tmp_path, name):
    effect = KINDS[name].exemplar(1)
    robot = with_other(arm("3r"), effects=(effect.record(effect.example.values),))
    done = exported(robot, "c", tmp_path)
    assert done.left_out == ()
    assert len(done.in_file) == 1
    assert done.comparisons[0].difference <= 1e-12


@pytest.mark.parametrize("name", NEW)
def test_those_added_so_are_simulated(name):
    """The torque of the motion is that of the model with the effect; what follows the torque takes
    that of the integrator's last step."""
    robot = bare("3r")
    law = (KINDS[name].exemplar(1), list(KINDS[name].example.values))
    (log,) = closed_loop(robot, [reference(robot, 0.3)], [[law]])
    motion = Motion(log.q, log.dq, log.ddq, t=log.t)
    tau = model_torque(robot, [law], motion)
    apart = (log.tau - tau)[:, 1].abs()
    moved = log.dq[:, 1].abs() > 0.01
    assert float(apart[moved].max()) < 1e-4 * float(log.tau.abs().max())
    assert float((log.tau - inverse_dynamics(robot, *motion.state))[moved].abs().max()) > 0.01
    again = rollout(
        robot, [law], log.q[:1], log.dq[:1], log.tau.unsqueeze(0), float(log.t[1] - log.t[0])
    )
    assert math.isfinite(float(again.q.abs().max()))


def test_no_other_source_file_knows_them():
    """But the withheld plant, which shares nothing with the library, and had a ripple before."""
    folder = ROOT / "torchid"
    others = [
        path.relative_to(ROOT).as_posix()
        for path in sources()
        if path.parent not in (folder / "effects", ROOT / "torchid_bench/withheld/plant")
        and any(word in path.read_text() for word in (*NEW, "MotorRipple", "PositionDependent"))
    ]
    assert others == []
    own = [path.name for path in (folder / "effects").glob("*.py") if NEW[1] in path.read_text()]
    assert sorted(own) == ["names.py", "periodic.py"]
    assert "MotorRipple" not in (folder / "effects" / "registry.py").read_text()
