"""Compliance from link-side encoders: against the flexible-joint model with motors of no mass, in
which the spring carries what a rigid body takes along the link's motion."""

import pytest
import torch

from tests.gap.motions import ROBOT, motion_at, noise, times
from torchid.design.deflection import Compliance, compliance
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.gap.settings import GapSettings
from torchid.gap.torque import diagnose_torque
from torchid.log.model import Log
from torchid.typing import Tensor

pytestmark = pytest.mark.usefixtures("types_unchecked")

SOFT = 2e-4
RESOLUTION = 2e-5
JOINT = 1


def seen(c: float, seed: int = 0, errors: float = 0.0) -> Compliance | None:
    """Of a joint with compliance c, encoder noise, and an encoder of this zero and eccentricity."""
    generator = torch.Generator().manual_seed(seed)
    motion = motion_at(times())
    load = inverse_dynamics(ROBOT, *motion.state)[:, JOINT]
    q = motion.q[:, JOINT]
    lag = c * load + errors * (1 + torch.sin(q) + 0.3 * q)
    lag = lag + RESOLUTION * noise(len(q), 1, generator, 2.0)[:, 0]
    return compliance(lag, load, q, [slice(0, len(q))])


@pytest.mark.nightly
@pytest.mark.parametrize("errors", [0.0, 3e-3])
def test_a_compliance_is_found_beside_the_encoders_own_errors(errors: float):
    found = [seen(SOFT, seed, errors) for seed in range(40)]
    assert all(f is not None and f.explained > 0.5 for f in found)
    z = torch.tensor([(f.value - SOFT) / f.std for f in found if f is not None])
    assert float(z.square().mean().sqrt()) < 1.6  # noise of 2 Hz is not taken for white
    assert float(z.abs().median()) > 0.2


def test_a_stiff_joint_has_none():
    found = [seen(0.0, seed) for seed in range(20)]
    assert max(f.explained for f in found if f is not None) < 0.05


def test_a_torque_that_is_an_encoders_error_tells_nothing():
    q = times(5.0)
    assert compliance(0.1 * q, 3.0 * q + 1.0, q, [slice(0, len(q))]) is None


def flexible(c: float) -> Log:
    """A log of both encoders of an arm with one soft joint, and noisy torque."""
    generator = torch.Generator().manual_seed(3)
    t = times(24.0)
    link = motion_at(t)
    tau = inverse_dynamics(ROBOT, *link.state)

    def encoder(q: Tensor) -> Tensor:
        return q + RESOLUTION * noise(len(t), 3, generator)

    motor = link.q.clone()
    motor[:, JOINT] += c * tau[:, JOINT]
    sensed = tau + 0.1 * tau.std(0) * noise(len(t), 3, generator)
    return Log(t, encoder(motor), tau=sensed, ql=encoder(link.q))


def named(found: TorqueDiagnosis) -> list[tuple[str, tuple[int, ...]]]:
    return [(f.effect, f.at) for f in found.which]


@pytest.mark.nightly
def test_a_link_side_encoder_shows_what_torques_do_not():
    log, settings = flexible(SOFT), GapSettings()
    found = diagnose_torque(ROBOT, log, settings=settings)
    assert named(found) == [("joint_elasticity", (JOINT,))]
    (finding,) = found.which
    assert abs(finding.sizes[0].value / SOFT - 1) < 0.03
    assert abs(finding.sizes[0].value - SOFT) < 4 * finding.sizes[0].std
    assert finding.ambiguous_with == ()
    assert found.status == "explained"
    assert "encoders of motor and link" in " ".join(finding.notes)
    # The torques alone do not show it.
    assert named(diagnose_torque(ROBOT, log.replace(ql=None), settings=settings)) == []
    assert named(diagnose_torque(ROBOT, flexible(0.0), settings=settings)) == []


def test_encoders_that_agree_exactly_tell_nothing():
    motion = motion_at(times())
    load = inverse_dynamics(ROBOT, *motion.state)[:, JOINT]
    q = motion.q[:, JOINT]
    assert compliance(torch.zeros_like(q), load, q, [slice(0, len(q))]) is None
