"""What benchmarks share: the machine in words, and CPU time of this process and all it started."""

import os
import platform
from pathlib import Path

import torch

_TICK = os.sysconf("SC_CLK_TCK")


def processor_time() -> float:
    """CPU seconds of this process and its descendants, which wait for more work when a run is over.
    Linux only."""
    stats = {}
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                text = (folder / "stat").read_text()
            except OSError:  # it has ended meanwhile
                continue
            own = text.rpartition(")")[2].split()  # from the state on, the third entry
            stats[int(folder.name)] = int(own[1]), sum(map(int, own[11:15])) / _TICK
    mine, total = {os.getpid()}, 0.0
    while True:
        more = {k for k, (parent, _) in stats.items() if parent in mine} - mine
        if not more:
            break
        mine |= more
    for k in mine:
        total += stats[k][1]
    return total


def machine() -> str:
    """Processor, cores, load and versions, for the head of a table."""
    model = next(
        (
            line.split(":")[1].strip()
            for line in Path("/proc/cpuinfo").read_text().splitlines()
            if line.startswith("model name")
        )
        if Path("/proc/cpuinfo").exists()
        else [platform.processor()],
    )
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    return (
        f"{model}, {os.cpu_count()} cores, load {load:.1f}, python {platform.python_version()}, "
        f"torch {torch.__version__}, {torch.get_num_threads()} thread, "
        f"{torch.backends.cpu.get_cpu_capability()}"
    )
