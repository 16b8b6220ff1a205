"""Functions on tensors as straight-line code: the same values on floats and on arrays."""

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.arms import arm, states
from torchid.dynamics.forward import Components
from torchid.dynamics.straight_line import NoStraightLineError, Opaque, straight_line
from torchid.dynamics.world_frame import arms_of


def _values(function, *inputs: Tensor) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # type: ignore[no-untyped-def]
    """Of the function, of its code on floats, and on arrays: elements (B, E) each."""
    code = straight_line(function, [x[:1] for x in inputs])
    many = len(inputs[0])
    elements = torch.cat([x.reshape(many, -1) for x in inputs], 1)
    floats = np.array([code.on_floats(*row) for row in elements.tolist()], dtype=float)
    arrays = code.on_arrays(*elements.T.contiguous().numpy())
    wanted = torch.cat([x.reshape(many, -1) for x in function(*inputs)], 1)
    together = np.stack([np.broadcast_to(e, many) for e in arrays], 1).astype(float)
    return wanted.double().numpy(), floats, together


def _moves(x: Tensor, y: Tensor) -> list[Tensor]:
    """Views, stacks, sums and writing in place."""
    z = torch.stack([x, y.flip(-1)], -1).transpose(-1, -2)
    w = z.clone()
    w[..., 0, :] -= 2.0 * y
    out = torch.zeros_like(x)
    out[..., 1] = x[..., 0] * 3.0
    return [z.flatten(1), w.sum(1), out, torch.cat([x, y], -1)[:, 1:5:2], z.amax(1)]


def _chooses(x: Tensor, y: Tensor) -> list[Tensor]:
    """Comparisons, signs and functions."""
    chosen = torch.where((x > y) & (y < 0.5), x.sin(), torch.expm1(-x.abs()))
    bounded = torch.maximum(x, y).clamp(-0.3, 0.4) + torch.sign(x) * x.abs() ** 1.5
    grown = x.sinh() - y.cosh() + x.tanh()
    return [
        chosen,
        bounded,
        grown,
        (x > 0).to(x),
        torch.linalg.vector_norm(x, dim=-1),
        x / (1 + y * y),
    ]


@pytest.mark.parametrize("function", [_moves, _chooses])
def test_values_are_those_of_the_function(function) -> None:  # type: ignore[no-untyped-def]
    draw = torch.Generator().manual_seed(2)
    inputs = torch.randn(2, 9, 3, generator=draw, dtype=torch.float64)
    wanted, floats, arrays = _values(function, *inputs)
    np.testing.assert_allclose(floats, wanted, rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(arrays, wanted, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("name", ["3r", "mixed"])
def test_the_recursion_as_code_is_the_batched_dynamics(name: str) -> None:
    robot = arm(name)
    q, dq, _ = states(robot, 5)

    def dynamics(q: Tensor, dq: Tensor) -> list[Tensor]:
        posture = Components(robot).at(q)
        return [posture.mass_matrix(), posture.torque(dq)]

    _, floats, arrays = _values(dynamics, q, dq)
    posture = arms_of([robot], q).at(q)
    wanted = torch.cat([posture.mass_matrix().flatten(1), posture.torque(dq)], 1).numpy()
    scale = np.abs(wanted).max()
    assert np.abs(floats - wanted).max() < 1e-12 * scale
    assert np.abs(arrays - wanted).max() < 1e-12 * scale


def test_what_vanishes_and_what_is_twice_is_computed_never_and_once() -> None:
    x = torch.ones(1, 2, dtype=torch.float64)
    zero = torch.zeros_like(x)
    code = straight_line(lambda x: [x * zero + (x * x + x * x) * 1.0 + zero], [x])
    assert code.source.count("*") == 2  # one square an element
    assert "0.0" not in code.source


@pytest.mark.parametrize(
    "function",
    [
        lambda x: [x if bool((x > 0).all()) else -x],
        lambda x: [x * float(x.sum())],
        lambda x: [torch.linalg.inv(x.unsqueeze(-1) * x.unsqueeze(-2) + torch.eye(3))],
    ],
)
def test_branches_and_unknown_kernels_have_no_straight_form(function) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(NoStraightLineError):
        straight_line(function, [torch.ones(1, 3, dtype=torch.float64)])


def test_a_function_that_branches_is_called_as_a_whole() -> None:
    def twice(x: Tensor) -> Tensor:
        return 2 * x if bool((x > 0).all()) else x

    opaque = Opaque(twice, lambda x: [2 * v for v in x], lambda x: [2 * v for v in x])
    code = straight_line(lambda x: [opaque(x + 1.0) * 3.0], [torch.ones(1, 2, dtype=torch.float64)])
    assert code.on_floats(1.0, 2.0) == (12.0, 18.0)
    assert [float(e[0]) for e in code.on_arrays(np.ones(1), np.ones(1))] == [12.0, 12.0]


def test_infinities_are_errors_on_floats() -> None:
    code = straight_line(lambda x: [1.0 / x], [torch.ones(1, 1, dtype=torch.float64)])
    with pytest.raises(ArithmeticError):
        code.on_floats(0.0)
