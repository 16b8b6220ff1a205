"""Swinging links on a pendulum whose gear scipy integrates; and what is no swing."""

from pathlib import Path

import pytest
import torch

from tests.effects.two_masses import INERTIA, driven, gear_torque, pendulum
from tests.marks import some
from torchid.design.columns import Columns, Model
from torchid.design.resonance import Swing, swings, wiener
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.gear import Gear
from torchid.gap.data import prepare
from torchid.gap.settings import GapSettings
from torchid.gap.torque import diagnose_torque
from torchid.log.filtering import low_passed
from torchid.log.model import Log
from torchid.robot.model import Robot

pytestmark = pytest.mark.usefixtures("types_unchecked")

RATE, SECONDS = 250.0, 16.0
HERTZ = [0.3, 0.9, 2.1, 4.3, 6.7, 9.1, 11.9, 15.3, 19.1]
SIZES = [0.5, 0.2, 0.04, 0.01, 4e-3, 2e-3, 1e-3, 5e-4, 3e-4]


def logged(folder: Path, hertz: float | None, late: int = 0, seed: int = 0) -> tuple[Robot, Log]:
    """A log of the motor, the gear elastic or rigid, the torque late by some samples."""
    robot = pendulum(folder)
    motion, at = driven(SIZES, HERTZ, SECONDS, RATE)
    assert motion.t is not None
    if hertz is None:
        torque = inverse_dynamics(robot, *motion.state)[:, 0]
    else:
        gear = Gear.ringing(INERTIA, hertz, 0.05)
        torque = gear_torque(at, motion.t, float(gear.stiffness[0]), float(gear.damping[0]))
    if late:
        torque = torch.cat([torque[:1].expand(late), torque[:-late]])
    g = torch.Generator().manual_seed(seed)
    noise = torch.randn(2, len(torque), 1, generator=g, dtype=torch.float64)
    return robot, Log(
        motion.t, motion.q + 2e-6 * noise[0], tau=torque.unsqueeze(1) + 0.05 * noise[1]
    )


def seen(robot: Robot, log: Log) -> dict[int, Swing]:
    data = prepare(robot, log, None)
    return swings(Columns(Model(robot, ()), data.samples), data.keep, 0.01)


@pytest.mark.parametrize("hertz", some([9.0, 14.0], slow=1, quick=1))
def test_a_resonance_tells_the_compliance(tmp_path: Path, hertz: float) -> None:
    found = seen(*logged(tmp_path, hertz))
    assert set(found) == {0}
    true = 1 / float(Gear.ringing(INERTIA, hertz, 0.05).stiffness[0])
    assert found[0].value == pytest.approx(true, rel=0.1)
    assert found[0].std > 0.1 * found[0].value  # the inertia that swings is not known better
    assert found[0].explained > 0.5
    assert found[0].size > 0.1


@pytest.mark.nightly
@pytest.mark.parametrize("late", [0, 1, 4])
def test_a_rigid_joint_does_not_swing(tmp_path: Path, late: int) -> None:
    assert seen(*logged(tmp_path, None, late)) == {}


def test_the_diagnosis_names_it(tmp_path: Path) -> None:
    robot, log = logged(tmp_path, 10.0)
    settings = GapSettings(effects=("joint_elasticity", "viscous_friction"))
    found = diagnose_torque(robot, log, settings=settings)
    assert [f.effect for f in found.which] == ["joint_elasticity"]
    assert any("swings" in note for note in found.which[0].notes)


def test_what_is_noise_is_taken_out() -> None:
    g = torch.Generator().manual_seed(1)
    rough, other = torch.randn(2, 5000, generator=g, dtype=torch.float64)
    signal = 5 * low_passed(other, RATE, 8.0)
    spectrum = torch.fft.rfft(rough) * torch.fft.rfftfreq(5000, 1 / RATE) ** 2
    noise = torch.fft.irfft(1e-4 * spectrum, n=5000)
    smooth = wiener([signal + noise], RATE, 40.0)
    assert float((smooth(signal) - signal)[200:-200].norm()) < 0.1 * float(signal.norm())
    assert float(smooth(noise)[200:-200].norm()) < 0.3 * float(noise.norm())
