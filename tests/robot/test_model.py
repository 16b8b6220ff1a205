"""Other limits of a robot: how they may be given, and what none are."""

import numpy as np
import pytest
import torch

from torchid.errors import TorchidError
from torchid.robot.library import load_robot


@pytest.mark.parametrize("given", [2.0, [2.0] * 3, np.full(3, 2.0), [[-2.0, 2.0]] * 3])
def test_limits_are_numbers_of_any_form(given: object) -> None:
    robot = load_robot("3r")
    changed = robot.with_limits(acceleration=given).limits  # type: ignore[arg-type]
    assert changed.acceleration is not None
    assert changed.acceleration.tolist() == [[-2.0, 2.0]] * 3
    assert changed.velocity is robot.limits.velocity


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("acceleration", 0.0),
        ("acceleration", float("nan")),
        ("velocity", [1.0, 2.0]),
        ("velocity", [1.0, -2.0, 1.0]),
        ("position", [1.0, 2.0, 3.0]),
        ("torque", "strong"),
        ("speed", 1.0),
    ],
)
@pytest.mark.usefixtures("types_unchecked")
def test_what_is_no_limit_is_refused(name: str, given: object) -> None:
    robot = load_robot("3r")
    with pytest.raises(TorchidError, match=name):
        robot.with_limits(**{name: given})  # type: ignore[arg-type]
    assert torch.isfinite(robot.limits.velocity).all()
