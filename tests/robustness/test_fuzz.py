"""Readers on damaged files: those that were found, some new ones, and changes by hypothesis."""

import random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.robustness.fuzz import CORPUS, changed, fault, fuzz, placed, read, seeds

FOUND = sorted(CORPUS.glob("*")) if CORPUS.is_dir() else []


@pytest.mark.slow
@pytest.mark.parametrize("path", FOUND, ids=lambda path: path.name)
def test_what_was_found_stays_mended(path) -> None:
    assert fault(path) is None


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("good")
    return folder, seeds(folder)


REFUSED = ("merged.yaml", "fleet.csv")
"""Of the files that are changed those that are no log, robot, model or result as they are."""


@pytest.mark.slow
def test_good_files_are_read(good) -> None:
    """Else changes of them would tell nothing."""
    folder, files = good
    for name, content in files.items():
        if name not in REFUSED:
            read(placed(folder, name, content)[1])


@pytest.mark.nightly
def test_damaged_files_end_in_one_error(tmp_path) -> None:
    found = fuzz(tmp_path, 20, minutes=2, count=2000, keep=None)
    assert found.pop("") > 100
    assert not found


@pytest.mark.nightly
@settings(
    max_examples=300, derandomize=True,
    suppress_health_check=list(HealthCheck),
)  # fmt: skip
@given(data=st.data())
def test_changes_by_hypothesis(good, data) -> None:
    folder, files = good
    names = list(files)
    name = data.draw(st.sampled_from(names))
    choose = random.Random(data.draw(st.integers(0, 2**32)))
    content = changed(files[name], files[data.draw(st.sampled_from(names))], choose)
    file, path = placed(folder, name, content)
    wrong = fault(path)
    file.write_bytes(files[name])
    assert wrong is None
