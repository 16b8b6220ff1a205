"""The doctor is silent on logs of real arms, which are not part of the project."""

import pytest
import torch

from tests.real_logs import FOLDER, NO_LOGS, SOUND
from torchid.doctor.examine import examine
from torchid.log.readers import read_log
from torchid.robot.library import load_robot

GAINS = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)
ODD = ("jointwise", "5periods")  # joints at rest; a time axis that was made up
PATHS = [
    path
    for arm in SOUND
    for path in sorted(FOLDER.glob(f"{arm}/*.parquet"))
    if not any(word in path.stem for word in ODD)
]
ONE_AN_ARM = list({path.parent: path for path in PATHS}.values())
ABSENT = pytest.param(None, marks=pytest.mark.skip(reason=NO_LOGS))
pytestmark = [pytest.mark.real, pytest.mark.slow]


@pytest.mark.parametrize(
    "path",
    [p if p in ONE_AN_ARM else pytest.param(p, marks=pytest.mark.nightly) for p in PATHS]
    or [ABSENT],
    ids=lambda path: path and f"{path.parent.name}/{path.stem}",
)
def test_a_real_log_raises_no_alarm(path):
    robot, log = load_robot(next(path.parent.glob("robot.*"))), read_log(path)
    log = log if log.tau is not None else log.with_torque(torch.tensor(GAINS, dtype=torch.float64))
    found = [c for c in examine(robot, log).checks if c.verdict in ("wrong", "doubtful")]
    filtered = ["content"] if path.parent.name == "ur10_unisa" else []  # at 2 Hz
    assert [c.name for c in found] == filtered, found
