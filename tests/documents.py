"""The project's Markdown: its code blocks, commands and links."""

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("torchid", "torchid_study", "torchid_bench")
"""That come with one installation."""
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
_INLINE = re.compile(r"`[^`\n]*`")
_LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")


def sources() -> list[Path]:
    """The packages' modules, but for benchmarks, which are scripts."""
    every = (path for name in PACKAGES for path in (ROOT / name).rglob("*.py"))
    return sorted(path for path in every if "benchmarks" not in path.parts)


def blocks(page: Path, language: str) -> list[str]:
    """Fenced blocks of a language; "" for those without one, which hold commands or formats."""
    return [body for kind, body in _FENCE.findall(page.read_text()) if kind == language]


def commands(page: Path) -> list[list[str]]:
    """Arguments of every `torchid ...` line in the blocks, comments left out."""
    text = "".join(blocks(page, "")).replace("\\\n", " ").replace("&&", "\n")
    lines = [line.strip() for line in text.splitlines()]
    return [shlex.split(line, comments=True)[1:] for line in lines if line.startswith("torchid ")]


def prose(page: Path) -> str:
    """The page without fenced blocks and inline code."""
    return _INLINE.sub("", _FENCE.sub("", page.read_text()))


def links(page: Path) -> list[str]:
    """Targets of all links and images."""
    return _LINK.findall(prose(page))


def named_files(page: Path) -> list[str]:
    """Paths in inline code that name a file or folder of the project: with a slash and, unless they
    end with one, a suffix; patterns and what a command writes (`out/`, `build/`) left out."""
    found = [code.strip("`") for code in _INLINE.findall(_FENCE.sub("", page.read_text()))]
    top = {path.name for path in ROOT.iterdir()} - {"build"}
    return [
        name
        for name in found
        if re.fullmatch(r"[\w./-]+", name)
        and "/" in name
        and (name.split("/")[0] in top or name.endswith((".py", ".md", ".yaml")))
    ]


def anchors(page: Path) -> set[str]:
    """Anchors of the headings, as GitHub makes them."""
    text = _FENCE.sub("", page.read_text())
    headings = re.findall(r"^#{1,6} (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", h.lower()).strip().replace(" ", "-") for h in headings}
