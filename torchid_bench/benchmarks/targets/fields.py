"""The table of docs/export.md on fields that some releases of MuJoCo have: each release is asked.

    python -m torchid_bench.benchmarks.targets.fields [FOLDER...] [--page docs/export.md]

FOLDER holds another release, as `pip install --target FOLDER mujoco==3.12.0` puts it; the installed
one comes last.
"""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from torchid.export.releases import FIELDS
from torchid_bench.benchmarks.runner import command, table

_ASK = """
import json, mujoco
from torchid.export.releases import FIELDS, has_field
print(json.dumps([mujoco.__version__, {name: has_field(name) for name in FIELDS}]))
"""


def asked(folder: Path | None) -> tuple[str, dict[str, bool]]:
    """A release and the fields that it has.

    Args:
        folder: with a release; None for the installed one.
    """
    paths = [str(folder)] if folder else []
    path = os.pathsep.join([*paths, os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", _ASK], env=os.environ | {"PYTHONPATH": path},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    version, has = json.loads(done.stdout.splitlines()[-1])
    return version, has


def main(folders: Sequence[Path] = (), *, page: Path | None = None) -> None:
    """Print the table, and put it into a page."""
    releases = [asked(folder) for folder in (*folders, None)]
    heads = ["what is found", "field", *(version for version, _ in releases), "without it"]
    said = {True: "yes", False: "no"}
    rows = [
        (f.found, f.field, *(said[own[name]] for _, own in releases), f.without)
        for name, f in FIELDS.items()
    ]
    table(heads, rows, page=page)


if __name__ == "__main__":
    command(main)
