"""What a diagnosis says of a changed link."""

import torch

from torchid.gap.diagnosis import body_change
from torchid.robot.inertia import InertialParameters


def body(mass: float, com: list[float], inertia: float) -> InertialParameters:
    about = inertia * torch.tensor([1, 0, 0, 1, 0, 1], dtype=torch.float64)
    own = InertialParameters.from_com(
        torch.tensor([mass]).double(), torch.tensor([com]).double(), about[None]
    )
    return InertialParameters(own.pi[0])


def test_a_changed_link_says_its_body_before_and_after() -> None:
    said = body_change(body(1.2, [0.1, 0.0, 0.0], 0.02), body(1.5, [0.12, 0.0, 0.01], 0.03))
    assert said == (
        "Set the link's mass 1.2 -> 1.5 kg, its centre of mass (0.1, 0, 0) -> (0.12, 0, 0.01) m, "
        "its inertia about it (xx, yy, zz) (0.02, 0.02, 0.02) -> (0.03, 0.03, 0.03) kg m²."
    )


def test_numbers_without_a_mass_have_first_moments() -> None:
    none = InertialParameters(torch.tensor([0, 0.1, 0, 0, 0.02, 0, 0, 0.02, 0, 0.02]).double())
    said = body_change(none, body(1.5, [0.2, 0.0, 0.0], 0.03))
    assert "first moment (0.1, 0, 0) -> (0.3, 0, 0) kg m" in said
    assert "about the link's frame (xx, yy, zz) (0.02, 0.02, 0.02)" in said
