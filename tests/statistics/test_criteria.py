"""The numbers that decide an answer: few, each with its reason, and open to be doubled."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from torchid.statistics import criteria

MOST = 48
"""Twenty of causes, eighteen of the doctor, ten of servos."""
SOURCE = ast.parse(Path(criteria.__file__).read_text())
NAMES = [name for name in vars(criteria) if name.isupper()]


def test_they_are_few():
    assert 0 < len(NAMES) <= MOST


def test_each_has_a_reason_and_a_unit():
    for number, reason in zip(SOURCE.body[1::2], SOURCE.body[2::2], strict=True):
        assert isinstance(number, ast.Assign)
        text = ast.literal_eval(reason.value)
        assert "[" in text, f"no unit: {text}"


@pytest.mark.parametrize("name", NAMES)
def test_each_is_read_where_answers_are_made(name):
    package = Path(criteria.__file__).parents[1]
    readers = [
        p for p in package.rglob("*.py") if "criteria import" in (t := p.read_text()) and name in t
    ]
    assert readers


def test_a_number_changed_first_is_what_the_diagnosis_reads():
    """As the benchmark `criteria` changes them: before anything that reads them is imported."""
    changed = (
        "import torchid.statistics.criteria as c; c.WORTHWHILE = 0.2;"
        "from torchid.gap.settings import GapSettings; print(GapSettings().worthwhile)"
    )
    done = subprocess.run(
        [sys.executable, "-c", changed], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["0.2"]


def test_no_number_is_defined_twice():
    targets = [t for node in SOURCE.body if isinstance(node, ast.Assign) for t in node.targets]
    names = [n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)]
    assert len(names) == len(set(names))
