"""Whole numbers read without their sign."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.doctor.synthetic import clean
from torchid.doctor.case import Case
from torchid.doctor.number_format import check_number_format
from torchid.log.model import Log
from torchid.robot.library import load_robot

TIME = torch.arange(400, dtype=torch.float64) / 100


def moving(amplitude, offset=0.0):
    return (amplitude * torch.sin(3 * TIME) + offset).round()[:, None]


@given(
    number=st.sampled_from([(16, 1.0), (16, 0.01), (32, 1.0)]),
    amplitude=st.integers(200, 30_000),
)
def test_complements_get_their_signs(number, amplitude):
    bits, unit = number
    # Slow enough that neighbours are a unit apart somewhere.
    own = moving(min(amplitude, 400) if unit < 1.0 else amplitude)
    log = Log(TIME, q=moving(1.0), tau=unit * torch.remainder(own, 2.0**bits))
    check = check_number_format(Case(load_robot("3r"), log))
    assert check.verdict == "wrong"
    torch.testing.assert_close(check.repairs[0].apply(log).tau, unit * own, atol=1e-6, rtol=0)


@pytest.mark.parametrize("bit", [1024, 32768])
@pytest.mark.parametrize("offset", [0.0, -600.0])
def test_bits_get_their_signs_in_all_columns(bit, offset):
    own = torch.cat([moving(300), moving(300, offset)], 1)
    log = Log(TIME, q=torch.cat([moving(1.0)] * 2, 1), current=torch.where(own < 0, bit - own, own))
    (repair,) = check_number_format(Case(load_robot("3r"), log)).repairs
    torch.testing.assert_close(repair.apply(log).current, own)


def test_numbers_with_signs_counters_and_loads_stay():
    _, arm = clean("3r", 0)
    for log in (
        arm,
        arm.replace(q=(arm.q * 4096).round() + 40_000),
        arm.replace(tau=40 + 0 * arm.tau),
    ):
        assert check_number_format(Case(load_robot("3r"), log)).verdict == "fine"
