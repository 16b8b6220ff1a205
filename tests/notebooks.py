"""Notebooks as they are stored: `python -m tests.notebooks [NAME..]` (`make notebooks`).

Runs them and keeps what they print and draw. What differs from run to run without a reason is left
out: times, folders, warnings of packages. Pictures have few colours and small files.
"""

import argparse
import base64
import io
import os
import re
import tempfile
from pathlib import Path
from typing import Any

import nbclient
import nbformat

FOLDER = Path(__file__).parents[1] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
COLOURS = 48
"""Of a stored picture: lines, bars and their smooth edges."""
LONGEST_S = 1200
"""That a cell may take [s]."""


def executed(path: Path, folder: Path) -> Any:
    """A notebook after a run from top to bottom in a folder, where what it writes stays."""
    notebook = nbformat.read(path, as_version=4)
    client = nbclient.NotebookClient(
        notebook, timeout=LONGEST_S, kernel_name="python3", resources={"metadata": {"path": folder}}
    )
    client.execute()
    return notebook


def stored(notebook: Any, folder: Path) -> Any:
    """The same as it is stored: without times and names of the folder, with light pictures."""
    notebook.metadata = {
        "kernelspec": notebook.metadata["kernelspec"],
        "language_info": {"name": "python"},
    }
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
        if cell.cell_type == "code":
            cell.outputs = [light(x, folder) for x in cell.outputs if x.get("name") != "stderr"]
    return notebook


def light(output: Any, folder: Path) -> Any:
    """An output with small pictures, without the folder's name."""
    data = output.get("data", {})
    if "image/png" in data:
        data["image/png"] = small_png(data["image/png"])
        data.pop("text/plain", None)
    for holder, name in ((data, "text/plain"), (data, "text/html"), (output, "text")):
        if name in holder:
            holder[name] = re.sub(rf"{re.escape(str(folder))}[^\s'\")<]*/", "", holder[name])
    return output


def small_png(text: str) -> str:
    """A picture in base64 with few colours."""
    from PIL import Image

    small = io.BytesIO()
    picture = Image.open(io.BytesIO(base64.b64decode(text))).convert("RGB")
    picture.quantize(COLOURS).save(small, "png", optimize=True)
    return base64.b64encode(small.getvalue()).decode()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="the first letters of some; all by default")
    names = tuple(parser.parse_args().names)
    for path in NOTEBOOKS:
        if not names or path.stem.startswith(names):
            with tempfile.TemporaryDirectory() as name:
                os.environ["TMPDIR"] = name
                notebook = stored(executed(path, Path(name)), Path(name))
            nbformat.write(notebook, path)
            print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB", flush=True)


if __name__ == "__main__":
    main()
