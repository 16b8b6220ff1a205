"""Whatever a command is given: one clear error, exit code 1 or 2, no traceback, nothing written."""

import pytest

from tests.robustness.table import COMMANDS, Table, beside

pytestmark = pytest.mark.slow

LONG = ("extract", "wrenches")
"""Commands whose rows take half a minute."""


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    return Table.made(tmp_path_factory.mktemp("table"))


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.nightly) if " ".join(n) in LONG else n for n in COMMANDS],
    ids=" ".join,
)
def test_bad_inputs_of(table, name) -> None:
    assert not [fault for case in table.cases(name) if (fault := table.run(case))]


def test_files_that_are_not_named_first(table) -> None:
    assert not [fault for case in beside(table.folder) if (fault := table.run(case))]


@pytest.mark.parametrize("name", COMMANDS, ids=" ".join)
def test_every_option_has_a_row(table, name) -> None:
    """Of those that take a value; so that a new command or option cannot do without."""
    assert table.without(name) == []


@pytest.mark.parametrize("kind", ["robots", "logs", "results"])
def test_every_bad_file_is_given_to_some_command(table, kind) -> None:
    given = {word for name in COMMANDS for case in table.files(name) for word in case.arguments}
    every = {str(path): text for text, path in getattr(table, kind).items()}
    assert sorted(every[path] for path in every.keys() - given) == []
