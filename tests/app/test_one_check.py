"""Every command that answers from logs asks the doctor first: one verdict, in the same words."""

import re
from dataclasses import replace

import pytest
import torch

from tests.gap.small_logs import ROBOT, Recording, logged
from tests.marks import quick_first
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.log.readers import write_log

SOUND = logged(ROBOT, Recording((0, 1), duration=6.0, noise=0.02))


def negated():
    return SOUND.replace(tau=SOUND.tau * torch.tensor([1.0, -1.0, 1.0], dtype=torch.float64))


def exchanged():
    return SOUND.replace(q=SOUND.q[:, [0, 2, 1]], dq=None, tau=SOUND.tau[:, [0, 2, 1]])


def hanging():
    """Of an arm on the ceiling."""
    turned = replace(ROBOT, gravity=-ROBOT.gravity)
    dq, ddq = (torch.zeros_like(SOUND.q) for _ in range(2))
    standing, other = (inverse_dynamics(arm, SOUND.q, dq, ddq) for arm in (ROBOT, turned))
    return SOUND.replace(tau=SOUND.tau - standing + other)


def milliseconds():
    return SOUND.replace(t=1e3 * SOUND.t, dq=None)


FAULTS = {
    "torque sign of joint 2": negated,
    "joint order of joints 2, 3": exchanged,
    "gravity": hanging,
    "time unit": milliseconds,
}
COMMANDS = {
    "identify": "identify 3r LOG",
    "gap": "gap 3r LOG --effects coulomb_friction",
    "gap beside an earlier log": "gap 3r GOOD --before LOG --effects coulomb_friction",
    "payload": "payload 3r GOOD --loaded LOG",
    "payload of logs without it": "payload 3r LOG --loaded GOOD",
    "correct": "correct 3r LOG --to urdf --effects coulomb_friction",
    "pair": "pair 3r --simulated LOG --real LOG --effects coulomb_friction",
}


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """good.csv, and one file a fault."""
    folder = tmp_path_factory.mktemp("one_check")
    # Of the same motion with other noise: one log that is given twice is refused for that.
    sound = logged(ROBOT, Recording((0, 1), duration=6.0, noise=0.02, seed=1))
    write_log(sound, folder / "good.parquet")
    for k, make in enumerate(FAULTS.values()):
        write_log(make(), folder / f"fault{k}.parquet")
    return folder


def arguments(name, fault, logs):
    places = {"LOG": logs / f"fault{list(FAULTS).index(fault)}.parquet"}
    places["GOOD"] = logs / "good.parquet"
    return [places.get(word, word) for word in COMMANDS[name].split()]


@pytest.mark.parametrize("fault", quick_first(FAULTS, 1))
@pytest.mark.parametrize("name", COMMANDS)
def test_a_wrong_log_stops_every_command_with_the_same_words(
    command, logs, tmp_path, monkeypatch, name, fault
):
    monkeypatch.chdir(tmp_path)
    got = command(*arguments(name, fault, logs))
    said = " ".join(got.err.split())
    assert got.code == 1, got.out
    assert re.search(rf"error: log '[^']*' is not used, it looks wrong: {fault}\.", said), said
    assert "--force goes on all the same" in said


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_forced_every_command_goes_on_and_says_so(command, logs, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    fault = "torque sign of joint 2"
    got = command(*arguments(name, fault, logs), "--force")
    said = " ".join((got.out + got.err).split())
    assert "is not used" not in said
    assert f"Wrong log: {fault}." in said
