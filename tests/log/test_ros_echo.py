"""What ROS echoes as text is read by the names in its rows."""

import csv
from pathlib import Path

import numpy as np
import pytest
import torch

from torchid.errors import LogError
from torchid.log.readers import read_log

JOINTS = ("pan", "lift", "bend")
ORDER = (2, 1, 0)  # alphabetical, as joint states mostly come
T = 0.01 * np.arange(50)
Q = np.sin(np.outer(T, (1.0, 2.0, 3.0)))


def values(k: int, signals: int) -> list[float]:
    return [(s + 1) * Q[k, j] for s in range(signals) for j in ORDER]


def ros1(path: Path, comment: str = "%", signals: int = 3) -> Path:
    fields = ("position", "velocity", "effort")[:signals]
    header = [f"{comment}time", "field.header.seq", "field.header.stamp", "field.header.frame_id"]
    header += [f"field.name{k}" for k in range(3)] + [
        f"field.{f}{k}" for f in fields for k in range(3)
    ]
    start = 1_700_000_000_000_000_000
    with open(path, "w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(header)
        for k, t in enumerate(T):
            stamp = start + round(1e9 * t)
            names = [JOINTS[j] for j in ORDER]
            rows.writerow([stamp + 1_000_000, k, stamp, "", *names, *values(k, signals)])
    return path


def ros2(path: Path, signals: int = 3) -> Path:
    with open(path, "w", newline="") as file:
        rows = csv.writer(file)
        for k in range(len(T)):
            names = [JOINTS[j] for j in ORDER]
            rows.writerow([1_700_000_000, 10_000_000 * k, "base", *names, *values(k, signals)])
    return path


@pytest.mark.parametrize("kind", [ros1, ros2, lambda path: ros1(path, comment="")])
def test_joints_are_found_by_the_names_in_the_rows(kind, tmp_path: Path) -> None:
    log = read_log(kind(tmp_path / "echo.csv"), joints=JOINTS)
    assert torch.allclose(log.t, torch.from_numpy(T), atol=1e-9)
    for factor, signal in enumerate((log.q, log.dq, log.tau), start=1):
        assert torch.allclose(signal, torch.from_numpy(factor * Q))


def test_positions_alone(tmp_path: Path) -> None:
    for kind in (ros1, ros2):
        log = read_log(kind(tmp_path / f"{kind.__name__}.csv", signals=1), joints=JOINTS)
        assert list(log.signals) == ["q"]
        assert torch.allclose(log.q, torch.from_numpy(Q))


def test_a_mapping_goes_before_the_names(tmp_path: Path) -> None:
    columns = "t='field.header.stamp' ns,q=field.position{j0}"
    log = read_log(ros1(tmp_path / "echo.csv"), columns=columns)
    assert torch.allclose(log.q, torch.from_numpy(Q[:, ORDER]))


def test_other_joints_are_told(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="names do not identify"):
        read_log(ros2(tmp_path / "echo.csv"), joints=("a", "b", "c"))
