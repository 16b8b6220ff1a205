"""Store the golden files anew: `python -m tests.golden.write options schemas [NAME ...]`."""

import json
import sys
import tempfile
from pathlib import Path
from types import ModuleType

from tests.golden.documents import DOCUMENTS, Bench
from tests.golden.options import STORED, table
from tests.golden.shapes import shape
from tests.torchid_bench.withheld.fakes import draw_case, simulate_case


def write_options() -> None:
    STORED.write_text(json.dumps(table(), indent=1) + "\n")


def write_schemas(names: list[str]) -> None:
    """Of these documents, or of all."""
    stand_in = ModuleType("torchid_bench.withheld.plant.case")
    stand_in.draw_case = draw_case  # type: ignore[attr-defined]
    stand_in.simulate_case = simulate_case  # type: ignore[attr-defined]
    sys.modules[stand_in.__name__] = stand_in
    folder = STORED.parent / "schemas"
    folder.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as made:
        bench = Bench(Path(made))
        for name in names or DOCUMENTS:
            text = json.dumps(shape(DOCUMENTS[name](bench)), indent=0)
            (folder / f"{name}.json").write_text(text + "\n")


if __name__ == "__main__":
    asked = sys.argv[1:]
    if "options" in asked:
        write_options()
    if "schemas" in asked:
        write_schemas([name for name in asked if name in DOCUMENTS])
