"""The corrected model in Python: of files, results and servos."""

from pathlib import Path

import numpy as np
import pytest
import torch

import torchid
from tests.export.test_randomise import found  # noqa: F401
from torchid.dynamics.forward import bias_torque, mass_matrix
from torchid.effects.model import ArmModel
from torchid.effects.servo import INDEX
from torchid.errors import TorchidError
from torchid.export.model import ServoModel
from torchid.gap.record import GapRecord
from torchid.position.model import ServoArm
from torchid.simulation.servo import Servos

DT = 0.002


@pytest.mark.slow
def test_a_diagnosis_is_its_corrected_model_and_draws_of_it(
    found: GapRecord,  # noqa: F811
    tmp_path: Path,
) -> None:
    found.save(tmp_path / "gap.json")
    found.write_corrected(tmp_path / "corrected.yaml")
    files = (tmp_path / "gap.json", tmp_path / "corrected.yaml")
    model, *others = [torchid.load_model(one) for one in (found, *files)]
    assert isinstance(model, ArmModel)
    n = model.nominal.n
    t = torch.arange(50, dtype=torch.float64).unsqueeze(1) / 50
    motion = [torch.sin((k + 1) * t) * torch.ones(n) for k in range(3)]
    tau = model.torque(*motion)
    for other in others:
        torch.testing.assert_close(other.torque(*motion), tau, rtol=1e-12, atol=1e-12)
    drawn = model.sample(3, seed=2)
    assert len(drawn) == 3
    taus = [one.torque(*motion) for one in drawn]
    assert all(0 < float((x - tau).abs().max()) < float(tau.abs().max()) for x in taus)
    torch.testing.assert_close(
        model.sample(1, seed=2)[0].pi, model.sample(1, seed=2)[0].pi, rtol=1e-12, atol=1e-12
    )
    # The file says how sure it is, too.
    (one,) = others[1].sample(1)
    assert 0 < float((one.torque(*motion) - tau).abs().max()) < float(tau.abs().max())


def servo_arm(**values: float) -> ServoArm:
    return ServoArm.of("3r", kp=80.0, kd=1.0, damping=2.0, armature=0.2, delay=0.01, **values)


def commands() -> tuple[torch.Tensor, torch.Tensor]:
    t = DT * torch.arange(600, dtype=torch.float64)
    return t, 0.5 * torch.sin(t.unsqueeze(1) * torch.tensor([3.0, 4.0, 5.0]).double())


@pytest.mark.slow
@pytest.mark.parametrize(
    "values", [{}, {"coulomb": 0.5}, {"load_share": 0.2}, {"clip": 8.0}], ids=str
)
def test_the_torque_of_servos_moves_links_and_rotors(values: dict[str, float]) -> None:
    """Along its own replay: M ddq + armature ddq + bias, while joints move."""
    arm, (t, u) = servo_arm(**values), commands()
    model = torchid.load_model(arm)
    assert isinstance(model, ServoModel)
    q = model.replay(torchid.Log(t, q=u, u=u)).simulated[0].q
    dq, ddq = torch.zeros_like(q), torch.zeros_like(q)
    dq[1:-1], ddq[1:-1] = (q[2:] - q[:-2]) / (2 * DT), (q[2:] - 2 * q[1:-1] + q[:-2]) / DT**2
    mass = mass_matrix(arm.robot, q) + torch.diag(arm.servos.of("armature"))
    needed = (mass @ ddq.unsqueeze(-1)).squeeze(-1) + bias_torque(arm.robot, q, dq)
    given = model.torque(q, dq, u, t)
    moves = (dq.abs() > 0.05).all(1)
    moves[:50] = moves[-5:] = False
    assert int(moves.sum()) > 100
    missed = (given - needed)[moves]
    assert float(missed.square().mean().sqrt()) < 0.03 * float(needed[moves].square().mean().sqrt())


def test_servos_of_a_batch_and_their_gradients() -> None:
    model, (t, u) = torchid.load_model(servo_arm()), commands()
    assert isinstance(model, ServoModel)
    q, dq, u, t = 0.9 * u[:30] + 0.01, torch.cos(u[:30]), u[:30], t[:30]
    both = model.torque(*(torch.stack([x, 0.5 * x]) for x in (q, dq, u)), t)
    assert both.shape == (2, 30, 3)
    torch.testing.assert_close(both[0], model.torque(q, dq, u, t))
    torch.testing.assert_close(both[1], model.torque(0.5 * q, 0.5 * dq, 0.5 * u, t))
    assert model.torque(q.float(), dq.float(), u.float(), t).dtype is torch.float32
    model.requires_grad_()
    model.torque(q.requires_grad_(), dq, u, t).sum().backward()
    assert q.grad is not None
    torch.testing.assert_close(q.grad, torch.full_like(q, -80.0))
    assert model.joint.grad is not None
    assert bool((model.joint.grad[:, INDEX["kp"]] != 0).all())


def test_servos_of_a_file(tmp_path: Path) -> None:
    arm, (_, u) = servo_arm(), commands()
    arm.write(tmp_path / "servos.yaml")
    model = torchid.load_model(tmp_path / "servos.yaml")
    assert isinstance(model, ServoModel)
    assert torch.equal(model.arm.servos.joint, arm.servos.joint)
    assert "3r" in repr(model)
    with pytest.raises(TorchidError, match="what it was commanded"):
        model.torque(u, u)
    with pytest.raises(TorchidError, match="what it was commanded") as told:
        model.torque(u, u, u)
    assert told.value.got == "no times"
    with pytest.raises(TorchidError, match="do not fit"):
        model.torque(u, u, u, np.arange(3.0))
    with pytest.raises(TorchidError, match="does not say how sure"):
        model.sample(2)
    assert isinstance(model.arm.servos, Servos)
