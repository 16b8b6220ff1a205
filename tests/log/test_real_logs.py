"""The readers, checks and resampling on logs of real arms, which are not part of the project."""

from pathlib import Path

import pytest
import torch

from tests.real_logs import FOLDER, NO_LOGS
from torchid.errors import LogError
from torchid.log.checks import check_log
from torchid.log.readers import read_log
from torchid.log.sampling import is_uniform, resample, sampling_rate

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


PATHS = sorted(FOLDER.glob("*/*.parquet"))
ABSENT = pytest.param(None, marks=pytest.mark.skip(reason=NO_LOGS))
pytestmark = pytest.mark.real


@pytest.mark.parametrize(
    "path", PATHS or [ABSENT], ids=lambda path: path and f"{path.parent.name}/{path.stem}"
)
def test_real_log(path: Path) -> None:
    arm = path.parent.name
    log = read_log(path)
    n = JOINTS.get(arm, log.n)
    assert log.n == n
    slides = [arm == "emps"] * n
    if "5periods" in path.stem:
        # Its time axis was made up at 50 Hz; dq says that it was sampled at 1 kHz.
        with pytest.raises(LogError, match="20 times the derivative"):
            check_log(log, n=n, robot_name=arm, prismatic=slides)
        return
    warnings = check_log(log, n=n, robot_name=arm, prismatic=slides)
    assert warnings == ()
    result = resample(log)
    assert is_uniform(result)
    assert result.trajectory_count == log.trajectory_count == 1
    assert result.duration == pytest.approx(log.duration, abs=1.01 / sampling_rate(result)[0])
    assert sampling_rate(result) == [
        pytest.approx(RATE_HZ.get(arm, sampling_rate(log)[0]), rel=1e-3)
    ]
    assert all(torch.isfinite(signal).all() for signal in result.signals.values())
    assert (result.warnings == ()) == is_uniform(log)
    assert check_log(result, n=n, robot_name=arm, prismatic=slides) == warnings
