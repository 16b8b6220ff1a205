import pytest
import torch

from tests.gap.problems import SIMPLE, explanation_of, measured, search_of, term
from torchid.effects.friction import CoulombFriction
from torchid.gap.causes.judge import Judged
from torchid.gap.describe.claims import Claim
from torchid.gap.describe.unnamed import without_name


@pytest.mark.parametrize(("sure", "suspects"), [(0.004, 0), (0.1, 1), (0.6, 0)])
def test_a_suspect_is_possible_and_not_likely(sure: float, suspects: int) -> None:
    search = search_of(measured([(CoulombFriction(1), [0.5])]), SIMPLE)
    of = term(search, CoulombFriction(1))
    judged = Judged(of, of, sure, sure, 1 - sure, (((of,), sure),), sure)
    claim = Claim(judged, torch.zeros(3, dtype=torch.float64))
    assert len(without_name(explanation_of(search, [of]), [claim], [0.1])) == suspects
