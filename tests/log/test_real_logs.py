"""The readers, checks and resampling on logs of real arms, which are not part of the project."""

from pathlib import Path

import pytest
import torch

from tests.log.examples import is_uniform
from tests.real_logs import FOLDER, NO_LOGS, SOUND
from torchid.errors import LogError
from torchid.log.checks import check_log
from torchid.log.readers import read_log

JOINTS = {
    "emps": 1,
    "panda_gaz": 7,
    "panda_unisa": 7,
    "ur10_unisa": 6,
    "ur10e": 6,
    "xmate7p": 7,
}
RATE_HZ = {
    "emps": 1000,
    "panda_gaz": 1000,
    "panda_unisa": 30,
    "ur10_unisa": 125,
    "ur10e": 100,
    "xmate7p": 50,
}


PATHS = [path for arm in SOUND for path in sorted(FOLDER.glob(f"{arm}/*.parquet"))]
ABSENT = pytest.param(None, marks=pytest.mark.skip(reason=NO_LOGS))
pytestmark = pytest.mark.real


@pytest.mark.parametrize(
    "path", PATHS or [ABSENT], ids=lambda path: path and f"{path.parent.name}/{path.stem}"
)
def test_real_log(path: Path) -> None:
    arm = path.parent.name
    log = read_log(path)
    n = JOINTS[arm]
    assert log.n == n
    slides = [arm == "emps"] * n
    if "5periods" in path.stem:
        # Its time axis was made up at 50 Hz; dq says that it was sampled at 1 kHz.
        with pytest.raises(LogError, match="20 times the derivative"):
            check_log(log, n=n, robot_name=arm, prismatic=slides)
        return
    warnings = check_log(log, n=n, robot_name=arm, prismatic=slides)
    assert warnings == ()
    result = log.even
    assert is_uniform(result)
    assert result.trajectory_count == log.trajectory_count == 1
    assert result.duration == pytest.approx(log.duration, abs=1.01 / result.rates[0])
    assert result.rates == (pytest.approx(RATE_HZ[arm], rel=1e-3),)
    assert all(torch.isfinite(signal).all() for signal in result.signals.values())
    assert (result.warnings == ()) == is_uniform(log)
    assert check_log(result, n=n, robot_name=arm, prismatic=slides) == warnings
