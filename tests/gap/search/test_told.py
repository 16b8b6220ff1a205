"""What is told of a load beside corrected base parameters, which do whatever it does."""

import pytest
import torch

from tests.gap.motions import ROBOT
from tests.gap.problems import base_of_3r, measured, question_of, wanted_of
from torchid.gap.search.solve import Solution
from torchid.gap.search.terms import BASE, PAYLOAD, term_columns
from torchid.gap.search.told import beside_base
from torchid.typing import Tensor

NUMBER = len(base_of_3r().independent[: base_of_3r().n_rigid])
LOAD = torch.tensor([0.5, 0.05, -0.02, 0.1, 0.01, 0.0, 0.0, 0.01, 0.0, 0.01], dtype=torch.float64)


def solution_of(x_base: Tensor, x_load: Tensor) -> Solution:
    question = question_of(measured(()), (PAYLOAD,), inertial=True)
    columns = question.candidates.columns
    terms = {t.name: t for t in question.candidates.terms}
    base, load = terms[BASE], terms[PAYLOAD]
    a = torch.cat([term_columns(columns, base), term_columns(columns, load)])
    std = torch.full_like(x_load, 1e-3)
    return Solution(
        columns.model,
        wanted_of((PAYLOAD,), inertial=True),
        (base, load),
        (x_base, x_load),
        (torch.zeros_like(x_base), std),
        columns.model,
        a,
        a[0] * 0,
    )


@pytest.mark.parametrize("part", [0.0, 0.3, 1.0])
def test_a_load_does_not_depend_on_how_the_fit_divided_it(part: float) -> None:
    """Base parameters that hold a part of the load give it back."""
    empty = solution_of(torch.zeros(NUMBER, dtype=torch.float64), LOAD)
    count = len(empty.terms[0].at)
    b, p = empty.a[:count].flatten(1), empty.a[count:].flatten(1)
    t = torch.linalg.lstsq(b.T, p.T, driver="gelsd").solution
    values, std = beside_base(solution_of(t @ (part * LOAD), (1 - part) * LOAD), 1)
    # The same torque, with nothing left for base parameters to hold.
    assert torch.allclose(values @ p, LOAD @ p, atol=1e-6 * float((LOAD @ p).abs().max()))
    assert bool((std >= 1e-3).all())


def test_a_load_is_known_no_better_than_the_body_that_carries_it() -> None:
    """Its mass, beside a mass of the last link that may be off by 30 %."""
    empty = solution_of(torch.zeros(NUMBER, dtype=torch.float64), LOAD)
    _, std = beside_base(empty, 1)
    moments = ROBOT.require_parameters("a test").pi[-1, 1:4].abs().max()
    assert float(std[1:4].max()) > 0.1 * float(moments)
