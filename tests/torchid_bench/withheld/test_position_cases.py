"""A case without effects is what the library's own simulation makes of the same servos."""

import pytest
import torch

from torchid.effects.servo import INDEX
from torchid.log.readers import read_log
from torchid.position.model import ServoArm
from torchid.position.replay import replay
from torchid.robot.library import load_robot
from torchid.simulation.servo import Servos
from torchid_bench.withheld.case_set import write_case


@pytest.mark.slow
@pytest.mark.usefixtures("types_unchecked")
@pytest.mark.parametrize(
    ("mix", "arm"), [("position", "3r"), ("tree_position", "quadruped")], ids=["arm", "quadruped"]
)
def test_both_simulators_agree_on_plain_servos(tmp_path, mix, arm):
    key = write_case(tmp_path / "case", 7, 0, mix=mix, kind="none", arm=arm)
    assert key["effects"] == []
    robot, log = (
        load_robot(tmp_path / "case" / "robot.urdf"),
        read_log(tmp_path / "case/log.parquet"),
    )
    servos, truth = Servos.neutral(robot.n), key["background"]
    for name in ("kp", "damping", "armature", "coulomb"):
        servos.joint[:, INDEX[name]] = torch.tensor(truth[name])
    # A held command is late by half of a sample, as one is that is taken between two.
    servos.joint[:, INDEX["delay"]] = torch.tensor(truth["delay"]) + 0.5 / key["rate_hz"]
    first, *_ = log.trajectories()
    first = first.select(slice(0, int(5 * key["rate_hz"])))
    far = replay(ServoArm(robot, servos, torch.ones(robot.n).double()), first)
    apart = 1e3 * (first.u - first.q).square().mean(0).sqrt()
    assert bool((far.error[0] < 0.05 * apart).all()), (far.error, apart)
