"""Lines of code of torchid by room beside the budget of each; a package beside torchid is a room.

python -m tests.rooms [--write]

Comments, docstrings (of attributes too) and blank lines do not count. A room above its budget is an
error: what is new is paid for in the same room, or the budget is raised by hand, with a reason.
"""

import argparse
import ast
import io
import tokenize
import tomllib
from collections import Counter
from pathlib import Path

from tests.documents import PACKAGES, ROOT

BUDGETS = Path(__file__).with_suffix(".toml")
_NO_CODE = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT,
    tokenize.ENDMARKER, tokenize.ENCODING,
}  # fmt: skip


def code_lines(text: str) -> int:
    """How many lines of a module hold code."""
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            lines.difference_update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(lines)


def rooms() -> Counter[str]:
    """Lines of code of each room: folders of torchid, files of its top as `top`, other packages,
    benchmarks included."""
    found: Counter[str] = Counter()
    for path in (path for name in PACKAGES for path in (ROOT / name).rglob("*.py")):
        package, *folders = path.relative_to(ROOT).parts[:-1]
        room = package if package != "torchid" else folders[0] if folders else "top"
        found[room] += code_lines(path.read_text())
    return found


def budgets() -> dict[str, int]:
    """The budget of each room."""
    return tomllib.loads(BUDGETS.read_text())


def above(found: Counter[str], allowed: dict[str, int]) -> list[str]:
    """What is wrong: rooms above their budget, and rooms without one."""
    return [
        f"{room}: {lines} lines of code, budget {allowed.get(room, 'none')}"
        for room, lines in sorted(found.items())
        if lines > allowed.get(room, 0)
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="today's lines become the budgets")
    found = rooms()
    if parser.parse_args().write:
        lines = [f"{room} = {-(-lines // 10) * 10}" for room, lines in sorted(found.items())]
        head = "# Lines of code that a room may have (tests/rooms.py)."
        BUDGETS.write_text("\n".join([head, *lines, ""]))
    allowed = budgets()
    for room, lines in sorted(found.items(), key=lambda item: -item[1]):
        print(f"{lines:6d} of {allowed.get(room, 0):6d}  {room}")
    for of, rooms_of in (("torchid", found.keys() - PACKAGES), ("all packages", found.keys())):
        lines, budget = (sum(n.get(room, 0) for room in rooms_of) for n in (found, allowed))
        print(f"{lines:6d} of {budget:6d}  lines of code of {of}")
    if wrong := above(found, allowed):
        raise SystemExit("above budget: " + "; ".join(wrong))


if __name__ == "__main__":
    main()
