"""The public names: listed once, typed, quick to import, each with an example that runs."""

import ast
import doctest
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

import torchid

NAMES = [name for name in torchid.__all__ if name != "__version__"]


@pytest.mark.parametrize("name", NAMES)
def test_example_runs(name: str) -> None:
    """As a user runs it: with torch's own default dtype."""
    torch.set_default_dtype(torch.float32)
    thing = getattr(torchid, name)
    module = sys.modules[thing.__module__]
    finder = doctest.DocTestFinder(recurse=False)
    (test,) = finder.find(thing, name, module=module, globs=vars(module).copy())
    assert test.examples, f"{name} has no example"
    assert not doctest.DocTestRunner().run(test).failed


def test_names_are_the_same_for_people_and_type_checkers() -> None:
    folder = Path(torchid.__file__).parent
    checked = {
        alias.asname: node.module
        for node in ast.parse((folder / "__init__.pyi").read_text()).body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert checked == torchid._PUBLIC
    assert set(NAMES) == set(checked)
    assert set(NAMES) <= set(dir(torchid))
    assert (folder / "py.typed").exists()


def test_import_is_quick_and_loads_no_numerics() -> None:
    code = (
        "import sys, torchid; print([m for m in ('torch', 'numpy', 'scipy') if m in sys.modules])"
    )
    environment = os.environ | {"PYTHONPATH": str(Path(torchid.__file__).parents[1])}
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-c", code],
        capture_output=True, text=True, check=True, env=environment,
    )  # fmt: skip
    assert done.stdout.strip() == "[]"
    (line,) = [x for x in done.stderr.splitlines() if x.endswith("| torchid")]
    assert float(line.split("|")[1]) < 2e6, "microseconds"


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = torchid.no_such_name
