# ruff: noqa: E402 (threads are set before numpy and torch are imported)
"""A simulated fleet: odd units found and false ones, coverage, and what a log costs.

    python benchmarks/fleet.py odd [--units 200] [--sessions 3] [--odd 12] [--alike] [--json FILE]
    python benchmarks/fleet.py drift
    python benchmarks/fleet.py watched
    python benchmarks/fleet.py damaged
    python benchmarks/fleet.py speed [--logs 6] [--seconds 60] [--json FILE]
    python benchmarks/fleet.py scale [--logs 40] [--seconds 60] [--json FILE]
    python benchmarks/fleet.py trace --json FILE     # of `scale`, which it reads

`odd`: units of the 3R whose nine coefficients of friction differ from unit to unit (5 %) and from
day to day (2 %), under coloured torque noise of 1 %; in some of them one coefficient is off by so
many standard deviations of what normal units' values scatter by; with --alike normal units do not
differ at all, and the deviation counts in standard deviations of one session. `drift`: the detector
alone, on drawn numbers. `watched`: minutes until a change of a coefficient is told, from logs of a
minute. `damaged`: one log in twenty is. `speed`: logs of a 7R arm at 1 kHz.
`scale`: the same logs by 1, 2, 4 and 8 processes, all of them (strong) and two a process (weak), and
what a task costs besides its work: CPU time of every task and process tells, on a machine that others
use, what free cores would take. `trace`: from these times, a simulated scheduler with up to 1000.
"""

import os

for _name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[_name] = "1"

import argparse
import heapq
import json
import pickle
import random
import resource
import statistics
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import torch
from cpu_time import processor_time

from tests.fleet.simulated import Plan, make, session_name, typical, unit_name
from tests.robustness.fuzz import changed
from torchid.fleet.identify import USED, Fleet, fleet_identify, reduce_fleet
from torchid.fleet.manifest import FleetLog
from torchid.fleet.model import FleetModel
from torchid.fleet.settings import FleetSettings
from torchid.fleet.tasks import LogAnswer, LogTask, answer_log
from torchid.fleet.watch import watch
from torchid.parallel.store import Store
from torchid.parallel.workers import Workers, each, serve
from torchid.robot.library import load_robot
from torchid.statistics.drift import drift

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


def detection(runs: int = 40, before: int = 10, after: int = 40) -> dict:
    """Sessions until a change of so many standard deviations of a session is sure, and alarms
    without a change: of one of 24 parameters, at one false alarm in 1000 sessions of a unit."""
    threshold, out = 24 * 1000.0, {"runs": runs, "sizes": {}}
    ones = torch.ones(before + after, dtype=torch.float64)
    heat = torch.zeros(before + after, 0, dtype=torch.float64)
    for size in (0.0, 1.0, 2.0, 3.0, 5.0, 8.0):
        waited = []
        for seed in range(runs):
            g = torch.Generator().manual_seed(seed)
            y = torch.randn(before + after, generator=g, dtype=torch.float64)
            y[before:] += size
            over = (drift(y, ones, 30 * ones, heat).evidence >= threshold).nonzero().flatten()
            waited.append(float(over[0]) - before + 1 if len(over) else float("inf"))
        waited.sort()
        seen = sum(w < float("inf") for w in waited) / runs
        median = waited[runs // 2] if seen > 0.5 else None
        out["sizes"][f"{size:g}"] = {"median_sessions": median, "seen": seen}
        print(size, out["sizes"][f"{size:g}"], flush=True)
    return out


def watched(units: int = 30, changing: int = 10, sessions: int = 60, since: int = 20) -> dict:
    """Logs of a minute each, from files to alarms: minutes until a changed coefficient is told, and
    alarms where nothing changed. Which alarms come when does not depend on how many sessions
    follow, but for the spread from day to day, which is that of all of them."""
    robot = load_robot("3r_friction")
    model = FleetModel(robot, FleetSettings(effects=EFFECTS))
    names = [n for n in typical(robot) if n[:2] in ("Fv", "Fc")]
    out: dict = {
        "units": units,
        "changing": changing,
        "sessions": sessions,
        "sizes": {},
        "quiet_sessions": (units - changing) * sessions + changing * since,
    }
    with TemporaryDirectory() as text:
        folder, store = Path(text), Store(f"{text}/store")
        plan = Plan(units, sessions, 60.0, between=BETWEEN, daily=DAILY)
        normal = make(robot, plan, folder / "normal", first=changing)
        for share in (0.02, 0.05, 0.1, 0.2):
            chosen = {k: names[k % len(names)] for k in range(changing)}
            change = {k: (n, share * typical(robot)[n], since) for k, n in chosen.items()}
            few = Plan(changing, sessions, 60.0, between=BETWEEN, daily=DAILY, drift=change)
            logs = make(robot, few, folder / f"changing-{share:g}")
            fleet = fleet_identify(model, [*normal, *logs], store=store, workers=2)
            order = {session_name(s): s for s in range(sessions)}
            # A minute of log an hour, and log without a break: one false alarm in 1000 hours.
            for every in (1_000, 60_000):
                true, false = {(unit_name(k), n): 0 for k, n in chosen.items()}, 0
                for alarm in watch(fleet, every).alarms:
                    at, what = order[alarm.said_at], (alarm.unit, alarm.parameter)
                    if at < since or alarm.unit not in {unit for unit, _ in true}:
                        false += 1
                    elif what in true:
                        true[what] = at - since + 1
                minutes = sorted(t for t in true.values() if t)
                row = {"told": len(minutes), "minutes": minutes, "false": false}
                out["sizes"][f"{share:g}, {every}"] = row
                print(share, every, row, flush=True)
    return out


def damaged(units: int = 100, sessions: int = 2, every: int = 20) -> dict:
    """One log in twenty is damaged as the fuzzer damages files: what becomes of it, and whether
    the others' answer has the same bits as without it."""
    robot = load_robot("3r_friction")
    model = FleetModel(robot, FleetSettings(effects=EFFECTS))
    choose = random.Random(0)
    with TemporaryDirectory() as text:
        logs = make(robot, Plan(units, sessions), Path(text) / "logs")
        broken = logs[every // 2 :: every]
        for log in broken:
            content = Path(log.path).read_bytes()
            Path(log.path).write_bytes(changed(content, content, choose))
        whole = fleet_identify(model, logs, workers=2)
        refused = {a.log.path for a in whole.logs if a.verdict not in USED}
        # What a change has left readable (a digit of a torque) is judged as any other log.
        rest = fleet_identify(model, [log for log in logs if log.path not in refused], workers=2)
        out = {
            "logs": len(logs), "damaged": len(broken), "refused": len(refused),
            "refused_undamaged": len(refused - {log.path for log in broken}),
            "same_bits": bool(torch.equal(whole.pooled.mean, rest.pooled.mean))
            and bool(torch.equal(whole.pooled.shrunk, rest.pooled.shrunk)),
            "reasons": sorted(a.evidence[-1] for a in whole.logs if a.verdict not in USED),
            "odd": list(whole.odd),
        }  # fmt: skip
    print(json.dumps(out, indent=1))
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
            stored = sum(p.stat().st_size for p in Path(store.place).rglob("*.npz"))
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


def timed(task: LogTask) -> tuple[int, float, LogAnswer]:
    """The process that does it, its CPU time for it, and the answer."""
    begin = time.process_time()
    answer = answer_log(task)
    return os.getpid(), time.process_time() - begin, answer


def nothing(task: LogTask) -> LogAnswer:
    """What a task costs besides its work."""
    return LogAnswer(task.log, 64 * "0", 64 * "0", "good", (), noise=(1.0,) * 7)


def one_run(tasks: Sequence[LogTask], workers: int) -> dict:
    """Logs reduced by so many processes; what free cores would take is the start, the busiest
    process and this one's own work, one after another."""
    here, begin, used = time.process_time(), time.perf_counter(), processor_time()
    found = each(timed, tasks, workers)
    here, used = time.process_time() - here, processor_time() - used
    busy: dict[int, float] = defaultdict(float)
    for process, seconds, _ in found:
        busy[process] += seconds
    return {
        "logs": len(tasks), "workers": workers, "load": os.getloadavg()[0],
        "wall_s": time.perf_counter() - begin, "cpu_s": used, "tasks_s": [s for _, s, _ in found],
        "busiest_s": max(busy.values()), "here_s": here - (max(busy.values()) if workers == 1 else 0),
    }  # fmt: skip


def overhead(model: FleetModel, count: int = 500) -> dict:
    """CPU time of the process that gives out tasks, a task [ms], and bytes there and back."""
    task = LogTask(FleetLog("arm-0001", "day-01", "/data/arm-0001/day-01.parquet"), model, "/store")
    out: dict = {"bytes": len(pickle.dumps(task)) + len(pickle.dumps(nothing(task)))}

    def cost(workers: Workers) -> float:
        each(nothing, [task] * 4, workers)
        begin = time.process_time()
        each(nothing, [task] * count, workers)
        return (time.process_time() - begin) / count * 1e3

    out["processes_ms"] = cost(2)
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    ) as cluster:  # the scheduler is in this process
        out["dask_ms"] = cost(cluster.scheduler_address)
    return out


def start() -> dict:
    """CPU time until a process can work: from nothing, and from the server [s]."""
    code = "import torchid.fleet.tasks"
    alone = []
    for _ in range(3):
        begin = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, "-c", code], check=True)
        end = resource.getrusage(resource.RUSAGE_CHILDREN)
        alone.append(end.ru_utime + end.ru_stime - begin.ru_utime - begin.ru_stime)
    return {"alone_s": statistics.median(alone)}


def scale(count: int, seconds: float) -> dict:
    serve("torchid.fleet.tasks")  # as commands do; each process then loads this script, too
    robot = load_robot("kuka_lwr4_friction")
    model = FleetModel(robot, FleetSettings())
    out: dict = {"seconds": seconds, "start": start(), "strong": [], "weak": []}
    out["overhead"] = overhead(model)
    print(out["start"], out["overhead"], flush=True)
    with TemporaryDirectory() as text:
        # A few logs again and again, each time with a store that does not know them.
        logs = make(robot, Plan(4, 1, seconds, 1000.0), Path(text))
        for kind in ("strong", "weak"):
            for workers in (1, 2, 4, 8):
                tasks = [
                    LogTask(logs[k % 4], model, f"{text}/{kind}-{workers}-{k // 4}")
                    for k in range(count if kind == "strong" else 2 * workers)
                ]
                row = one_run(tasks, workers)
                out[kind].append(row)
                print(kind, {k: v for k, v in row.items() if k != "tasks_s"}, flush=True)
        begin = time.process_time()
        fleet_identify(model, logs, store=Store(f"{text}/strong-1-0"))
        out["rest_s_a_log"] = (time.process_time() - begin) / len(logs)
    return out


def trace(measured: dict) -> dict:
    """Logs of an hour given out by one scheduler, first come, first served: time, and the share of
    it that workers work."""
    rate = sum(measured["strong"][0]["tasks_s"]) / len(measured["strong"][0]["tasks_s"])
    spread = [s / rate for s in measured["strong"][0]["tasks_s"]]
    hour = rate * 3600 / measured["seconds"]
    given = measured["overhead"]["dask_ms"] / 1e3
    out: dict = {"task_s": hour, "scheduler_s_a_task": given, "workers": {}}
    chance = random.Random(0)
    tasks = [hour * chance.choice(spread) for _ in range(10_000)]
    for workers in (1, 2, 8, 40, 100, 300, 1000):
        free = [measured["start"]["alone_s"]] * workers
        scheduler = 0.0
        for seconds in tasks:
            # The scheduler gives out one task after another, each when a worker is free.
            scheduler = max(scheduler, free[0]) + given
            heapq.heapreplace(free, scheduler + seconds)
        end = max(free)
        work = sum(tasks)
        out["workers"][workers] = {
            "hours": end / 3600, "efficiency": work / workers / end,
            "kilobytes_a_second": measured["overhead"]["bytes"] * len(tasks) / end / 1e3,
            "longest_path_s": measured["start"]["alone_s"] + max(tasks) + given,
        }  # fmt: skip
        print(workers, out["workers"][workers], flush=True)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "what", choices=("odd", "speed", "drift", "watched", "damaged", "scale", "trace")
    )
    parser.add_argument("--units", type=int, default=200)
    parser.add_argument("--sessions", type=int, default=3)
    parser.add_argument("--odd", type=int, default=12)
    parser.add_argument("--alike", action="store_true")
    parser.add_argument("--logs", type=int)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    torch.set_num_threads(1)
    if args.what == "trace":
        trace(json.loads(args.json.read_text()))
        return
    found = {
        "odd": lambda: odd(args.units, args.sessions, args.odd, args.alike),
        "drift": detection,
        "watched": watched,
        "damaged": damaged,
        "speed": lambda: speed(args.logs or 6, args.seconds),
        "scale": lambda: scale(args.logs or 40, args.seconds),
    }[args.what]()
    if args.json is not None:
        args.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
