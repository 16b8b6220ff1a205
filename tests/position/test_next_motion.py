"""Commands that settle what a diagnosis of commands and positions leaves open."""

from dataclasses import replace

import pytest
from msgspec import structs

from tests.position.diagnosed import diagnosis, finding
from tests.position.planted import robot
from torchid.errors import RobotError, TorchidError
from torchid.excitation.clearance import motion_clearance
from torchid.position import next_motion
from torchid.position.next_motion import MOTIONS, next_commands
from torchid.results.files import load
from torchid.robot.library import load_robot
from torchid.robot.model import Limits

FOUND = (
    finding("set_point_profile", 2, 9.0, 4.0, acceleration=4.0),
    finding("derivative_gain", 1, 9.0, 4.0, kd=25.0),
)


@pytest.fixture(scope="module")
def unsure():
    """A diagnosis whose second finding has an interval from a tenth to tenfold."""
    wide = structs.replace(FOUND[1], ci95={"kd": (2.5, 250.0)})
    servos = diagnosis().servos
    servos.of("kd")[0] = 25.0
    servos.of("acceleration")[1] = 4.0
    return replace(diagnosis(FOUND[0], wide), servos=servos)


@pytest.mark.slow
def test_what_is_open_is_told_better(unsure, tmp_path):
    arm = robot().with_limits(velocity=2.0, position=[[-1.0, 1.0], [-0.8, 1.2], [-1.0, 1.0]])
    unsure.save(tmp_path / "gap.json")
    made = next_commands(tmp_path / "gap.json", arm, seconds=5.0, usage=0.8)
    # The acceleration is known to a tenth, so the derivative gain alone is open.
    assert [(o.joint, o.parameter, o.why) for o in made.open] == [(0, "kd", "unsure")]
    assert made.open[0].then < 0.5 * made.open[0].now
    assert len(made.motions) == made.log.trajectory_count == MOTIONS
    # Commands and motion keep the limits; the third joint never moved, and is left alone.
    rate = made.log.q.diff(dim=0)[made.log.trajectory.diff() == 0].abs().amax(0) * 50
    assert bool((rate <= 0.8 * 2.0).all())
    low, high = arm.limits.position.unbind(-1)
    assert bool(((made.log.u >= low) & (made.log.u <= high)).all())
    assert float(made.log.u[:, 2].std()) == 0.0
    made.save(tmp_path / "next.json")
    assert load(tmp_path / "next.json").plain() == made.plain()


@pytest.mark.slow
def test_nothing_open_serves_all(unsure):
    arm = robot().with_limits(velocity=2.0)
    made = next_commands(replace(unsure, findings=FOUND[:1]), arm, seconds=4.0)
    assert made.open == ()
    assert len(set(made.motions)) == MOTIONS


@pytest.mark.slow
def test_limits_and_robots_are_needed(unsure):
    with pytest.raises(RobotError, match="velocity"):
        next_commands(unsure, replace(robot(), limits=Limits()))
    with pytest.raises(TorchidError, match="another robot"):
        next_commands(unsure, load_robot("ur10e"))
    with pytest.raises(TorchidError, match="such motions are longer"):
        next_commands(unsure, robot(), seconds=1.0)


@pytest.mark.slow
def test_no_room(unsure, monkeypatch):
    monkeypatch.setattr(next_motion, "TRIES", 1)
    arm = robot().with_limits(velocity=2.0)
    with pytest.raises(RobotError, match="no motion about the middle"):
        next_commands(unsure, arm, seconds=4.0, clearance=motion_clearance(arm, floor=5.0))
