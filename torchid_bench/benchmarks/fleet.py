# ruff: noqa: E402 (threads are set before numpy and torch are imported)
"""A simulated fleet: odd units found and false ones, coverage, and what a log costs.

    python -m torchid_bench.benchmarks.fleet odd [--units 200] [--sessions 3] [--odd 12] [--alike] [--json FILE]
    python -m torchid_bench.benchmarks.fleet speed [--logs 6] [--seconds 60] [--json FILE]

`odd`: units of the 3R whose nine coefficients of friction differ from unit to unit (5 %) and from
day to day (2 %), under coloured torque noise of 1 %; in some of them one coefficient is off by so
many standard deviations of what normal units' values scatter by; with --alike normal units do not
differ at all, and the deviation counts in standard deviations of one session. `speed`: logs of a
7R arm at 1 kHz.
"""

import os

for _name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[_name] = "1"

import argparse
import json
import resource
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import torch

from tests.fleet.simulated import Plan, make, typical, unit_name
from torchid.fleet.identify import Fleet, fleet_identify, reduce_fleet
from torchid.fleet.model import FleetModel
from torchid.fleet.settings import FleetSettings
from torchid.parallel.store import Store
from torchid.robot.library import load_robot
from torchid_bench.benchmarks.cpu_time import processor_time

EFFECTS = ("viscous_friction", "coulomb_friction", "torque_offset")
SIZES = (0.0, 3.0, 4.0, 5.0, 6.0, 8.0)
SIZES_ALIKE = (0.0, 2.0, 3.0, 4.0)
BETWEEN, DAILY = 0.05, 0.02


def truth(robot, unit: int, sessions: int) -> dict[str, float]:
    """What `make` draws for a unit, without its days."""
    nominal = typical(robot)
    g = torch.Generator().manual_seed(unit)
    drawn = torch.randn(len(nominal), 1 + sessions, generator=g, dtype=torch.float64)
    pairs = zip(nominal.items(), drawn, strict=True)
    return {name: value * (1 + BETWEEN * float(x[0])) for (name, value), x in pairs}


def coverage(found: Fleet, robot, sessions: int, normal: range) -> dict[str, float]:
    """How often intervals of 95 % hold what was drawn."""
    names = {n: b for b, n in enumerate(found.base.names) if n in typical(robot)}
    units = {u.unit: k for k, u in enumerate(found.units)}
    inside = []
    for k in normal:
        true = truth(robot, k, sessions)
        for name, b in names.items():
            column = units[unit_name(k)]
            off = float(found.pooled.shrunk[b, column]) - true[name]
            inside.append(abs(off) <= 1.96 * float(found.pooled.shrunk_std[b, column]))
    spread, means, daily = [], [], []
    for name, b in names.items():
        value = typical(robot)[name]
        for ci, true, out in (
            (found.pooled.between_ci, BETWEEN * abs(value), spread),
            (found.pooled.daily_ci, DAILY * abs(value), daily),
            (found.pooled.interval(), value, means),
        ):
            out.append(float(ci[b, 0]) <= true <= float(ci[b, 1]))
    return {
        "unit_values": sum(inside) / len(inside),
        "unit_values_count": len(inside),
        "unit_spread": sum(spread) / len(spread),
        "day_spread": sum(daily) / len(daily),
        "means": sum(means) / len(means),
        "spreads_count": len(spread),
    }


def odd(units: int, sessions: int, count: int, alike: bool) -> dict:
    between, daily = (0.0, 0.0) if alike else (BETWEEN, DAILY)
    robot = load_robot("3r_friction")
    model = FleetModel(robot, FleetSettings(effects=EFFECTS))
    out: dict = {"units": units, "sessions": sessions, "odd": count, "sizes": {}}
    with TemporaryDirectory() as text:
        folder, store = Path(text), Store(f"{text}/store")
        plan = Plan(units=units, sessions=sessions, between=between, daily=daily)
        begin = time.process_time()
        normal = make(robot, plan, folder / "normal", first=count)
        out["simulated_cpu_s"] = time.process_time() - begin
        begin = time.process_time()
        reduce_fleet(model, normal, store)
        out["reduced_cpu_s"] = time.process_time() - begin
        nominal = typical(robot)
        names = [n for n in nominal if n[:2] in ("Fv", "Fc")]
        scatter = (BETWEEN**2 + DAILY**2 / sessions) ** 0.5
        unit = {n: scatter * nominal[n] for n in names}
        if alike:
            known = fleet_identify(model, normal, store=store)
            std = torch.stack([e.std for u in known.units for _, e in u.sessions]).nanmedian(0)
            unit = {n: float(std.values[known.base.names.index(n)]) for n in names}
            out["session_std_share"] = {n: s / nominal[n] for n, s in unit.items()}
        for size in SIZES_ALIKE if alike else SIZES:
            chosen = [names[k % len(names)] for k in range(count)]
            off = {k: (n, size * unit[n]) for k, n in enumerate(chosen)}
            few = Plan(count, sessions, between=between, daily=daily, odd=off)
            logs = make(robot, few, folder / f"odd-{size:g}")
            begin = time.process_time()
            found = fleet_identify(model, [*normal, *logs], store=store)
            seconds = time.process_time() - begin
            known = {unit_name(k) for k in range(count)} if size else set()
            hits, false = len(known & set(found.odd)), len(set(found.odd) - known)
            named = sum((unit_name(k), n) in {(o.unit, o.parameter) for o in found.oddities}
                        for k, n in enumerate(chosen)) if size else 0  # fmt: skip
            out["sizes"][f"{size:g}"] = {
                "found": hits, "named": named, "false": false, "pooling_cpu_s": seconds,
                "share_false": false / max(1, hits + false),
            }  # fmt: skip
            print(f"{size:g} standard deviations: {hits} of {len(known)} found, {named} by the "
                  f"right name, {false} false; {seconds:.0f} s", flush=True)  # fmt: skip
            if not size and not alike:
                out["coverage"] = coverage(found, robot, sessions, range(units))
                print(out["coverage"], flush=True)
    return out


def speed(count: int, seconds: float) -> dict:
    robot = load_robot("kuka_lwr4_friction")
    model = FleetModel(robot, FleetSettings())
    out: dict = {"logs": count, "seconds": seconds, "workers": {}}
    with TemporaryDirectory() as text:
        plan = Plan(count, 1, seconds, 1000.0)
        logs = make(robot, plan, Path(text))
        hours = count * seconds / 3600
        for workers in (1, 2):
            store = Store(f"{text}/store-{workers}")
            wall, used, load = time.perf_counter(), processor_time(), os.getloadavg()[0]
            answers = reduce_fleet(model, logs, store, workers=workers)
            wall, used = time.perf_counter() - wall, processor_time() - used
            wall2, used2 = time.perf_counter(), processor_time()
            fleet_identify(model, logs, store=store, workers=workers)
            wall2, used2 = time.perf_counter() - wall2, processor_time() - used2
            stored = sum(p.stat().st_size for p in Path(store.place).rglob("output.pkl"))
            out["workers"][workers] = {
                "load_before": load, "reduce_wall_s": wall, "reduce_cpu_s": used,
                "reduce_log_hours_per_core_hour": hours / used * 3600,
                "rest_wall_s": wall2, "rest_cpu_s": used2,
                "identify_log_hours_per_core_hour": hours / (used + used2) * 3600,
                "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
                "stored_mb_per_log": stored / 1e6 / count,
                "verdicts": [a.verdict for a in answers],
            }  # fmt: skip
            print(workers, out["workers"][workers], flush=True)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("odd", "speed"))
    parser.add_argument("--units", type=int, default=200)
    parser.add_argument("--sessions", type=int, default=3)
    parser.add_argument("--odd", type=int, default=12)
    parser.add_argument("--alike", action="store_true")
    parser.add_argument("--logs", type=int, default=6)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    torch.set_num_threads(1)
    found = {
        "odd": lambda: odd(args.units, args.sessions, args.odd, args.alike),
        "speed": lambda: speed(args.logs, args.seconds),
    }[args.what]()
    if args.json is not None:
        args.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
