"""The readers, checks and resampling on logs of real arms, which are not part of the project."""

from pathlib import Path

import h5py
import numpy as np
import pytest
import torch
from scipy.io import savemat

from tests.log.examples import is_uniform
from tests.log.recordings import BAGS, messages_of, write_bag
from tests.real_logs import FOLDER, NO_LOGS, SOUND
from torchid.errors import LogError
from torchid.log.checks import check_log
from torchid.log.readers import read_log
from torchid.robot.library import load_robot

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


@pytest.mark.skipif(not FOLDER.is_dir(), reason=NO_LOGS)
def test_a_log_survives_every_format(tmp_path: Path) -> None:
    """The UR10e's, as csv in degrees, MATLAB, HDF5 and bags with joints in alphabetical order."""
    log = read_log(FOLDER / "ur10e" / "log_est_30s_12harm.parquet")
    log = log.with_torque(torch.tensor([11.0, 11.0, 11.0, 9.0, 9.0, 9.0], dtype=torch.float64))
    names = load_robot(FOLDER / "ur10e" / "robot.urdf").joint_names
    q, dq, tau = (log.signals[name].numpy() for name in ("q", "dq", "tau"))
    degrees = {"stamp": 1e3 * log.t.numpy()}
    for k in range(6):
        degrees |= {f"pos[{k}] (deg)": np.rad2deg(q[:, k]), f"vel[{k}]": np.rad2deg(dq[:, k]),
                    f"torque[{k}]": 1e3 * tau[:, k]}  # fmt: skip
    rows = np.stack(list(degrees.values()), 1)
    lines = [";".join(degrees), *(";".join(repr(float(x)) for x in row) for row in rows)]
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    savemat(tmp_path / "a.mat", {"log": {"t": log.t.numpy(), "q": q.T, "dq": dq.T, "tau": tau.T}})
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["run/t"], file["run/x"] = log.t.numpy(), np.concatenate([q, dq, tau], 1)
    columns = {
        "a.csv": "t=stamp ms,q='pos[{j0}] (deg)' deg,dq='vel[{j0}]' deg/s,tau='torque[{j0}]' mNm",
        "a.mat": "t=log.t,q=log.q,dq=log.dq,tau=log.tau",
        "a.h5": "t=run/t,q=run/x[:,0:6],dq=run/x[:,6:12],tau=run/x[:,12:18]",
    }
    bags = {
        write_bag(
            tmp_path / kind, kind, {"/joint_states": messages_of(log, names, (2, 1, 0, 3, 4, 5))}
        )
        for kind in BAGS
    }
    for path in [*(tmp_path / name for name in columns), *bags]:
        read = read_log(path, columns=columns.get(path.name), joints=names)
        torch.testing.assert_close(read.t, log.t - log.t[0], rtol=0, atol=2e-9)
        for name in ("q", "dq", "tau"):
            torch.testing.assert_close(read.signals[name], log.signals[name], rtol=1e-14, atol=0)
