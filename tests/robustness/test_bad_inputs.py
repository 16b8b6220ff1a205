"""Whatever a command is given: one clear error, exit code 1 or 2, no traceback, nothing written."""

import pytest

from tests.robustness.table import COMMANDS, Table, beside

pytestmark = pytest.mark.slow
COUNTS: list[int] = []


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    return Table.made(tmp_path_factory.mktemp("table"))


@pytest.mark.parametrize("name", COMMANDS, ids=" ".join)
def test_bad_inputs_of(table, name) -> None:
    cases = list(table.cases(name))
    COUNTS.append(len(cases))
    assert not [fault for case in cases if (fault := table.run(case))]


def test_files_that_are_not_named_first(table) -> None:
    assert not [fault for case in beside(table.folder) if (fault := table.run(case))]


def test_the_table_is_long() -> None:
    """Of those commands that were run."""
    assert sum(COUNTS) > 15 * len(COUNTS)
