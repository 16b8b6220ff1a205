"""float64 whatever torch's default dtype is: users have float32."""

from collections.abc import Callable, Iterator

import pytest
import torch

import torchid
from torchid.effects.base import JointEffect, Motion
from torchid.effects.instants import shifted
from torchid.effects.registry import KINDS
from torchid.export.dynamics import random_states
from torchid.robot.jacobian import tool_jacobian
from torchid.statistics.random_effects import Sessions, heterogeneity

ROBOT = torchid.load_robot("3r")
SHAPED = [n for n, kind in KINDS.items() if issubclass(kind, JointEffect) and kind.shapes]


@pytest.fixture(autouse=True)
def default_restored() -> Iterator[None]:
    before = torch.get_default_dtype()
    yield
    torch.set_default_dtype(before)


def both(make: Callable[[], torch.Tensor]) -> tuple[torch.Tensor, torch.Tensor]:
    """What it makes under either default."""
    found = []
    for dtype in (torch.float32, torch.float64):
        torch.set_default_dtype(dtype)
        found.append(make())
    return found[0], found[1]


def motion() -> Motion:
    t = torch.arange(200, dtype=torch.float64) / 100
    angle = t.unsqueeze(1) * torch.tensor([1.9, 2.7, 3.3], dtype=torch.float64)
    q = torch.sin(angle)
    return Motion(q, 2 * torch.cos(angle), -4 * q, t=t, torque=10 * q)


def columns_of(name: str) -> torch.Tensor:
    """With shapes that float32 cannot hold."""
    kind = KINDS[name]
    shapes = {s.name: s.grid[0] * 1.1 + 0.01 for s in kind.shapes}
    return kind(1, **shapes).columns(motion())


CASES: dict[str, Callable[[], torch.Tensor]] = {
    "delay": lambda: shifted(motion().q, motion().require("t", "a test"), 0.0123),
    "tool": lambda: tool_jacobian(torchid.load_robot("panda"), torch.ones(7).double()),
    "heterogeneity": lambda: heterogeneity(
        Sessions(motion().q[:9], 1 + motion().q[:9].square(), torch.arange(3)),
        torch.full((3,), 4.0, dtype=torch.float64),
    ),
    "random states": lambda: torch.cat(random_states(ROBOT, 0, 20).state),
    "lists": lambda: torchid.inverse_dynamics(ROBOT, [0.1, 0.2, 0.3], [0.1] * 3, [0.1] * 3),
    "log": lambda: torchid.Log([0.0, 0.1], [[0.1], [0.2]]).q,
    **{name: lambda name=name: columns_of(name) for name in SHAPED},  # type: ignore[misc]
}


@pytest.mark.usefixtures("types_unchecked")
@pytest.mark.parametrize("name", CASES)
def test_the_default_dtype_changes_no_digit(name) -> None:
    single, double = both(CASES[name])
    assert single.dtype is torch.float64
    torch.testing.assert_close(single, double, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
def test_an_identification_does_not_depend_on_it() -> None:
    t = torch.arange(1000, dtype=torch.float64) / 100
    w = torch.tensor([1.9, 2.7, 3.3], dtype=torch.float64)
    q, dq, ddq = (f(t[:, None] * w) * w**k for k, f in
                  ((0, torch.sin), (1, torch.cos), (2, lambda x: -torch.sin(x))))  # fmt: skip
    log = torchid.Log(t, q, dq=dq, tau=torchid.inverse_dynamics(ROBOT, q, dq, ddq))
    settings = torchid.Settings(cutoff=5.0, effects=("coulomb_friction",))
    single, double = both(lambda: torchid.identify(ROBOT, log, settings=settings).values)
    assert torch.allclose(single, double, rtol=1e-9, atol=1e-12)
