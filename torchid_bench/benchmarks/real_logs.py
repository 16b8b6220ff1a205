"""Held-out torque errors on real logs, beside published figures; the tables of docs/results.md.

    python -m torchid_bench.benchmarks.real_logs DATA

DATA is a folder with the public logs named in docs/results.md, converted to one table a log. They
are not part of this project: most of their licences do not allow it.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import sympy
import torch

from torchid.identification.base_parameters import BaseParameters
from torchid.identification.identify import Identification, Settings, identify
from torchid.log.model import Log
from torchid.log.readers import read_log
from torchid.robot.library import load_robot
from torchid.yaml_data import parsed_yaml
from torchid_bench.benchmarks.runner import command, table

UR10E_GAINS = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)


@dataclass(frozen=True)
class Line:
    """One line of the table: what to fit, what to predict, and what others reached."""

    label: str
    robot: str
    logs: tuple[str, ...]
    held_out: str | float
    cutoff: float
    rows: str
    reference: tuple[float, ...]
    method: str = "huber"


FILE = parsed_yaml(Path(__file__).with_suffix(".yaml").read_text())
LINES = {
    key: Line(**{name: tuple(x) if isinstance(x, list) else x for name, x in own.items()})
    for key, own in FILE["lines"].items()
}
PANDA: list[tuple[str, float, float]] = FILE["panda"]
A4, D3, D5, A7 = sympy.Float(0.0825), sympy.Float(0.316), sympy.Float(0.384), sympy.Float(0.088)
"""Lengths of the Panda [m]; the published groupings print their products rounded."""


def read(data: Path, names: tuple[str, ...]) -> Log:
    log = read_log([data / name for name in names])
    if log.tau is None:
        log = log.with_torque(torch.tensor(UR10E_GAINS, dtype=torch.float64))
    return log


def run(line: Line, data: Path, **changes: object) -> Identification:
    settings = Settings(cutoff=line.cutoff, rows=line.rows, method=line.method)  # type: ignore[arg-type]
    if isinstance(line.held_out, float):
        settings = replace(settings, held_out_fraction=line.held_out)
        held_out = None
    else:
        held_out = read(data, (line.held_out,))
    settings = replace(settings, **changes)
    return identify(
        load_robot(data / line.robot), read(data, line.logs), held_out=held_out, settings=settings
    )


def judged(line: Line, result: Identification) -> torch.Tensor:
    errors = result.held_out
    assert errors is not None
    return errors.relative_percent if line.rows == "all" else errors.relative_percent_moving


def cells(values: list[float]) -> str:
    return " ".join(f"{v:.1f}" for v in values)


def errors(data: Path) -> None:
    """By default, with coefficients of any sign, and with the cut-off that torchid chooses."""
    rows = []
    for line in LINES.values():
        values = judged(line, run(line, data))
        free = judged(line, run(line, data, signs="free"))
        auto = run(line, data, cutoff="auto", error_cutoff=line.cutoff)
        reference = sum(line.reference) / len(line.reference)
        rows.append(
            (
                f"{line.label}, {line.rows}, {line.cutoff:g} Hz", cells(list(line.reference)),
                cells(values.tolist()), f"{float(values.mean()):.2f} ({reference:.2f})",
                cells(free.tolist()), f"{cells(judged(line, auto).tolist())} ({auto.cutoff:g} Hz)",
            )
        )  # fmt: skip
    heads = "log, rows, cut-off", "reference", "default", "mean (reference)", "signs free", "auto"
    table(heads, rows)


def all_rows(data: Path) -> None:
    rows = []
    for line in LINES.values():
        e = run(line, data).held_out
        assert e is not None
        every = (e.relative_percent, e.relative_percent_moving, e.relative_percent_raw)
        rows.append((line.label, *(cells(v.tolist()) for v in every)))
    table(("log", "all", "moving", "raw torque"), rows)


def emps(data: Path) -> None:
    published = (95.109, 203.50, 20.394, -3.165)
    rows = [("published", *(f"{v:g}" for v in published))]
    for method in ("ols", "huber"):
        result = run(replace(LINES["emps"], method=method), data)
        shown = (
            f"{v:.2f} ± {s:.2f} ({100 * (v / p - 1):+.2f} %)"
            for v, s, p in zip(result.values.tolist(), result.std.tolist(), published, strict=True)
        )
        rows.append((f"--method {method}", *shown))
    table(("EMPS", "M [kg]", "Fv [N s/m]", "Fc [N]", "offset [N]"), rows)


def panda(data: Path) -> None:
    line = LINES["panda"]
    result = identify(
        load_robot(data / line.robot),
        read(data, line.logs),
        settings=Settings(cutoff=8.0, method="ols", signs="free", effects=(
            "viscous_friction", "coulomb_friction", "torque_offset")),
    )  # fmt: skip
    sums = result.fit_predictions[0].sums
    stacked = 100 * float((sums.error.sum() / sums.torque.sum()).sqrt())
    print(f"\nPanda, own whole trajectory, all joints stacked, 8 Hz: {stacked:.2f} % (1.41 %)\n")
    rows = []
    for text, value, percent in PANDA:
        own, std = result.combination(weights(text, result.base))
        name = text.replace("**2", "²").replace("*", " ")
        theirs = f"{value:g} ± {abs(value) * percent / 100:.2g}"
        rows.append((name, theirs, f"{own:.4f} ± {std:.2g}", f"{(own - value) / std:+.1f}"))
    heads = "coefficient", "published ± std", "torchid ± std (block-robust)", "difference / std"
    table(heads, rows)


def weights(text: str, base: BaseParameters) -> torch.Tensor:
    names = base.parameter_names
    symbols = {name: sympy.Symbol(name) for name in names}
    lengths = {"a4": A4, "d3": D3, "d5": D5, "a7": A7}
    expression = sympy.expand(sympy.sympify(text, locals={**symbols, **lengths}))
    row = [float(expression.coeff(symbols[name])) for name in names]
    return torch.tensor(row, dtype=torch.float64)


def main(data: Path) -> None:
    """Print all tables."""
    for part in (errors, all_rows, emps, panda):
        part(data)


if __name__ == "__main__":
    command(main)
