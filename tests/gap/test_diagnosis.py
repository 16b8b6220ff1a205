"""What a diagnosis says of a changed link, and torque over time as columns."""

import csv
from pathlib import Path

import pytest
import torch

from torchid.effects.motion import Motion
from torchid.gap.cause_records import body_change
from torchid.gap.diagnosis import TorqueOverTime, Trace, alien_joints
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


@pytest.mark.parametrize(
    ("left", "alien"),
    [
        ([1.5, 1.5, 1.5], [True, True, True]),
        ([1.5, 1.5, 0.5], [True, True, False]),  # a joint that the corrected model follows
        ([1.5, 0.5, 0.5], [False, False, False]),  # most do
    ],
)
def test_torque_is_alien_where_it_follows_neither_model_on_most_joints(
    left: list[float], alien: list[bool]
) -> None:
    """The model as given errs by twice the torque, the corrected one by so much of it."""
    traces = []
    for rows in (40, 70):
        torque = torch.sin(torch.arange(3 * rows).double()).reshape(rows, 3)
        motion = Motion(torque, torque, torque)
        before, after = -torque, torque * (1 - torch.tensor(left).double())
        valid = torch.arange(rows) > 3
        traces.append(Trace("run", 8.0, motion, torque, before, after, valid))
    assert alien_joints(traces).tolist() == alien


def trace(name: str, rows: int, begin: float) -> Trace:
    t = 100.0 + begin + torch.arange(rows).double() / 8
    x = torch.arange(2 * rows).double().reshape(rows, 2)
    counts = torch.arange(rows) > 0
    moves = torch.tensor([[True, False]]).expand(rows, 2)
    return Trace(name, 8.0, Motion(x, x, x, t=t), x, x + 1, x + 2, counts, moves, begin)


def test_torque_over_time_has_a_row_an_instant_and_joint(tmp_path: Path) -> None:
    """Times are those of the log itself; joints count from 1 in files."""
    rows = TorqueOverTime.of([trace("first", 2, 0.0), trace("then", 3, 5.0)])
    assert rows.t.tolist() == [0.0, 0.0, 0.125, 0.125, 5.0, 5.0, 5.125, 5.125, 5.25, 5.25]
    assert rows.log.tolist() == 4 * ["first"] + 6 * ["then"]
    assert rows.joint.tolist() == 5 * [0, 1]
    assert rows.measured.tolist() == [0, 1, 2, 3, 0, 1, 2, 3, 4, 5]
    assert set(rows.as_given - rows.measured) == {1.0}
    assert set(rows.corrected - rows.measured) == {2.0}
    assert rows.counts.tolist() == [k in (2, 6, 8) for k in range(10)]
    assert rows.to_frame()["joint"].tolist() == 5 * [1, 2]
    rows.to_csv(tmp_path / "over_time.csv")
    with (tmp_path / "over_time.csv").open() as file:
        written = list(csv.DictReader(file))
    assert len(written) == 10
    assert written[3] == {
        "t": "0.125", "log": "first", "joint": "2", "measured": "3.0", "as_given": "4.0",
        "corrected": "5.0", "counts": "False",
    }  # fmt: skip
