"""`torchid excite` from the outside: room, first runs, files for controllers."""

import json

import pytest
import torch

from tests.excitation.shaped import shaped_arm
from tests.position.diagnosed import diagnosis
from torchid.log.readers import read_log
from torchid.robot.library import load_robot

RANDOM = ("--kind", "random", "--duration", 8, "--max-acceleration", 5)


def words(text):
    return " ".join(text.split())


@pytest.mark.slow
def test_a_first_run_at_a_tenth_of_the_speed(command, tmp_path):
    """All files hold the same slow motion along the path of the fast one."""
    arm, files = shaped_arm("6r", tmp_path), ("fast", "slow")
    for name, speed in zip(files, (1, 0.1), strict=True):
        target = tmp_path / name
        done = command(
            "excite", arm, *RANDOM, "--max-velocity", 0.15, "--floor", -0.4, "--speed", speed,
            "--rate", 50, "--to", f"{target}.csv", "--json", f"{target}.out",
            "--ros2", f"{target}.json", "--urscript", f"{target}.script",
        )  # fmt: skip
        assert done.code == 0, done.err
        assert "the forecast torque has no friction in it: the drives need more" in words(done.out)
        assert "room: " in done.out
        assert "at least 20 mm are kept at every instant" in words(done.out)
    fast, slow = (read_log(tmp_path / f"{name}.csv") for name in files)
    torch.testing.assert_close(slow.q[::10], fast.q)
    torch.testing.assert_close(slow.dq[::10], 0.1 * fast.dq)
    torch.testing.assert_close(slow.ddq[::10], 0.01 * fast.ddq)
    message = json.loads((tmp_path / "slow.json").read_text())
    assert len(message["points"]) == len(slow.t) == 4001
    assert message["points"][-1]["time_from_start"] == {"sec": 80, "nanosec": 0}
    assert (tmp_path / "slow.script").read_text().count("servoj([") == 4001
    records = [json.loads((tmp_path / f"{name}.out").read_text()) for name in files]
    assert [r["speed"] for r in records] == [1, 0.1]
    near = [r["clearance"]["nearest"] for r in records]
    assert near[1]["distance"] == pytest.approx(near[0]["distance"], abs=1e-6)
    # Between two of the 200 instants of a period at which distances are looked at.
    assert near[1]["time"] == pytest.approx(10 * near[0]["time"], abs=80 / 200)
    assert records[1]["trajectories"][0]["duration"] == pytest.approx(80)


@pytest.mark.slow
def test_seventy_per_cent_of_the_limits_unless_told(command, tmp_path):
    robot = load_robot("3r")
    for usage, expected in (((), 0.7), (("--usage", 1), 1.0)):
        done = command("excite", "3r", "--kind", "random", *usage, "--to", tmp_path / "m.csv")
        assert done.code == 0, done.err
        log = read_log(tmp_path / "m.csv")
        shares = [
            (x.abs().amax(0) / limit[:, 1]).max()
            for x, limit in (
                (log.q, robot.limits.position),
                (log.dq, robot.limits.velocity),
                (log.ddq, robot.limits.acceleration),
            )
        ]
        assert float(max(shares)) == pytest.approx(expected, rel=0.02)
        assert float(max(shares)) <= expected


def test_friction_that_is_known_is_no_news(command, tmp_path):
    arm = shaped_arm("7r", tmp_path, friction=1.0)
    done = command("excite", arm, *RANDOM, "--to", tmp_path / "m.csv")
    assert "largest torque" in done.out
    assert "no friction" not in done.out


@pytest.mark.nightly
def test_commands_for_an_arm_without_torque(command, tmp_path):
    diagnosis().save(tmp_path / "gap.json")
    given = ("excite", "3r", "--for", tmp_path / "gap.json", "--duration", 4, "--rate", 50)
    done = command(*given, "--out", tmp_path / "next")
    assert done.code == 0, done.err
    assert "4 motions of 4 s at 50 commands a second" in words(done.out)
    assert "leaves nothing open" in words(done.out)
    log = read_log(tmp_path / "next" / "trajectory.csv")
    assert log.u is not None
    assert log.trajectory_count == 4
    none = command("excite", "--for", tmp_path / "gap.json", "--to", tmp_path / "a.csv")
    assert "does not record its robot" in none.err
    fast = command(*given, "--speed", 0.5, "--to", tmp_path / "a.csv")
    assert "at full speed" in fast.err
    assert not (tmp_path / "a.csv").exists()
