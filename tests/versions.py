"""Constraints for pip: the lowest versions that pyproject.toml allows, said nowhere else.

    python -m tests.versions lowest > lowest.txt
    python -m tests.versions lowest torch==2.13.0 > lowest.txt
    python -m tests.versions newest torch==2.13.0 > newest.txt

Requirements named on the command line take the place of the lowest ones, and are all that is said
of the newest. Tools that only tests and lint need are left at whatever is newest.
"""

import re
import sys
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path

PYPROJECT = Path(__file__).parents[1] / "pyproject.toml"
TOOLS = ("dev", "docs", "bench")
"""Extras that no user of torchid installs to use it."""


def lowest(project: dict) -> Iterator[str]:
    """`name==version` of every requirement with a lower bound, of torchid and of its extras."""
    required = list(project["dependencies"])
    for extra, names in project["optional-dependencies"].items():
        required += [] if extra in TOOLS else names
    for one in required:
        found = re.match(r"([\w.-]+)>=([\w.]+)", one)
        if found is None:
            raise SystemExit(f"'{one}' of pyproject.toml has no lower bound.")
        yield f"{found[1]}=={found[2]}"


def constraints(kind: str, others: Sequence[str]) -> list[str]:
    """Lines of a file of constraints, for the `lowest` or the `newest` versions."""
    if kind not in ("lowest", "newest"):
        raise SystemExit(f"'{kind}' is neither lowest nor newest.")
    if kind == "newest":
        return list(others)
    replaced = {re.split(r"[=<>]", other)[0] for other in others}
    project = tomllib.loads(PYPROJECT.read_text())["project"]
    return [x for x in lowest(project) if x.split("==")[0] not in replaced] + list(others)


if __name__ == "__main__":
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    print("\n".join(constraints(sys.argv[1], sys.argv[2:])))
