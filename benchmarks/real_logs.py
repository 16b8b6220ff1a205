"""Held-out torque errors on real logs, beside published figures; the tables of docs/results.md.

    python benchmarks/real_logs.py DATA

DATA is a folder with the public logs named in docs/results.md, converted to one table a log. They
are not part of this project: most of their licences do not allow it.
"""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import sympy
import torch

from torchid.identification.base_parameters import BaseParameters
from torchid.identification.identify import Identification, Settings, identify
from torchid.log.model import Log
from torchid.log.readers import read_log
from torchid.robot.library import load_robot

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


LINES = (
    Line(
        "Franka Panda, first 60 % -> last 40 %",
        "panda_gaz/robot.yaml",
        ("panda_gaz/log_exciting_traj1.parquet",),
        0.4,
        8.0,
        "all",
        (6.1, 0.8, 1.1, 0.8, 8.3, 2.3, 13.1),
    ),
    Line(
        "UR10e, est_30s + exc_40s -> val_ptp10",
        "ur10e/robot.urdf",
        ("ur10e/log_est_30s_12harm.parquet", "ur10e/log_exc_40s_12harm.parquet"),
        "ur10e/log_val_ptp10.parquet",
        20.0,
        "moving",
        (8.5, 4.2, 3.7, 5.2, 7.7, 6.6),
    ),
    Line(
        "UR10e, est_30s + exc_40s -> exc_20s",
        "ur10e/robot.urdf",
        ("ur10e/log_est_30s_12harm.parquet", "ur10e/log_exc_40s_12harm.parquet"),
        "ur10e/log_exc_20s_8harm.parquet",
        20.0,
        "moving",
        (7.8, 5.4, 5.2, 5.8, 8.2, 7.0),
    ),
    Line(
        "UR10, first 60 % -> last 40 %",
        "ur10_unisa/robot.yaml",
        ("ur10_unisa/log_exciting.parquet",),
        0.4,
        2.0,
        "all",
        (5.9, 6.4, 3.2, 6.5, 7.2, 35.3),
    ),
    Line(
        "xMate7 Pro, traj1 -> traj2",
        "xmate7p/robot.urdf",
        ("xmate7p/log_traj1.parquet",),
        "xmate7p/log_traj2.parquet",
        8.0,
        "all",
        (22.2, 2.4, 4.4, 3.2, 11.6, 10.7, 17.5),
    ),
    Line(
        "EMPS drive, train -> test",
        "emps/robot.yaml",
        ("emps/log_train.parquet",),
        "emps/log_test_pulses.parquet",
        60.0,
        "all",
        (7.3,),
    ),
)

A4, D3, D5, A7 = sympy.Float(0.0825), sympy.Float(0.316), sympy.Float(0.384), sympy.Float(0.088)
"""Lengths of the Panda [m]; the published groupings print their products rounded."""

DISTAL = "(m4 + m5 + m6 + m7)"
PANDA: tuple[tuple[str, float, float], ...] = (
    # Combination of parameters, published value (classical identification), its std [%]:
    # Gaz et al. 2019, supplementary material, table III, columns pi_CLS and %sigma.
    ("J2yy + J1zz", 0.0204, 2.3609),
    (f"J2xx - J2yy + J3yy + d3**2*m3 + 2*d3*m3c3z + d3**2*{DISTAL} + a4**2*{DISTAL}", 0.9188, 0.1202),
    ("J2xy", -0.0033, 11.0392),
    ("J2xz", 0.0042, 14.3570),
    ("J2yz", -0.0155, 2.3054),
    (f"J3yy + J2zz + d3**2*m3 + 2*d3*m3c3z + d3**2*{DISTAL} + a4**2*{DISTAL}", 0.9346, 0.0973),
    (f"J3xx - J3yy + J4yy - a4**2*{DISTAL} + a4**2*(m5 + m6 + m7)", 0.0149, 5.8149),
    ("J3xy + a4*m4c4z", 0.0127, 3.5669),
    ("J3xz", -0.0061, 5.2129),
    ("J3yz", -0.0138, 2.3907),
    ("J4yy + J3zz + a4**2*m4 + 2*a4**2*(m5 + m6 + m7)", 0.0825, 0.5394),
    ("J4xx - J4yy + J5yy + 2*d5*m5c5z + (d5**2 - a4**2)*(m5 + m6 + m7)", 0.5462, 0.0951),
    ("J4xy + a4*d5*(m5 + m6 + m7) + a4*m5c5z", 0.1202, 0.1665),
    ("J4xz", 0.0040, 6.5285),
    ("J4yz", 0.0078, 3.4723),
    ("J5yy + J4zz + (d5**2 + a4**2)*(m5 + m6 + m7) + 2*d5*m5c5z", 0.6196, 0.0829),
    ("J5xx - J5yy + J6yy + a7**2*m7", 0.0114, 3.9131),
    ("J5xy", 0.0036, 5.7718),
    ("J5xz", -0.0102, 1.6764),
    ("J5yz", 0.0080, 2.7133),
    ("J6yy + J5zz + a7**2*m7", 0.0216, 1.6395),
    ("J6xx - J6yy + J7yy - a7**2*m7", -0.0157, 1.8290),
    ("J6xy + a7*m7c7z", 0.0014, 8.9602),
    ("J6xz", 0.0047, 3.8644),
    ("J6yz", 0.0006, 27.1286),
    ("J7yy + J6zz + a7**2*m7", 0.0145, 1.8227),
    ("J7xx - J7yy", 0.0024, 7.3234),
    ("J7xy", 0.0049, 1.8700),
    ("J7xz", 0.0023, 4.8889),
    ("J7yz", -0.0027, 4.7174),
    ("J7zz", -0.0043, 4.4680),
    ("m2c2x", 0.0288, 1.8926),
    (f"m2c2y - d3*{DISTAL} - d3*m3 - m3c3z", -3.1363, 0.0105),
    (f"a4*{DISTAL} + m3c3x", 0.6803, 0.0481),
    ("m3c3y - m4c4z", -0.0121, 1.2201),
    ("m4c4x - a4*(m5 + m6 + m7)", -0.4726, 0.0368),
    ("d5*(m5 + m6 + m7) + m4c4y + m5c5z", 1.7517, 0.0193),
    ("m5c5x", -0.0005, 26.5699),
    ("m5c5y - m6c6z", 0.0817, 0.1362),
    ("a7*m7 + m6c6x", 0.1637, 0.0744),
    ("m6c6y - m7c7z", -0.0623, 0.1527),
    ("m7c7x", 0.0013, 6.5781),
    ("m7c7y", 0.0048, 1.6783),
    *((f"Fv{j + 1}", v, s) for j, (v, s) in enumerate((
        (0.0665, 1.9658), (0.1987, 0.9615), (0.0399, 3.4971), (0.2257, 0.9124),
        (0.1023, 1.5868), (-0.0132, 12.2607), (0.0638, 2.1388),
    ))),
    *((f"Fc{j + 1}", v, s) for j, (v, s) in enumerate((
        (0.2450, 0.5889), (0.1523, 0.9602), (0.1827, 0.7324), (0.3591, 0.4152),
        (0.2669, 0.4668), (0.1658, 0.8077), (0.2109, 0.7055),
    ))),
    *((f"F0{j + 1}", v, s) for j, (v, s) in enumerate((
        (-0.1073, 0.6932), (-0.1566, 2.9549), (-0.0686, 1.1566), (-0.2522, 0.9563),
        (0.0045, 19.4633), (0.0910, 0.8390), (-0.0127, 6.2628),
    ))),
)  # fmt: skip


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


def table(data: Path) -> None:
    print("| log, rows, cut-off | reference | default | mean (reference) | signs free | auto |")
    print("|---|---|---|---|---|---|")
    for line in LINES:
        values = judged(line, run(line, data))
        free = judged(line, run(line, data, signs="free"))
        auto = run(line, data, cutoff="auto", error_cutoff=line.cutoff)
        reference = sum(line.reference) / len(line.reference)
        print(
            f"| {line.label}, {line.rows}, {line.cutoff:g} Hz | {cells(list(line.reference))} | "
            f"{cells(values.tolist())} | {float(values.mean()):.2f} ({reference:.2f}) | "
            f"{cells(free.tolist())} | {cells(judged(line, auto).tolist())} "
            f"({auto.cutoff:g} Hz) |"
        )


def all_rows(data: Path) -> None:
    print("\n| log | all | moving | raw torque |")
    print("|---|---|---|---|")
    for line in LINES:
        e = run(line, data).held_out
        assert e is not None
        rows = (e.relative_percent, e.relative_percent_moving, e.relative_percent_raw)
        print(f"| {line.label} | " + " | ".join(cells(v.tolist()) for v in rows) + " |")


def emps(data: Path) -> None:
    published = (95.109, 203.50, 20.394, -3.165)
    print("\n| EMPS | M [kg] | Fv [N s/m] | Fc [N] | offset [N] |\n|---|---|---|---|---|")
    print("| published | " + " | ".join(f"{v:g}" for v in published) + " |")
    for method in ("ols", "huber"):
        result = run(replace(LINES[-1], method=method), data)
        shown = (
            f"{v:.2f} ± {s:.2f} ({100 * (v / p - 1):+.2f} %)"
            for v, s, p in zip(result.values.tolist(), result.std.tolist(), published, strict=True)
        )
        print(f"| --method {method} | " + " | ".join(shown) + " |")


def panda(data: Path) -> None:
    line = LINES[0]
    result = identify(
        load_robot(data / line.robot),
        read(data, line.logs),
        settings=Settings(cutoff=8.0, method="ols", signs="free", effects=(
            "viscous_friction", "coulomb_friction", "torque_offset")),
    )  # fmt: skip
    sums = result.fit_predictions[0].sums
    stacked = 100 * float((sums.error.sum() / sums.torque.sum()).sqrt())
    print(f"\nPanda, own whole trajectory, all joints stacked, 8 Hz: {stacked:.2f} % (1.41 %)\n")
    print("| coefficient | published ± std | torchid ± std (block-robust) | difference / std |")
    print("|---|---|---|---|")
    for text, value, percent in PANDA:
        own, std = result.combination(weights(text, result.base))
        print(
            f"| {text.replace('**2', '²').replace('*', ' ')} | {value:g} ± "
            f"{abs(value) * percent / 100:.2g} | {own:.4f} ± {std:.2g} | {(own - value) / std:+.1f} |"
        )


def weights(text: str, base: BaseParameters) -> torch.Tensor:
    names = base.parameter_names
    symbols = {name: sympy.Symbol(name) for name in names}
    lengths = {"a4": A4, "d3": D3, "d5": D5, "a7": A7}
    expression = sympy.expand(sympy.sympify(text, locals={**symbols, **lengths}))
    row = [float(expression.coeff(symbols[name])) for name in names]
    return torch.tensor(row, dtype=torch.float64)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    data = parser.parse_args().data
    table(data)
    all_rows(data)
    emps(data)
    panda(data)


if __name__ == "__main__":
    torch.set_num_threads(1)
    main()
