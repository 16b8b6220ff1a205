"""Whether a probability can be bet on: of names and suspects, how often they are right.

    python -m torchid_bench.benchmarks.gap_calibration --planted DIR [--sealed SET KEYS] [--figure FILE]

DIR is the folder of `gap_planted.py`: effects planted into real logs. What is named or suspected in
the same log without anything planted is no new claim. SET is a folder of `torchid withheld` that is
answered, KEYS its keys. A claim is right if it names the effect on a joint that feels it, alone or
in its set. Claims are sorted into bins of equal width in log odds; the expected calibration error
is the mean distance between what a bin says and how often it is right, weighted by claims.
"""

import itertools
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from torchid_bench.benchmarks.gap_planted import identity, names_it
from torchid_bench.benchmarks.runner import command, table

EDGES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.97, 1.0)


def claims_of(answer: dict[str, Any]) -> list[Any]:
    """Names and suspects of an answer."""
    found = [*answer.get("which", ()), *answer.get("answer", {}).get("suspects", ())]
    return [c for c in found if c.get("how_sure") is not None]


def claims_on_planted(folder: Path) -> Iterator[tuple[float, bool]]:
    """Probability and truth of every new claim about planted effects."""
    for none in sorted(folder.glob("*/none.json")):
        before = {identity(c) for c in claims_of(json.loads(none.read_text()))}
        for file in sorted(none.parent.glob("*-*.json")):
            case = json.loads(file.read_text())
            for c in claims_of(case["answer"]):
                right = names_it(case["planted"], c, in_set=True)
                if right or identity(c) not in before:
                    yield c["how_sure"], right


def claims_on_sealed(folder: Path, keys: Path) -> Iterator[tuple[float, bool]]:
    """Those about a sealed set; what is planted outside the library makes every claim wrong."""
    document = json.loads(keys.read_text())
    for key in document["cases"] if isinstance(document, dict) else document:
        answer = json.loads((folder / key["id"] / "answer.json").read_text())
        truth = {(e["name"], j) for e in key["effects"] for j in (*e["joints"], None)}
        for c in claims_of(answer):
            names = {c["effect"], *c.get("ambiguous_with", ())}
            where = {None, *c.get("located", c["joints"])}
            yield c["how_sure"], any(name in names and j in where for name, j in truth)


def bins(claims: list[tuple[float, bool]]) -> list[tuple[str, int, float, float]]:
    """Rows: bin, claims, mean probability, share that is right."""
    sure, right = np.array(claims, dtype=float).reshape(-1, 2).T
    rows = []
    for low, high in itertools.pairwise(EDGES):
        inside = (sure >= low) & ((sure < high) | (high == 1.0))
        if inside.any():
            said, true = sure[inside].mean(), right[inside].mean()
            rows.append((f"{low:g} - {high:g}", int(inside.sum()), said, true))
    return rows


def main(
    *,
    planted: Path | None = None,
    sealed: tuple[Path, Path] | None = None,
    figure: Path | None = None,
) -> None:
    """Print a table of each source, and draw them."""
    sources = {"planted in real logs": list(claims_on_planted(planted)) if planted else []}
    sources["sealed, simulated"] = list(claims_on_sealed(*sealed)) if sealed else []
    binned = {name: bins(claims) for name, claims in sources.items() if claims}
    for name, rows in binned.items():
        sure, right = np.array(sources[name], dtype=float).T
        error = sum(n * abs(said - true) for _, n, said, true in rows) / len(sure)
        brier = ((sure - right) ** 2).mean()
        print(f"{name}: {len(sure)} claims, calibration error {error:.3f}, Brier {brier:.3f}")
        cells = [(where, n, f"{said:.2f}", f"{true:.2f}") for where, n, said, true in rows]
        table(("probability", "claims", "said", "right"), cells)
    if figure:
        draw(binned, figure)


def draw(binned: dict[str, list[tuple[str, int, float, float]]], file: Path) -> None:
    """The reliability diagram."""
    from torchid.report.colours import AFTER, BEFORE, GREY
    from torchid.report.panels import finish, panel

    figure, axes = panel(5.2, 4.8)
    axes.plot([0, 1], [0, 1], color=GREY, linewidth=1.0)
    for (name, rows), colour in zip(binned.items(), (BEFORE, AFTER), strict=False):
        said, right = [r[2] for r in rows], [r[3] for r in rows]
        axes.plot(said, right, color=colour, linewidth=1.2, label=name)
        axes.scatter(said, right, s=[10 + 4 * r[1] for r in rows], color=colour)
    axes.set(xlim=(0, 1.02), ylim=(0, 1.02), xlabel="probability that is said", ylabel="right")
    finish(figure, "how sure, and how often right", axes).savefig(file, dpi=130)


if __name__ == "__main__":
    command(main)
