"""Arrays and lists wherever the public functions take tensors; float32 beside float64."""

import numpy as np
import pytest
import torch

import torchid
from torchid.errors import RobotError, TorchidError
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Limits
from torchid.tensors import as_tensor, joint_signals

ROBOT = torchid.load_robot("3r")
Q = [[0.1, 0.2, 0.3], [0.4, -0.5, 0.6]]

pytestmark = pytest.mark.usefixtures("types_unchecked")


def tensor(values: object) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


FORMS = {
    "lists": lambda x: x,
    "tuples": lambda x: tuple(map(tuple, x)),
    "array": np.array,
    "strided array": lambda x: np.array([x, x]).transpose(1, 2, 0)[..., 0],
    "reversed array": lambda x: np.array(x[::-1])[::-1],
    "read-only array": lambda x: np.broadcast_to(np.array(x), (2, 3)),
    "list of arrays": lambda x: [np.array(row) for row in x],
    "list of tensors": lambda x: [tensor(row) for row in x],
    "big-endian array": lambda x: np.array(x).astype(">f8"),
}


SIGNALS = {
    "inverse_dynamics": 3, "joint_wrenches": 3, "forward_dynamics": 3, "regressor": 3,
    "mass_matrix": 1, "tool_pose": 1,
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("function", SIGNALS)
def test_dynamics_of_any_form_are_those_of_tensors(function, form) -> None:
    call, count = getattr(torchid, function), SIGNALS[function]
    found = call(ROBOT, *[FORMS[form](Q)] * count)
    assert found.dtype is torch.float64
    torch.testing.assert_close(found, call(ROBOT, *[tensor(Q)] * count), rtol=1e-12, atol=1e-12)
    assert call(ROBOT, *[np.array(Q, np.float32)] * count).dtype is torch.float64
    with pytest.raises(TorchidError, match="one column a joint"):
        call(ROBOT, *[FORMS[form](Q)[0][:2]] * count)


@pytest.mark.parametrize("function", ["inverse_dynamics", "regressor"])
def test_one_dtype_for_all_signals(function) -> None:
    """The widest of what is given; float32 alone stays the caller's choice."""
    call, single = getattr(torchid, function), tensor(Q).float()
    assert call(ROBOT, single, single, single).dtype is torch.float32
    for given in (tensor(Q), np.array(Q), Q):
        mixed = call(ROBOT, single, given, given)
        assert mixed.dtype is torch.float64
        torch.testing.assert_close(
            mixed, call(ROBOT, single.double(), *[tensor(Q)] * 2), rtol=1e-12, atol=1e-12
        )


def test_integers_are_float64() -> None:
    rest = torchid.inverse_dynamics(
        ROBOT, [0, 0, 0], np.zeros(3, int), torch.zeros(3, dtype=torch.float64).long()
    )
    assert rest.dtype is torch.float64
    assert torch.equal(
        rest, torchid.inverse_dynamics(ROBOT, *[torch.zeros(3, dtype=torch.float64)] * 3)
    )


def test_gradients_pass_the_door() -> None:
    q = tensor(Q).requires_grad_()
    torchid.inverse_dynamics(ROBOT, q, Q, Q).sum().backward()
    assert q.grad is not None
    assert bool(q.grad.abs().max() > 0)


@pytest.mark.parametrize(
    ("q", "said"),
    [
        ([["a", "b", "c"]], "q must be a table of numbers"),
        ([[1.0, 2.0, 3.0], [1.0]], "q must be a table of numbers"),
        (None, "q must be a table of numbers"),
        ([[1j, 2.0, 3.0]], "q must be a table of numbers"),
        (torch.zeros(2, 3, dtype=torch.complex64), "real numbers"),
        ([[0.0, 1.0]], "one column a joint"),
        (3.0, "one column a joint"),
    ],
)
@pytest.mark.parametrize("function", ["inverse_dynamics", "regressor"])
def test_what_is_no_motion_is_one_message(function, q, said) -> None:
    with pytest.raises(TorchidError, match=said):
        getattr(torchid, function)(ROBOT, q, Q, Q)


@pytest.mark.parametrize("form", FORMS)
def test_a_log_of_any_form(form) -> None:
    given = FORMS[form](Q)
    log = torchid.Log([0.0, 0.1], given, dq=given, tau=given, trajectory=[0, 1])
    assert log.trajectory_count == 2
    assert log.trajectory.dtype is torch.int64
    for name in ("t", "q", "dq", "tau"):
        assert getattr(log, name).dtype is torch.float64
    assert torch.equal(log.q, tensor(Q))
    assert log.replace(ddq=given).ddq.dtype is torch.float64
    assert log.select([True, False]).samples == 1
    assert log.select(np.array([False, True])).samples == 1


def test_a_log_does_not_share_memory_with_an_array() -> None:
    q = np.array(Q)
    log = torchid.Log([0.0, 0.1], q)
    q[:] = 0
    assert torch.equal(log.q, tensor(Q))


def test_bodies_and_robots() -> None:
    body = InertialParameters.from_com([2.0], np.array([[0.5, 0.0, 0.0]]), [[0.0] * 6])
    assert body.pi.dtype is torch.float64
    assert body.pi[0, :2].tolist() == [2.0, 1.0]
    assert torch.equal(InertialParameters(body.pi.tolist()).pi, body.pi)
    assert Limits(velocity=[[-1.0, 1.0]]).velocity.shape == (1, 2)
    with pytest.raises(RobotError, match="limits of velocity"):
        Limits(velocity="fast")


def test_a_prediction_of_lists_keeps_all_digits() -> None:
    t = torch.arange(1000, dtype=torch.float64) / 100
    w = tensor([1.9, 2.7, 3.3])
    angle = t.unsqueeze(1) * w
    state = torch.sin(angle), w * torch.cos(angle), -(w**2) * torch.sin(angle)
    log = torchid.Log(t, *state[:2], tau=torchid.inverse_dynamics(ROBOT, *state))
    found = torchid.identify(ROBOT, log, settings=torchid.Settings(effects=(), cutoff=5.0))
    torch.testing.assert_close(
        found.predict(Q, Q, Q), found.predict(*[tensor(Q)] * 3), rtol=1e-12, atol=1e-12
    )
    torch.testing.assert_close(
        found.residual(Q, Q, Q, Q), tensor(Q) - found.predict(Q, Q, Q), rtol=1e-12, atol=1e-12
    )


def test_the_helpers_keep_what_is_a_tensor() -> None:
    given = torch.zeros(2, 3, dtype=torch.float64)
    assert as_tensor(given, "x") is given
    assert [x.dtype for x in joint_signals(3, a=given, b=Q)] == [torch.float64] * 2
