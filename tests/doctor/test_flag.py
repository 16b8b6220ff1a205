"""Fixes as the option `--columns`: a file read with it is the mended log."""

from dataclasses import replace

import pytest
import torch

from tests.doctor.synthetic import clean
from torchid.doctor.flag import columns_option
from torchid.doctor.repair import (
    MOTION,
    TORQUE,
    DropRows,
    DropSignal,
    Map,
    MappedColumns,
    ScaleTime,
    reordered,
    repaired,
    scaled,
    shifted,
)
from torchid.log.readers import read_log, write_log

DEGREE = torch.pi / 180


def coupled(signals, *sums):
    return MappedColumns(signals, replace(Map.of(3), coupled=sums))


NAMES = {"t", *(f"{key}{k}" for key in ("q", "dq", "tau") for k in (1, 2, 3))}
CASES = {
    "q=q{j} deg": [scaled(("q",), (DEGREE,) * 3)],
    "tau=tau{j} mNm": [scaled(TORQUE, (1e-3,) * 3)],
    "tau=tau{j} *-1": [scaled(TORQUE, (-1.0,) * 3)],
    "tau=tau{j} *[1,-1,1]": [scaled(TORQUE, (1.0, -1.0, 1.0))],
    "tau=[tau2,tau3,tau1]": [reordered(TORQUE, (1, 2, 0))],
    "tau=[tau2,tau1,tau3] *[1,-2,1]": [
        scaled(TORQUE, (-2.0, 1.0, 1.0)),
        reordered(TORQUE, (1, 0, 2)),
    ],
    "tau=[tau2,tau1,tau3] *[-2,1,1]": [
        reordered(TORQUE, (1, 0, 2)),
        scaled(TORQUE, (-2.0, 1.0, 1.0)),
    ],
    "q=[q2,q1,q3],dq=[dq2,dq1,dq3]": [reordered(MOTION, (1, 0, 2))],
    "tau=[tau3,tau1,tau2]": [reordered(TORQUE, (1, 0, 2)), reordered(TORQUE, (2, 1, 0))],
    "q=[q1,q2,q3-q2],dq=[dq1,dq2,dq3-dq2]": [coupled(MOTION, (2, 1, -1.0))],
    "tau=[tau2,tau1+tau3,tau3] *[-1,-1,1]": [
        coupled(TORQUE, (0, 2, 1.0)),
        reordered(TORQUE, (1, 0, 2)),
        scaled(TORQUE, (-1.0, -1.0, 1.0)),
    ],
    "dq=none,t=t ms": [DropSignal("dq"), ScaleTime(1e-3)],
    "q=q{j} deg -90": [scaled(("q",), (DEGREE,) * 3), shifted(("q",), (-torch.pi / 2,) * 3)],
    "q=q{j} +[0,-2,0]": [shifted(("q",), (0.0, -2.0, 0.0))],
    "q=[q2,q1,q3] +[1,0,0]": [shifted(("q",), (0.0, 1.0, 0.0)), reordered(("q",), (1, 0, 2))],
    "tau=tau{j} *0.37": [scaled(TORQUE, (0.37,) * 3)],
}


@pytest.mark.parametrize("flag", CASES)
def test_the_option_reads_what_the_repairs_make(flag, tmp_path):
    _, log = clean("3r", 0)
    log = log.replace(ddq=None)
    write_log(log, tmp_path / "log.parquet")
    assert columns_option(CASES[flag], 3, NAMES) == flag
    read = read_log(tmp_path / "log.parquet", columns=flag)
    mended = repaired(log, CASES[flag])
    assert read.signals.keys() == mended.signals.keys()
    torch.testing.assert_close(read.t, mended.t)
    for name, signal in mended.signals.items():
        torch.testing.assert_close(read.signals[name], signal)


def test_what_cannot_be_said_is_left_out():
    repairs = [DropRows((3,), "NaN"), scaled(("q", "dq"), (DEGREE,) * 3)]
    assert columns_option(repairs[:1], 3, NAMES) is None
    assert columns_option(repairs, 3, {"t", "pos1", "pos2", "pos3"}) is None
    assert columns_option(repairs, 3, NAMES - {"dq2"}) == "q=q{j} deg"
