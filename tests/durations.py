"""How many CPU seconds each test takes: a plugin that measures, and the table of the longest.

    make durations

A run with `-p tests.durations` writes a line for each test to build/durations, fixtures included;
`python -m tests.durations` makes tests/durations.md of all that lies there.
"""

import ast
import json
import os
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MADE = ROOT / "build" / "durations"
LONGEST = 150
"""Rows of the table."""


def _seconds() -> float:
    """Of this process and of those that it has started and that are over."""
    return sum(os.times()[:4])


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    begun = _seconds()
    try:
        return (yield)
    finally:
        MADE.mkdir(parents=True, exist_ok=True)
        line = [item.nodeid, round(_seconds() - begun, 2), _round(item)]
        with (MADE / f"{os.getpid()}.jsonl").open("a") as file:
            file.write(json.dumps(line) + "\n")


def _round(item: pytest.Item) -> str:
    marks = {mark.name for mark in item.iter_markers()}
    return "nightly" if "nightly" in marks else "CI" if marks & {"slow", "real"} else "quick"


@cache
def purposes(file: str) -> dict[str, str]:
    """What a file's tests are for: each one's first sentence, or that of the file."""
    tree = ast.parse((ROOT / file).read_text())
    whole = _sentence(ast.get_docstring(tree))
    return {
        node.name: _sentence(ast.get_docstring(node)) or whole
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
    }


def _sentence(text: str | None) -> str:
    words = " ".join((text or "").partition("\n\n")[0].split())
    return words.partition(". ")[0].rstrip(".").replace("|", "/")


def table(lines: list[tuple[str, float, str]]) -> str:
    """Markdown: the longest tests, those of one function together, and the sums of each round."""
    sums: Counter[str] = Counter()
    functions: Counter[tuple[str, str]] = Counter()
    cases: Counter[tuple[str, str]] = Counter()
    for name, seconds, which in lines:
        sums[which] += seconds
        functions[name.partition("[")[0], which] += seconds
        cases[name.partition("[")[0], which] += 1
    rows = []
    for (name, which), seconds in functions.most_common(LONGEST):
        file, _, function = name.rpartition("::")
        short = (
            f"`{file.removeprefix('tests/')}` {function.removeprefix('test_').replace('_', ' ')}"
        )
        count = f" ({cases[name, which]} cases)" if cases[name, which] > 1 else ""
        purpose = purposes(file.partition("::")[0]).get(function, "")
        rows.append(f"| {seconds:.1f} | {which} | {short}{count} | {purpose} |")
    whole = ", ".join(f"{which} {sums[which]:.0f} s" for which in ("quick", "CI", "nightly"))
    head = ["| CPU s | round | test | what it is for |", "|---|---|---|---|"]
    text = f"Sums: {whole}, without what processes take to start and to collect tests."
    return "\n".join(
        ["# The longest tests", "", f"Made by `make durations`. {text}", "", *head, *rows]
    )


if __name__ == "__main__":
    found = [tuple(json.loads(line)) for path in MADE.glob("*.jsonl") for line in path.open()]
    (ROOT / "tests" / "durations.md").write_text(table(found) + "\n")
