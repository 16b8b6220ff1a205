"""The public names: listed once, typed, quick to import, each with an example that runs."""

import ast
import doctest
import inspect
import os
import re
import subprocess
import sys
import typing
from pathlib import Path

import pytest
import torch

import torchid
from tests.documents import PACKAGES, ROOT, sources
from torchid.next_motion.settings import MotionSettings

NAMES = [name for name in torchid.__all__ if name != "__version__"]
LONG = (
    "Diagnosis", "correct", "diagnose", "equal_torque_study", "examine",
    "excite_for", "randomise",
)  # fmt: skip
"""Names whose example takes more than half a second."""


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow) if n in LONG else n for n in NAMES]
)
@pytest.mark.usefixtures("types_unchecked")
def test_example_runs(name: str) -> None:
    """As a user runs it: types unchecked, with torch's own default dtype."""
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


def _held(thing: object) -> set[type]:
    """Torchid's classes in the annotations of a function, or of a class's fields and methods."""
    own = [thing]
    if inspect.isclass(thing):
        own += [
            member.fget if isinstance(member, property) else getattr(thing, name)
            for name, member in vars(thing).items()
            if not name.startswith("_")
        ]
    found: set[type] = set()
    for one in own:
        try:
            hints = list(typing.get_type_hints(one).values())
        except (TypeError, NameError):  # no annotations, or of what is imported by type checkers
            continue
        while hints:
            hint = hints.pop()
            hints += typing.get_args(hint)
            if inspect.isclass(hint) and hint.__module__.partition(".")[0] in PACKAGES:
                found.add(hint)
    return found


def test_reference_has_every_name_and_what_it_takes_and_returns() -> None:
    """All classes that a user can meet on the way from a public name have one entry each."""
    pages = "\n".join(page.read_text() for page in (ROOT / "docs/api").glob("*.rst"))
    written = re.findall(r"^\.\. auto(?:class|function):: (\S+)$", pages, re.MULTILINE)
    assert len(set(written)) == len(written)
    public = {getattr(torchid, name): f"torchid.{name}" for name in NAMES}
    seen: set[object] = set()
    todo: set[object] = set(public)
    while todo:
        thing = todo.pop()
        seen.add(thing)
        todo |= _held(thing) - seen
    wanted = {public.get(t) or f"{t.__module__}.{t.__qualname__}" for t in seen}  # type: ignore[attr-defined]
    assert len(wanted) > 2 * len(NAMES)
    assert sorted(wanted - set(written)) == []


@pytest.mark.parametrize("name", NAMES)
def test_every_name_says_what_it_takes_returns_and_raises(name: str) -> None:
    thing = getattr(torchid, name)
    text = inspect.getdoc(thing) or ""
    if inspect.isclass(thing):
        return
    for argument in inspect.signature(thing).parameters:
        assert re.search(rf"^ +(\w+, )*{argument}(, \w+)*: ", text, re.MULTILINE), argument
    assert "\nRaises:\n" in text


def test_defaults_of_the_commands_are_those_of_the_functions() -> None:
    """Where a command must not import the function to know them."""
    asked = MotionSettings()
    for name, parameter in inspect.signature(torchid.excite).parameters.items():
        if name in ("duration", "harmonics", "restarts", "usage", "seed", "effects"):
            assert parameter.default == getattr(asked, name), name


def _messages(source: str) -> list[str]:
    """Strings of a module that are no documentation; what stands in the braces left out."""
    found, skipped = [], set()
    for node in ast.walk(ast.parse(source)):  # parents before children
        if isinstance(node, ast.Expr):
            skipped.add(node.value)
        elif isinstance(node, ast.JoinedStr):
            parts = [p for p in node.values if isinstance(p, ast.Constant)]
            skipped |= set(parts)
            found.append("".join(p.value for p in parts))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found += [node.value] if node not in skipped else []
    return found


@pytest.mark.slow
def test_messages_speak_of_arguments() -> None:
    """Only the command line has options; a message elsewhere names one in a whole command, or
    beside what it is in Python."""
    below = [p for p in sources() if not {"app", "report"} & set(p.parts)]
    assert len(below) > 200
    option = re.compile(r"(?<![\w-])--[a-z]")
    both = ("torchid ", "on the command line", "Log.with_torque", "xcode-select")
    wrong = [
        f"{path.name}: {text}"
        for path in below
        for text in _messages(path.read_text())
        if option.search(text) and not any(words in text for words in both)
    ]
    assert wrong == []
