"""Draws the rooms of torchid on their floors, and what each imports from: design.md's picture.

`python docs/draw_house.py`: floors as import-linter checks them, widths by lines of code. Arrows go
down; those that nearly every room has, to errors, files, tensors and typing, are left out.
"""

import ast
import tomllib
from collections import Counter
from pathlib import Path

from matplotlib.patches import Rectangle

from tests.documents import ROOT, sources
from tests.rooms import rooms
from torchid.report.colours import BLUE, GREY, INK
from torchid.report.panels import new_figure, save

IMAGES = Path(__file__).parent / "img"
FEWEST = 2
"""Files of a room that import from another one, from which on there is an arrow."""
WIDTH, GAP, HEIGHT = 100.0, 1.2, 0.62
"""Of the house, between rooms, and of a room on a floor of height 1."""
NAME = 0.95
"""Width that a letter of a room's name takes."""


def floors(lines: Counter[str]) -> list[list[str]]:
    """Rooms by floor, the highest first, of those that are folders."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    whole = next(c for c in settings["contracts"] if c["name"] == "Imports point down only")
    names = [[x.strip() for x in layer.split("|")] for layer in whole["layers"]]
    folders = [[x.removeprefix("torchid.") for x in layer] for layer in names]
    return [on for layer in folders if (on := [room for room in layer if room in lines])]


def imports() -> Counter[tuple[str, str]]:
    """How many files of a room import from another one."""
    out: Counter[tuple[str, str]] = Counter()
    for path in sources():
        parts = path.relative_to(ROOT).parts
        if parts[0] != "torchid" or len(parts) < 3:
            continue
        names = [
            node.module or ""
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.ImportFrom)
        ]
        rooms_of = {n.split(".")[1] for n in names if n.startswith("torchid.")}
        out.update((parts[1], room) for room in rooms_of - {parts[1]})
    return out


def draw() -> None:
    """Write the picture."""
    lines = rooms()
    levels = floors(lines)
    figure = new_figure(7.4, 0.47 * len(levels) + 0.2)
    axes = figure.subplots()
    scale = 0.75 * WIDTH / max(sum(lines[room] for room in on) for on in levels)
    places: dict[str, tuple[float, float]] = {}
    for k, on in enumerate(levels):
        y = len(levels) - k
        widths = [max(scale * lines[room], NAME * (len(room) + 6)) for room in on]
        x = (WIDTH - sum(widths) - GAP * (len(on) - 1)) / 2
        for room, width in zip(on, widths, strict=True):
            box = {"facecolor": "white", "edgecolor": INK, "linewidth": 0.8, "zorder": 2}
            axes.add_patch(Rectangle((x, y), width, HEIGHT, **box))
            text = f"{room}  {lines[room] / 1000:.1f}"
            axes.text(x + width / 2, y + HEIGHT / 2, text, fontsize=7, ha="center", va="center")
            places[room] = x + width / 2, y
            x += width + GAP
    for (above, below), files in imports().items():
        if files >= FEWEST and above in places and below in places:
            (x0, y0), (x1, y1) = places[above], places[below]
            line = {"color": BLUE if y0 > y1 else GREY, "alpha": 0.25, "zorder": 1}
            axes.plot([x0, x1], [y0, y1 + HEIGHT], linewidth=0.4 + 0.15 * files, **line)
    axes.set_xlim(0, WIDTH)
    axes.set_ylim(0.8, len(levels) + 0.9)
    axes.set_axis_off()
    save(figure, IMAGES / "house.png")


if __name__ == "__main__":
    draw()
