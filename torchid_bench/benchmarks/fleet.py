"""A simulated fleet: odd units found and false ones, coverage, and what a log costs.

    python -m torchid_bench.benchmarks.fleet odd [--units 200] [--sessions 3] [--odd-units 12] [--alike]
    python -m torchid_bench.benchmarks.fleet speed [--logs 6] [--seconds 60]
    python -m torchid_bench.benchmarks.fleet growth [--logs 10 100 1000]

`odd`: units of the 3R whose nine coefficients of friction differ from unit to unit (5 %) and from
day to day (2 %), under coloured torque noise of 1 %; in some of them one coefficient is off by so
many standard deviations of what normal units' values scatter by; with --alike normal units do not
differ at all, and the deviation counts in standard deviations of one session. `speed`: logs of a
7R arm at 1 kHz. `growth`: logs of ten seconds of the 3R by one process, and by two workers of a dask
scheduler of which one is killed after the first tenth: the same bits.
"""

import itertools
import json
import resource
import time
from collections.abc import Sequence
from pathlib import Path
from subprocess import Popen
from tempfile import TemporaryDirectory

import torch

from tests.fleet.simulated import Plan, make, typical, unit_name
from torchid.fleet.identify import Fleet, fleet_identify, reduce_fleet
from torchid.fleet.model import FleetModel
from torchid.fleet.settings import FleetSettings
from torchid.parallel.store import Store
from torchid.robot.library import load_robot
from torchid_bench.benchmarks.cpu_time import processor_time
from torchid_bench.benchmarks.runner import command, table

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


def coverage(fleet: Fleet, robot, sessions: int, normal: range) -> dict[str, float]:
    """How often intervals of 95 % hold what was drawn."""
    names = {n: b for b, n in enumerate(fleet.base.names) if n in typical(robot)}
    units = {u.unit: k for k, u in enumerate(fleet.units)}
    inside = []
    for k in normal:
        true = truth(robot, k, sessions)
        for name, b in names.items():
            column = units[unit_name(k)]
            off = float(fleet.pooled.shrunk[b, column]) - true[name]
            inside.append(abs(off) <= 1.96 * float(fleet.pooled.shrunk_std[b, column]))
    spread, means, daily = [], [], []
    for name, b in names.items():
        value = typical(robot)[name]
        for ci, true, out in (
            (fleet.pooled.between_ci95, BETWEEN * abs(value), spread),
            (fleet.pooled.daily_ci95, DAILY * abs(value), daily),
            (fleet.pooled.interval(), value, means),
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


def odd(*, units: int = 200, sessions: int = 3, odd_units: int = 12, alike: bool = False) -> None:
    """Odd units that are found and named, and false ones, by the size of what is odd."""
    between, daily = (0.0, 0.0) if alike else (BETWEEN, DAILY)
    robot = load_robot("3r_friction")
    model, rows = FleetModel(robot, FleetSettings(effects=EFFECTS)), []
    with TemporaryDirectory() as text:
        folder, store = Path(text), Store(f"{text}/store")
        plan = Plan(units=units, sessions=sessions, between=between, daily=daily)
        normal = make(robot, plan, folder / "normal", first=odd_units)
        begin = time.process_time()
        reduce_fleet(model, normal, store)
        print(
            f"{time.process_time() - begin:.0f} CPU s for what normal units reduce to", flush=True
        )
        nominal = typical(robot)
        names = [n for n in nominal if n[:2] in ("Fv", "Fc")]
        scatter = (BETWEEN**2 + DAILY**2 / sessions) ** 0.5
        unit = {n: scatter * nominal[n] for n in names}
        if alike:
            known = fleet_identify(model, normal, store=store)
            std = torch.stack([e.std for u in known.units for _, e in u.sessions]).nanmedian(0)
            unit = {n: float(std.values[known.base.names.index(n)]) for n in names}
            print("standard deviation of a session:", {n: unit[n] / nominal[n] for n in names})
        for size in SIZES_ALIKE if alike else SIZES:
            chosen = [names[k % len(names)] for k in range(odd_units)]
            off = {k: (n, size * unit[n]) for k, n in enumerate(chosen)}
            few = Plan(odd_units, sessions, between=between, daily=daily, odd=off)
            logs = make(robot, few, folder / f"odd-{size:g}")
            begin = time.process_time()
            fleet = fleet_identify(model, [*normal, *logs], store=store)
            seconds = time.process_time() - begin
            truly = {unit_name(k) for k in range(odd_units)} if size else set()
            odd_ones = {(o.unit, o.parameter) for o in fleet.oddities} if size else set()
            named = sum((unit_name(k), n) in odd_ones for k, n in enumerate(chosen))
            hits, false = len(truly & set(fleet.odd)), len(set(fleet.odd) - truly)
            rows.append((f"{size:g}", f"{hits} of {len(truly)}", named, false, f"{seconds:.0f}"))
            print(*rows[-1], flush=True)
            if not size and not alike:
                print(coverage(fleet, robot, sessions, range(units)), flush=True)
    table(("standard deviations", "found", "by the right name", "false", "CPU s"), rows)


def speed(*, logs: int = 6, seconds: float = 60.0) -> None:
    """What logs cost, by one worker and by two."""
    robot = load_robot("kuka_lwr4_friction")
    model, rows = FleetModel(robot, FleetSettings()), []
    with TemporaryDirectory() as text:
        made = make(robot, Plan(logs, 1, seconds, 1000.0), Path(text))
        for workers in (1, 2):
            store, clocks = (
                Store(f"{text}/store-{workers}"),
                [(time.perf_counter(), processor_time())],
            )
            reduce_fleet(model, made, store, workers=workers)
            clocks.append((time.perf_counter(), processor_time()))
            fleet_identify(model, made, store=store, workers=workers)
            clocks.append((time.perf_counter(), processor_time()))
            stored = sum(p.stat().st_size for p in Path(store.place).rglob("output.pkl"))
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            (wall, used), (rest, also) = (
                (b[0] - a[0], b[1] - a[1]) for a, b in itertools.pairwise(clocks)
            )
            hours = (logs * seconds / cpu for cpu in (used, used + also))
            cells = (wall, used, rest, also, *hours, stored / 1e6 / logs, peak)
            rows.append((workers, *(f"{x:.1f}" for x in cells)))
    reduced = ("workers", "reduced: s", "CPU s", "the rest: s", "CPU s")
    identified = ("hours of log a core-hour, reduced", "identified")
    table((*reduced, *identified, "MB stored a log", "peak MB"), rows)


def growth(*, logs: Sequence[int] = (10, 100, 1000), seconds: float = 10.0) -> None:
    """What more logs cost, by one process and by a scheduler's workers of which one is killed."""
    from tests.parallel.test_scheduler import Cluster

    robot, rows = load_robot("3r_friction"), []
    model = FleetModel(robot, FleetSettings(effects=EFFECTS))
    for count in logs:
        with TemporaryDirectory() as text:
            made, cluster = make(robot, Plan(count, 1, seconds, 100.0), Path(text)), Cluster()
            begun = processor_time()
            alone = fleet_identify(model, made)
            used = processor_time() - begun
            cluster.start()
            cluster.start_worker()
            spare = cluster.running[-1]

            def kill(stage: str, done: int, total: int, one: Popen[bytes] = spare) -> None:
                if done >= total / 10 and one.poll() is None:
                    one.kill()

            begin = time.perf_counter()
            try:
                store = Store(f"{text}/store")
                spread = fleet_identify(
                    model, made, store=store, workers=cluster.address, progress=kill
                )
            finally:
                cluster.kill()
            wall = time.perf_counter() - begin
            same = json.dumps(alone.plain()) == json.dumps(spread.plain())
            rows.append(
                (
                    count, f"{used:.1f}", f"{count * seconds / used:.0f}", f"{wall:.1f}",
                    "yes" if spare.returncode else "no", "yes" if same else "no",
                )
            )  # fmt: skip
    heads = (
        "logs",
        "CPU s",
        "hours of log a core-hour",
        "by dask: s",
        "a worker killed",
        "same bits",
    )
    table(heads, rows)


if __name__ == "__main__":
    command(odd, speed, growth)
