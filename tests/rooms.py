"""Lines of code of torchid by room beside the budget of each; a package beside torchid is a room.

python -m tests.rooms [--write]

Comments, docstrings (of attributes too) and blank lines do not count. A room above its budget is an
error, and so is a raise of a budget that nothing pays. Two things may: a fall of the same landing,
and a reserve, to which half of what a landing's budgets fall by in sum may be added, for what later
ones add. A room that is built to replace another has a line of its own until the switch, when the
old room's fall pays for it:

    heart = 3600
    reserve = 150
    [replaces]
    heart = "gap"
"""

import argparse
import ast
import io
import subprocess
import tokenize
import tomllib
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

from tests.documents import PACKAGES, ROOT

BUDGETS = Path(__file__).with_suffix(".toml")
MAIN = ("origin/main", "main")
"""Names of the branch that landings are made on."""
_NO_CODE = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT,
    tokenize.ENDMARKER, tokenize.ENCODING,
}  # fmt: skip


@dataclass(frozen=True)
class Budgets:
    """A file of budgets."""

    lines: dict[str, int]
    """Of each room."""
    replaces: dict[str, str] = field(default_factory=dict)
    """Rooms that are being built, with the room that each replaces."""
    reserve: int = 0
    """Of lines that went, those that what is new may still use."""

    @classmethod
    def parse(cls, text: str) -> "Budgets":
        """Read a text of TOML."""
        entries = tomllib.loads(text)
        replaces, reserve = entries.pop("replaces", {}), entries.pop("reserve", 0)
        return cls(entries, replaces, reserve)

    @property
    def text(self) -> str:
        """Such a text."""
        head = "# Lines of code that a room may have (tests/rooms.py)."
        entries = self.lines | ({"reserve": self.reserve} if self.reserve else {})
        lines = [f"{name} = {lines}" for name, lines in sorted(entries.items())]
        replaces = [f'{new} = "{old}"' for new, old in sorted(self.replaces.items())]
        return "\n".join([head, *lines, *(["[replaces]", *replaces] if replaces else ()), ""])

    @property
    def counted(self) -> dict[str, int]:
        """Of each room but those that are being built."""
        return {room: n for room, n in self.lines.items() if room not in self.replaces}


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


def budgets() -> Budgets:
    """Those of the working tree."""
    return Budgets.parse(BUDGETS.read_text())


def above(found: Counter[str], allowed: dict[str, int]) -> list[str]:
    """What is wrong: rooms above their budget, and rooms without one."""
    return [
        f"{room}: {lines} lines of code, budget {allowed.get(room, 'none')}"
        for room, lines in sorted(found.items())
        if lines > allowed.get(room, 0)
    ]


def unpaid(before: Budgets, now: Budgets) -> list[str]:
    """What is wrong with the budgets of a landing: a sum above the one that it starts from by more
    than the reserve falls, a reserve that rises by more than half of what the sum falls, or is
    overdrawn, a room being built that replaces none, or that is allowed more than the one it
    replaces."""
    wrong = []
    for new, old in sorted(now.replaces.items()):
        if old not in now.counted:
            wrong.append(f"{new} replaces {old}, which has no budget: take it out of [replaces]")
        elif now.lines.get(new, 0) > now.lines[old]:
            wrong.append(f"{new}: {now.lines[new]} lines replace the {now.lines[old]} of {old}")
    old, new = before.counted, now.counted
    rise, spent = sum(new.values()) - sum(old.values()), before.reserve - now.reserve
    if rise > max(spent, 0):
        changes = {room: new.get(room, 0) - old.get(room, 0) for room in sorted({*old, *new})}
        named = ", ".join(f"{room} {by:+d}" for room, by in changes.items() if by)
        paid = f"of which the reserve pays {spent}" if spent > 0 else "which no fall pays"
        wrong.append(f"budgets rise by {rise} lines, {paid}: {named}")
    if -spent > (half := max(-rise, 0) // 2):
        wrong.append(f"reserve rises by {-spent}, and half of what went is {half}")
    if now.reserve < 0:
        wrong.append(f"reserve is overdrawn: {now.reserve}")
    return wrong


def _git(*arguments: str) -> str | None:
    """What git prints; None where it cannot tell."""
    try:
        done = subprocess.run(
            ["git", *arguments], cwd=ROOT, check=False, capture_output=True, text=True
        )
    except FileNotFoundError:
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def start() -> tuple[str, Budgets] | None:
    """The commit that a landing starts from, and its budgets: on a branch the one where it left
    main; on main HEAD where budgets are changed and not committed, else the parent of HEAD. None
    without git, or where its history does not reach so far."""
    head = _git("rev-parse", "HEAD")
    forks = (_git("merge-base", "HEAD", name) for name in MAIN)
    fork = next((commit for commit in forks if commit), head)
    if fork == head:
        changed = _git("status", "--porcelain", "--", str(BUDGETS))
        fork = head if changed else _git("rev-parse", "HEAD^")
    text = _git("show", f"{fork}:./{BUDGETS.relative_to(ROOT)}") if fork else None
    return (fork, Budgets.parse(text)) if fork and text else None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="today's lines become the budgets")
    found, now = rooms(), budgets()
    if parser.parse_args().write:
        rounded = {room: -(-lines // 10) * 10 for room, lines in found.items()}
        now = replace(now, lines=rounded)
        BUDGETS.write_text(now.text)
    allowed = now.lines
    for room, lines in sorted(found.items(), key=lambda item: -item[1]):
        print(f"{lines:6d} of {allowed.get(room, 0):6d}  {room}")
    for of, rooms_of in (("torchid", found.keys() - PACKAGES), ("all packages", found.keys())):
        lines, budget = (sum(n.get(room, 0) for room in rooms_of) for n in (found, allowed))
        print(f"{lines:6d} of {budget:6d}  lines of code of {of}")
    print(f"{now.reserve:6d}            in reserve")
    wrong = above(found, allowed)
    if began := start():
        print(f"beside the budgets of {began[0][:8]}: {sum(began[1].counted.values())}")
        wrong += unpaid(began[1], now)
    else:
        print("not compared with earlier budgets: git has none here")
    if wrong:
        raise SystemExit("; ".join(wrong))


if __name__ == "__main__":
    main()
