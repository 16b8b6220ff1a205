"""What the doctor mends, and nothing else."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchid.doctor.repair import Map, MappedColumns, RejoinTime, repaired
from torchid.log.model import Log

NUMBERS = st.lists(st.floats(-9.0, 9.0), min_size=3, max_size=3)
FACTORS = st.lists(st.sampled_from([-2.0, -1.0, 0.5, 3.0]), min_size=3, max_size=3)
COUPLED = st.lists(
    st.tuples(st.permutations([0, 1, 2]), st.sampled_from([-1.0, 0.5, 1.0])), max_size=2
).map(lambda some: tuple((k, j, c) for (k, j, _), c in some))
MAPS = st.builds(
    Map, st.permutations([0, 1, 2]).map(tuple), FACTORS.map(tuple), NUMBERS.map(tuple), COUPLED
)


@pytest.mark.parametrize(
    ("t", "steps", "mended"),
    [
        # The clock stood still and caught up: what comes after was right.
        ([0, 5, 10, 10, 10, 25, 30], (2, 3), [0, 5, 10, 15, 20, 25, 30]),
        # It never did.
        ([0, 5, 10, 10, 15, 20, 25], (2,), [0, 5, 10, 15, 20, 25, 30]),
    ],
)
def test_a_clock_that_stood_still(t, steps, mended):
    log = Log(1e-3 * torch.tensor(t).double(), q=torch.zeros(7, 1).double())
    found = RejoinTime(steps).apply(log).t
    torch.testing.assert_close(found, 1e-3 * torch.tensor(mended).double())


@given(first=MAPS, second=MAPS)
def test_one_map_after_the_other_is_a_map(first, second):
    rows = torch.arange(12, dtype=torch.float64).reshape(4, 3).sin()
    log = Log(torch.arange(4).double(), q=rows, dq=rows + 1, tau=rows - 1)
    signals = ("q", "dq", "tau")
    steps = repaired(log, [MappedColumns(signals, first), MappedColumns(signals, second)])
    whole = MappedColumns(signals, first.then(second)).apply(log)
    # Offsets are those of positions.
    for name in signals:
        torch.testing.assert_close(steps.signals[name], whole.signals[name])
    assert torch.equal(MappedColumns(signals, Map.of(3)).apply(log).tau, log.tau)


def test_a_coupled_column_is_said_as_it_is_mended():
    repair = MappedColumns(("q", "dq"), replace(Map.of(3), coupled=((2, 1, -1.0),)))
    assert str(repair) == "q3 = q3 - q2, dq3 = dq3 - dq2"
