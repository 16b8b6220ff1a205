"""Torch's default dtype for the tests of the inside of the diagnosis."""

from collections.abc import Iterator

import pytest
import torch

AS_USERS_HAVE_IT = ("test_contract", "test_faults")
"""Modules that run with torch's own default, float32, as users do."""


@pytest.fixture(autouse=True)
def double_precision(request: pytest.FixtureRequest) -> Iterator[None]:
    """These tests make their data with torch's default dtype."""
    previous = torch.get_default_dtype()
    if request.module.__name__.rpartition(".")[2] not in AS_USERS_HAVE_IT:
        torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(previous)
