"""Draws of servos have the covariance that the log left, and reach simulators."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

import torchid
from tests.position.diagnosed import diagnosis
from torchid.app.commands import app
from torchid.effects.servo import INDEX
from torchid.errors import TorchidError
from torchid.position.fit import absolute
from torchid.position.record import KnownRecord
from torchid.simulators.servo import drawn_servos

NAMES = ("kp", "armature", "delay")
COVARIANCE = torch.tensor(
    [[0.04, 0.03, 0.0], [0.03, 0.0625, 1e-4], [0.0, 1e-4, 4e-6]], dtype=torch.float64
)


def known_of(joint: int, names: tuple[str, ...], covariance: torch.Tensor) -> KnownRecord:
    return KnownRecord(joint=joint, names=names, covariance=covariance)


@pytest.fixture(scope="module")
def found():
    """Gain and inertia of joint 1 go together; of joint 2 the delay alone is told."""
    every = (NAMES, COVARIANCE), (NAMES[2:], COVARIANCE[2:, 2:]), ((), torch.zeros(0, 0).double())
    return replace(diagnosis(), known=tuple(known_of(k, *each) for k, each in enumerate(every)))


def test_draws_have_the_covariance_of_what_the_log_told(found):
    wide = torchid.randomise(found.record, 0.9, draws=1024, seed=2)
    moved = absolute(wide.draws) - absolute(found.servos)
    own = moved[:, 0, [INDEX[name] for name in NAMES]]
    assert float(found.servos.of("delay")[0]) > 6 * COVARIANCE[2, 2] ** 0.5  # none is cut at zero
    size = COVARIANCE.diagonal().sqrt()
    apart = (own.T.cov() - COVARIANCE) / (size * size[:, None])
    assert float(apart.abs().max()) < 0.03
    # Nothing else varies.
    moved[:, 0, [INDEX[name] for name in NAMES]] = 0
    moved[:, 1, INDEX["delay"]] = 0
    assert not moved.nan_to_num(nan=0.0).any()
    assert [(r.field, r.name) for r in wide.ranges] == [
        ("kp", "joint 1"), ("armature", "joint 1"), ("delay", "joint 1"), ("delay", "joint 2")
    ]  # fmt: skip
    first = wide.ranges[0]
    inside = (wide.draws.of("kp")[:, 0] >= first.low) & (wide.draws.of("kp")[:, 0] <= first.high)
    assert float(inside.double().mean()) == pytest.approx(0.9, abs=0.002)
    assert first.high / first.centre == pytest.approx(np.exp(1.645 * 0.2), rel=0.02)
    assert "one standard deviation is a factor of 1.22 by the log" in first.why


def test_what_is_positive_stays_so(found):
    joints = (known_of(0, NAMES[2:], torch.ones(1, 1).double()), *found.known[1:])
    wide = torchid.randomise(replace(found, known=joints).record, draws=64)
    assert float(wide.draws.of("delay").min()) == 0


def test_by_command(found, tmp_path):
    found.save(tmp_path / "gap.json")
    asked = ["export", str(tmp_path / "gap.json"), "--randomise", "0.9", "--draws", "64"]
    done = CliRunner().invoke(
        app, [*asked, "--out", str(tmp_path), "--name", "arm", "--robot", "3r"]
    )
    assert done.exit_code == 0, done.output
    assert "64 draws of the servos" in done.output
    record = torchid.load(tmp_path / "randomisation.json")
    assert {r.name for r in record.ranges} == {"joint_1", "joint_2"}
    assert [file.rpartition("/")[2] for file in record.files] == [
        "arm_ranges.csv", "arm_servo_draws.npz"
    ]  # fmt: skip
    drawn = drawn_servos(tmp_path / "arm_servo_draws.npz", found.servos)
    again = torchid.randomise(torchid.load(tmp_path / "gap.json"), 0.9, draws=64)
    assert torch.allclose(drawn.joint, again.draws.joint)
    rows = (tmp_path / "arm_ranges.csv").read_text().splitlines()
    assert rows[1].startswith('"actuator_gainprm[0] / scale, -actuator_biasprm[1]",kp,joint_1,')
    assert rows[2].startswith("dof_armature,armature,joint_1,")


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"level": 1.0}, "level is out of range"),
        ({"draws": 1}, "so many robots cannot be drawn"),
        ({"robot": "kuka_lwr4"}, "of another arm"),
    ],
)
def test_what_cannot_be_drawn(found, more, said):
    if "robot" in more:
        more = {"robot": torchid.load_robot(more["robot"])}
    with pytest.raises(TorchidError, match=said):
        torchid.randomise(found.record, **more)


def test_an_older_diagnosis_has_no_covariance(found):
    with pytest.raises(TorchidError, match="as older versions wrote it"):
        torchid.randomise(replace(found, known=()).record)
