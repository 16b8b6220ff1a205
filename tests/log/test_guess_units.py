"""Units that a refusal proposes, guessed from the numbers where the names say none."""

from pathlib import Path

import numpy as np
import pytest

from tests.log.examples import proposed
from torchid.errors import LogError
from torchid.log.readers import read_log

HEADER = ",".join(["stamp", *(f"{name}_{j}" for name in ("pos", "vel", "eff") for j in (1, 2))])


def hint(folder: Path, time: float, angle: float, speed: float, torque: float = 1.0) -> str:
    """What is proposed for a log with these factors on seconds, rad, rad/s and N m."""
    t = np.arange(400) * 0.005
    q = 2.0 * np.sin(t[:, None] * [3.0, 5.0])
    dq = np.gradient(q, 0.005, axis=0)
    table = np.column_stack([t * time, q * angle, dq * speed, 10.0 * q * torque])
    path = folder / "log.csv"
    np.savetxt(path, table, delimiter=",", header=HEADER, comments="")
    return str(proposed(folder / "log.csv"))


DEG = 180 / np.pi


@pytest.mark.parametrize(
    ("factors", "mapping"),
    [
        ((1.0, 1.0, 1.0), "t=stamp,q=pos_{j},dq=vel_{j},tau=eff_{j}"),
        ((1e3, DEG, DEG), "t=stamp ms,q=pos_{j} deg,dq=vel_{j} deg/s,tau=eff_{j}"),
        ((1e9, DEG, 1.0), "t=stamp ns,q=pos_{j} deg,dq=vel_{j},tau=eff_{j}"),
        ((1e6, 1.0, 1.0), "t=stamp us,q=pos_{j},dq=vel_{j},tau=eff_{j}"),
        ((1.0, 20000.0, 20000.0), "t=stamp,q=pos_{j},dq=vel_{j},tau=eff_{j}"),
        ((1.0, 1.0, 1.0, 1e3), "t=stamp,q=pos_{j},dq=vel_{j},tau=eff_{j} mNm"),
        ((1.0, 1.0, 1.0, 100.0), "t=stamp,q=pos_{j},dq=vel_{j},tau=eff_{j}"),
        ((1.0, 1.0, 1.0, 0.1), "t=stamp,q=pos_{j},dq=vel_{j},tau=eff_{j}"),
        ((1.0, 1.0, 1.0, 1e6), "t=stamp,q=pos_{j},dq=vel_{j},tau=eff_{j}"),
    ],
)
def test_units_are_guessed(tmp_path: Path, factors: tuple[float, ...], mapping: str) -> None:
    said = hint(tmp_path, *factors)
    assert said.startswith(f'perhaps `columns="{mapping}"`')
    assert ("guessed from the numbers" in said) == (" " in mapping)


def test_what_is_proposed_reads_the_log(tmp_path: Path) -> None:
    columns = hint(tmp_path, 1e3, DEG, DEG, 1e3).split('"')[1]
    log = read_log(tmp_path / "log.csv", columns=columns)
    assert float(log.q.abs().max()) == pytest.approx(2.0, rel=1e-3)
    assert float(log.t[1]) == pytest.approx(0.005)
    assert float(log.signals["tau"].abs().max()) == pytest.approx(20.0, rel=1e-3)


@pytest.mark.parametrize("torque", [np.nan, 0.0])
def test_columns_without_numbers_say_nothing(tmp_path: Path, torque: float) -> None:
    assert 'tau=eff_{j}"' in hint(tmp_path, 1.0, 1.0, 1.0, torque)


@pytest.mark.parametrize("rows", [0, 1])
@pytest.mark.filterwarnings("error")
def test_no_rows_say_nothing(tmp_path: Path, rows: int) -> None:
    (tmp_path / "log.csv").write_text(f"{HEADER}\n" + rows * "0,90,90,0,0,0,0\n")
    with pytest.raises(LogError, match="no column t") as caught:
        read_log(tmp_path / "log.csv")
    assert "q=pos_{j},dq=vel_{j}" in str(caught.value.hint)


def test_a_table_without_a_known_name_is_told_what_it_has(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("zeit,foo,bar\n0,1,2\n0.01,1,3\n")
    with pytest.raises(LogError, match="no column t") as caught:
        read_log(tmp_path / "log.csv")
    assert caught.value.available == ["zeit", "foo", "bar"]
    assert "t=NAME s,q=NAME_{j} deg" in str(caught.value.hint)


def test_what_a_name_says_is_not_guessed(tmp_path: Path) -> None:
    """Angles of 1000 rad and torques of 10 000 N m, as the names have it."""
    t = np.arange(50) * 5.0
    header = "t [ms],q_1 [rad],q_2 [rad],trq_1 [Nm],trq_2 [Nm]"
    table = np.column_stack([t, *[1e3 * np.sin(t)] * 2, *[1e4 * np.cos(t)] * 2])
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header=header, comments="")
    assert proposed(tmp_path / "a.csv") == (
        "perhaps `columns=\"t='t [ms]' ms,q='q_{j} [rad]',tau='trq_{j} [Nm]'\"`"
    )
