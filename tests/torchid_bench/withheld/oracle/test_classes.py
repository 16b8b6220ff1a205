"""What an oracle that knows the torque of each effect says of small logs."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
import torch

from tests.arms import arm
from torchid.effects.registry import effect_from_record, model_torque
from torchid.log.model import Log
from torchid_bench.withheld.oracle.classes import (
    Class,
    Truth,
    already_there,
    class_of,
    ideally,
    in_practice,
    ranked,
)
from torchid_bench.withheld.oracle.library import Half, grouped, half_of, left_open, library

FAMILIES = "speed", "constant", "sign"
"""Of the rivals: a small library."""


@pytest.mark.parametrize(
    ("share", "nothing", "rival", "expected"),
    [
        (0.009, 50.0, 50.0, "below"),
        (0.02, 5.0, 50.0, "undecidable"),
        (0.02, 6.0, 3.0, "ambiguous"),
        (0.02, 6.0, 3.1, "decidable"),
    ],
)
def test_classes(share: float, nothing: float, rival: float, expected: str) -> None:
    assert class_of(share, nothing, rival) == expected


Torque = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]
"""Of positions and velocities (T, n)."""


class Arm:
    """A 3r that moves for six seconds with noise of .02 N m."""

    def __init__(self) -> None:
        self.robot, t = arm("3r"), torch.arange(0, 6, 0.01, dtype=torch.float64)
        phase = 2 * torch.pi * t.unsqueeze(1) * torch.tensor([[0.35, 0.5, 0.8]]).double()
        q = torch.sin(phase) * torch.tensor([0.8, 0.7, 0.9]).double()
        still = Log(t, q, tau=q)
        motion = half_of(self.robot, still).columns.samples.segments[0].motion
        self.motion = motion._replace(torque=model_torque(self.robot, [], motion))
        self.t = t
        g = torch.Generator().manual_seed(0)
        noise = 0.02 * torch.randn(q.shape, generator=g, dtype=torch.float64)
        tau = self.on_stamps(self.motion.require("torque", "a test")) + noise
        self.log = still.replace(tau=tau)
        self.bare = half_of(self.robot, self.log)
        kept = [c for c in library(self.bare) if c.effects[0].family in FAMILIES]
        self.bare.__dict__["library"] = grouped(kept)

    def on_stamps(self, x: torch.Tensor) -> torch.Tensor:
        grid = self.motion.require("t", "a test")
        at, t = (grid - grid[0]).numpy(), self.t.numpy()
        return torch.from_numpy(np.stack([np.interp(t, at, c) for c in x.T.numpy()], 1))

    def half(self, *torques: torch.Tensor) -> Half:
        """The log with torques at its stamps."""
        assert self.log.tau is not None
        tau = self.log.tau + sum(torques)
        return half_of(self.robot, self.log.replace(tau=tau), like=self.bare)

    def effect(self, record: dict[str, object]) -> torch.Tensor:
        """Torque (T, n) of an effect."""
        effect, values = effect_from_record(record, self.robot)
        return self.on_stamps(effect.all_torques(self.motion, values, self.robot))

    def asked(self, *records: dict[str, object]) -> tuple[list[Class], list[Class]]:
        """Classes of planted effects: in practice, and where the rest is known."""
        torques = [self.effect(r) for r in records]
        planted = self.half(*torques)
        truths = [
            Truth.of([str(r["effect"])], [int(str(r["joint"])) - 1], planted, self.half(*others))
            for k, r in enumerate(records)
            for others in [torques[:k] + torques[k + 1 :]]
        ]
        there: list[list[dict[str, object]]] = []
        return in_practice(planted, self.bare, truths, there), ideally(planted, self.bare, truths)


@pytest.fixture(scope="module")
def three() -> Arm:
    return Arm()


def test_what_is_plainly_there_is_decidable(three: Arm) -> None:
    for (found,) in three.asked({"effect": "torque_offset", "joint": 2, "F0": 0.5}):
        assert found["class"] == "decidable"
        assert found["over_nothing"] > 20


def test_what_is_not_there_is_below(three: Arm) -> None:
    for (found,) in three.asked({"effect": "torque_offset", "joint": 2, "F0": 1e-6}):
        assert found["class"] == "below"
        assert found["over_nothing"] < 5


def test_what_the_model_leaves_open_is_known_ideally_alone(three: Arm) -> None:
    """Base parameters that nobody vouches for take the place of a rotor's inertia."""
    assert left_open(three.bare).columns.shape[1] > 5
    (practice,), (ideal,) = three.asked({"effect": "rotor_inertia", "joint": 1, "Ia": 0.5})
    assert practice["over_nothing"] < 3
    assert ideal["over_nothing"] > 20


def test_each_of_two_effects_is_judged_beside_the_other(three: Arm) -> None:
    """A large spring hides a small friction on its joint, were its torque not known."""
    small = {"effect": "coulomb_friction", "joint": 3, "Fc": 0.02}
    large = {"effect": "joint_spring", "joint": 3, "k": 2.0, "c0": 0.0, "curvature": 0.0}
    both = three.asked(small, large)[1]
    assert [one["class"] for one in both] == ["decidable", "decidable"]
    torques = [three.effect(r) for r in (small, large)]
    planted, other = three.half(*torques), three.half(torques[1])
    truth = Truth.of(["coulomb_friction"], [2], planted, other)
    (alone,) = in_practice(planted, three.bare, [truth], [])
    assert alone["over_nothing"] < both[0]["over_nothing"] - 5


def test_a_law_of_no_library_is_held_against_the_library(three: Arm) -> None:
    """A drag by the square of the speed has rivals of other names, and none of its own."""
    dq = three.on_stamps(three.motion.dq)
    drag = torch.zeros_like(dq)
    drag[:, 1] = 0.1 * dq[:, 1] * dq[:, 1].abs()
    planted = three.half(drag)
    truth = partial(Truth.of, joints=[1], planted=planted, without=three.bare)
    (own,) = ideally(planted, three.bare, [truth(["air_drag"])])
    assert own["over_nothing"] > 20
    assert own["rivals"][0][:2] == ["power_law_friction", [2]]
    # Where the honest answer is a family, its members are no rivals.
    (near,) = ideally(planted, three.bare, [truth(["air_drag", "speed"])])
    assert near["over_rival"] > own["over_rival"] + 10


def test_what_the_coefficients_of_a_law_could_be_is_paid_for(three: Arm) -> None:
    """A friction that differs by direction may do so at rest or with speed: that the oracle knows
    which makes the friction no surer than its law is."""
    record = {"effect": "asymmetric_friction", "joint": 2, "dF": 0.1, "dFv": 0.0}
    planted = three.half(three.effect(record))
    one, other = (
        ideally(planted, three.bare, [Truth.of([name], [1], planted, three.bare)])[0]
        for name in (str(record["effect"]), "of no library")
    )
    assert one["over_nothing"] < other["over_nothing"] - 0.5


def test_what_was_there_before_is_found_and_fitted_beside(three: Arm) -> None:
    old = three.half(three.effect({"effect": "torque_offset", "joint": 2, "F0": 0.5}))
    found = already_there(old)
    assert [r["effect"] for records in found for r in records][:1] == ["torque_offset"]


def test_halves_of_one_motion_have_one_library(three: Arm) -> None:
    assert three.half(torch.zeros(1, 3).double()).library is three.bare.library
    moved = three.log.replace(q=three.log.q + 0.1)
    assert half_of(three.robot, moved, like=three.bare).alike is None


def test_products_with_a_base_that_grew_are_those_of_the_whole(three: Arm) -> None:
    base, rows = left_open(three.bare), three.bare.gap.rows
    crosses: dict[int, np.ndarray] = {}
    first = ranked(three.bare, base, three.bare.library, rows, crosses)[0]
    more = base.with_(first.scaled(three.bare)[0])
    known = ranked(three.bare, more, three.bare.library, rows, crosses)
    assert known == ranked(three.bare, more, three.bare.library, rows)
    assert {x.shape[1] for x in crosses.values()} == {more.columns.shape[1]}
