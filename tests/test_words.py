"""The pages in plain words: no forbidden ones, short sentences, a short README."""

import ast
import re
import statistics
from functools import cache
from pathlib import Path

import pytest

from tests.documents import ROOT, blocks, prose, sources

GLOSSARY = ROOT / "docs/glossary.md"
README = ROOT / "README.md"
PAGES = [
    README,
    *(p for p in sorted((ROOT / "docs").glob("*.md")) if p.name != "effects.md"),
]
"""What people write; the catalogue of the effects is written by a program."""
FORBIDDEN = blocks(GLOSSARY, "text")[0].split("\n")[:-1]


def _paragraphs(text: str) -> list[str]:
    """Of the prose: list items apart, no tables, headings or pictures, links by their words."""
    text = re.sub(r"!\[[^\]]*\]\([^)]*\)", "", text)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    found, now = [], []
    for line in [*text.splitlines(), ""]:
        kept = not re.match(r"\s*(\||#)", line)
        item = re.match(r"\s*([-*]|\d+\.)\s+(.*)", line)
        if now and (not kept or not line.strip() or item):
            found.append(" ".join(now))
            now = []
        if kept and line.strip():
            now.append(item.group(2) if item else line.strip())
    return found


def sentences(text: str) -> list[str]:
    """Each ends with its paragraph, or with a full stop, question or exclamation mark."""
    parts = [re.split(r"(?<=[.!?])[*)\"]*\s+(?=[^a-z\s])", p) for p in _paragraphs(text)]
    return [s for part in parts for s in part if len(s.split()) > 1]


def _words(page: Path) -> str:
    """Without code: one word stands for each piece of it."""
    fences = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    return re.sub(r"`[^`\n]*`", "code", fences)


def test_the_splitter() -> None:
    text = "# A title.\n\nOne two. Three four\nfive: six.\n\n- seven [eight](x) e.g. z\n\n| a b |\n"
    assert sentences(text) == ["One two.", "Three four five: six.", "seven eight e.g. z"]


def test_the_list_is_read() -> None:
    assert {"told", "what is left"} <= set(FORBIDDEN)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_forbidden_words(page: Path) -> None:
    text = " ".join(prose(page).split())
    found = [
        text[max(match.start() - 40, 0) : match.end() + 20]
        for words in FORBIDDEN
        for match in re.finditer(rf"\b{words}\b", text, re.IGNORECASE)
    ]
    assert not found


def test_sentences_are_short() -> None:
    lengths = [len(s.split()) for page in PAGES for s in sentences(_words(page))]
    assert len(lengths) > 500
    assert statistics.median(lengths) <= 18


def test_the_readme_is_short() -> None:
    lines = README.read_text().splitlines()
    assert len(lines) <= 200
    assert max(map(len, lines)) <= 130


@cache
def _strings() -> list[tuple[str, str]]:
    """What the program prints: strings of its sources that are no docstrings, with their places."""
    out = []
    for path in sources():
        tree = ast.parse(path.read_text())
        alone = {id(n.value) for n in ast.walk(tree) if isinstance(n, ast.Expr)}
        out += [
            (f"{path.relative_to(ROOT)}:{n.lineno}", n.value)
            for n in ast.walk(tree)
            if isinstance(n, ast.Constant) and isinstance(n.value, str) and id(n) not in alone
        ]
    return out


RIDDLES = (
    "motions that want it",
    "the causes close",
    "what the causes closed",
    "that this log cannot separate from it",
    "present, below what was asked for",
    "Mind this number",
    "Change your log",
    "of it can be separated from",
    "does not say how sure it is: its",
    "non-repeatable effect",
    "which favours it",
    "what was known before did not determine",
    "the data ask for a sign",
    "least known of",
    "Leave the window out",
    "(ours)",
    "what it rests on",
    "as its own velocities tell",
    "with the effects found",
    "mrad with what was found",
)
"""Phrases that stopped a reader, each with a plain form in its place."""


@pytest.mark.parametrize("riddle", RIDDLES)
def test_no_riddle_is_printed(riddle: str) -> None:
    pages = {str(page): " ".join(prose(page).split()) for page in PAGES}
    assert [place for place, text in (*_strings(), *pages.items()) if riddle in text] == []


@pytest.mark.slow
def test_no_forbidden_words_are_printed() -> None:
    found = re.compile(rf"\b({'|'.join(map(re.escape, FORBIDDEN))})\b", re.IGNORECASE)
    assert [(place, text) for place, text in _strings() if found.search(text)] == []
