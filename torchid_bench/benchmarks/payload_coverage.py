"""How often the intervals of `torchid payload` hold the truth, on motion good and weak.

    python -m torchid_bench.benchmarks.payload_coverage [--pairs 40] [--first 0] [--rates 50,200,500]
        [--digits 0,5] [--moving all,3,2,1] [--robots 3r,ur10e,kuka_lwr4] [--cutoff 8] [--out DIR]

A pair is a log without payload and one with it, of an arm whose bodies are not its nominal ones and
whose joints rub. Pairs go through rates, digits of the log (0: all) and numbers of joints that move
in turn. In every other pair the empty arm moves well, else as little as the loaded one. Joints that
stand are held by friction, and in every other pair sag first, as under a load that the controller
does not know. Noise of the torque is white or slow. Each line counts, of a cell, what is said to be
known, how much of that holds the truth, and the median width of the mass over that of an oracle:
generalised least squares on the true motion with the noise's own covariance.
"""

import itertools
import math
from collections import Counter, defaultdict
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import torch
from scipy.signal import lfilter

import torchid
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.dynamics.regressor import regressor
from torchid.errors import TorchidError
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.identification.base_parameters import base_parameters
from torchid.identification.payload import with_payload
from torchid.identification.payload_fit import last_link_columns
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid_bench.benchmarks.runner import command, digest, results, table

SECONDS = 12.0
SLOW = 0.1
"""Correlation time of slow noise [s]."""


@dataclass(frozen=True)
class Run:
    """A log and what made it: motion, standard deviation of noise (n,), its correlation [s]."""

    log: torchid.Log
    motion: tuple[torch.Tensor, torch.Tensor, torch.Tensor]
    sigma: torch.Tensor
    slow: bool


def uniform(g: torch.Generator, low: float, high: float, *shape: int) -> torch.Tensor:
    return low + (high - low) * torch.rand(*shape, generator=g, dtype=torch.float64)


def rounded(x: torch.Tensor, digits: int) -> torch.Tensor:
    if not digits:
        return x
    place = 10.0 ** (digits - 1 - x.abs().clamp(min=1e-300).log10().floor())
    return (x * place).round() / place


def noise(shape: torch.Size, rate: float, slow: bool, g: torch.Generator) -> torch.Tensor:
    white = torch.randn(shape, generator=g, dtype=torch.float64)
    if not slow:
        return white
    a = math.exp(-1 / (SLOW * rate))
    return torch.from_numpy(lfilter([(1 - a * a) ** 0.5], [1, -a], white.numpy(), axis=0))


def moved(
    robot: Robot, seed: int, rate: float, joints: list[int], sag: torch.Tensor | None
) -> tuple[torch.Tensor, ...]:
    """t, q, dq, ddq: the given joints along a random trajectory, the others where it begins."""
    log = trajectory_log(random_trajectory(robot, seed, duration=SECONDS, fill=True), rate)
    parts = [x.clone() for x in (log.q, log.dq, log.ddq)]
    standing = [j for j in range(robot.n) if j not in joints]
    parts[0][:, standing] = parts[0][0, standing].clone()
    parts[1][:, standing] = parts[2][:, standing] = 0
    if sag is not None:
        # A smooth way of 0.3 s into the new balance.
        s = (log.t / 0.3).clamp(0, 1).unsqueeze(1)
        ways = (10 * s**3 - 15 * s**4 + 6 * s**5, 30 * s**2 * (1 - s) ** 2 / 0.3,
                60 * s * (1 - s) * (1 - 2 * s) / 0.09)  # fmt: skip
        for x, way in zip(parts, ways, strict=True):
            x[:, standing] += way * sag[standing]
    return log.t, *parts


def recorded(arm: Robot, motion: tuple[torch.Tensor, ...], friction: torch.Tensor,
             level: torch.Tensor, slow: bool, digits: int, g: torch.Generator) -> Run:  # fmt: skip
    t, q, dq, ddq = motion
    tau = inverse_dynamics(arm, q, dq, ddq) + friction[0] * dq + friction[1] * dq.sign()
    # A joint at rest is held by any torque that its friction allows.
    tau = tau + (dq.abs().amax(0) < 1e-9) * friction[1] * uniform(g, -1, 1, arm.n)
    rate = 1 / float(t[1] - t[0])
    tau = tau + level * noise(tau.shape, rate, slow, g)
    log = torchid.Log(t, rounded(q, digits), tau=rounded(tau, digits))
    return Run(log, (q, dq, ddq), level, slow)


def oracle(robot: Robot, empty: Run, loaded: Run) -> float:
    """Standard deviation of the mass by generalised least squares on the true motion [kg]."""
    base = base_parameters(robot)
    columns, b = last_link_columns(robot, base), base.n_rigid
    pi = torch.tensor(base.independent)
    n = robot.n
    total = torch.zeros(b + 4 * n + 10, b + 4 * n + 10, dtype=torch.float64)
    for k, run in enumerate((empty, loaded)):
        q, dq, ddq = run.motion
        rigid = regressor(robot, q, dq, ddq)[..., pi]
        a = 0.0
        if run.slow:
            a = float(torch.exp((run.log.t[0] - run.log.t[1]) / SLOW))
        for j in range(n):
            going = dq[:, j].abs() > 0.02
            if int(going.sum()) < 10:
                continue
            own = torch.zeros(len(q), 2 * 2 * n, dtype=torch.float64)
            own[:, 2 * n * k + j], own[:, 2 * n * k + n + j] = dq[:, j], dq[:, j].sign()
            rows = torch.cat([rigid[:, j], own, k * rigid[:, j] @ columns], 1) / run.sigma[j]
            white = torch.cat([rows[:1], (rows[1:] - a * rows[:-1]) / (1 - a * a) ** 0.5])
            total += white[going].T @ white[going]
    size = total.diagonal().sqrt()
    scale = torch.where(size > 0, 1 / size, 0.0)
    values, axes = torch.linalg.eigh(total * scale * scale.unsqueeze(1))
    known = values > 1e-13 * values[-1]
    mass = axes[-10] * scale[-10]
    if size[-10] == 0 or float((axes[-10, ~known]).square().sum()) > 1e-6:
        return float("inf")
    return float((mass[known].square() / values[known]).sum().sqrt())


def pair(cell: tuple[float, int, str], name: str, seed: int, cutoff: float | str) -> dict:
    """One pair: its payload's truth and what is said of it."""
    rate, digits, moving = cell
    g = torch.Generator().manual_seed(seed)
    nominal = load_robot(name)
    pi = nominal.require_parameters("the benchmark").pi
    scale = uniform(g, 0.8, 1.2, nominal.n, 1)
    shifted = InertialParameters(pi * scale)
    truth = nominal.with_parameters(shifted)
    model = ("general", "general", "point_mass")[seed % 3]
    mass = float(10 ** uniform(g, -0.52, 0.7, 1))
    com = uniform(g, -0.1, 0.1, 3)
    side = uniform(g, 0.04, 0.2, 3).square()
    inertia = torch.zeros(6, dtype=torch.float64)
    if model == "general":
        inertia[[0, 3, 5]] = mass / 12 * (side.sum() - side)
    body = InertialParameters.from_com(torch.tensor([mass]).double(), com[None], inertia[None]).pi[
        0
    ]
    everything = list(range(nominal.n))
    count = nominal.n if moving == "all" else min(int(moving), nominal.n)
    joints = sorted(torch.randperm(nominal.n, generator=g)[:count].tolist())
    if count == 1:
        joints = [int(torch.randint(nominal.n, (1,), generator=g))]
    slow, well = bool(seed // 2 % 2), bool(seed % 2)
    good = moved(nominal, seed, rate, everything, None)
    level = inverse_dynamics(truth, *good[1:]).square().mean(0).sqrt()
    fc, fv = uniform(g, 0.05, 0.2, nominal.n) * level, uniform(g, 0.03, 0.1, nominal.n) * level
    friction, sigma = torch.stack([fv, fc]), uniform(g, 0.005, 0.03, 1) * level
    sag = uniform(g, -0.05, 0.05, nominal.n) if seed // 4 % 2 else None
    empty_motion = good if well else moved(nominal, seed, rate, joints, None)
    loaded_motion = moved(nominal, seed, rate, joints, sag)
    empty = recorded(truth, empty_motion, friction, sigma, slow, digits, g)
    carrying = with_payload(truth, body)
    loaded = recorded(carrying, loaded_motion, friction, sigma, slow, digits, g)
    true = torch.cat([torch.tensor([mass]).double(), com, inertia, body])
    out = {"seed": seed, "robot": name, "rate": rate, "digits": digits, "moving": moving,
           "well": well, "slow": slow, "sag": sag is not None, "model": model, "mass": mass,
           "oracle": oracle(nominal, empty, loaded), "error": ""}  # fmt: skip
    try:
        load = torchid.payload(
            nominal, empty.log, loaded.log, model=model,
            settings=torchid.Settings(rows="moving", cutoff=cutoff),
        )  # fmt: skip
    except TorchidError as error:
        return out | {"error": str(error).splitlines()[0]}
    except Exception as fault:
        return out | {"error": f"FAULT {fault!r}"}
    parts = (load.tool.mass, load.tool.com, load.tool.inertia_about_com, load.tool.parameters)
    value, low, high = (
        torch.cat([getattr(x, end) for x in parts]) for end in ("value", "low", "high")
    )
    known = ~value.isnan()
    if model == "point_mass":
        known[4:] = False
    hit = (low <= true) & (true <= high)
    return out | {"known": known.tolist(), "hit": hit.tolist(), "seen": load.seen,
                  "value": value[:4].tolist(), "low": low[:4].tolist(),
                  "high": high[:4].tolist()}  # fmt: skip


GROUPS = {"mass": slice(0, 1), "com": slice(1, 4), "inertia": slice(4, 10), "m c": slice(11, 14),
          "J": slice(14, 20)}  # fmt: skip


def held(rows: list[dict], part: slice) -> tuple[int, int, int]:
    """Intervals that hold the truth, intervals, quantities."""
    known = [k for r in rows for k in r["known"][part]]
    hit = [h for r in rows for h in r["hit"][part]]
    return sum(h for h, k in zip(hit, known, strict=True) if k), sum(known), len(known)


def line(name: str, rows: list[dict]) -> tuple[object, ...]:
    """A row of the table: name, then how often intervals hold the truth, and how wide they are."""
    done = [r for r in rows if not r["error"]]
    counts = [held(done, part) for part in GROUPS.values()]
    cells = [f"{percent(hits, known)} of {known}/{every}" for hits, known, every in counts]
    wide = [
        (r["high"][0] - r["low"][0]) / (2 * 1.96 * r["oracle"])
        for r in done
        if r["known"][0] and r["oracle"] < float("inf")
    ]
    ratio = f"{median(wide):.2f}" if wide else "-"
    total = percent(sum(c[0] for c in counts), sum(c[1] for c in counts))
    return name, len(rows), len(rows) - len(done), *cells, total, ratio


def percent(hits: int, known: int) -> str:
    """A share, where there is any."""
    return f"{100 * hits / known:.1f}" if known else "-"


def main(
    *,
    pairs: int = 40,
    first: int = 0,
    rates: tuple[float, ...] = (50.0, 200.0, 500.0),
    digits: tuple[int, ...] = (0, 5),
    moving: tuple[str, ...] = ("all", "3", "2", "1"),
    robots: tuple[str, ...] = ("3r", "ur10e", "kuka_lwr4"),
    cutoff: str = "8",
    out: Path | None = None,
    jobs: int = 1,
) -> None:
    """Pairs from a first seed on, with a filter's cut-off [Hz] or auto; a row of the table for each
    cell. What is said of them is kept in the folder `out`."""
    cells, cases = list(itertools.product(rates, digits, moving)), {}
    for seed in range(first, first + pairs):
        g = torch.Generator().manual_seed(seed + 10**6)
        cell = cells[int(torch.randint(len(cells), (1,), generator=g))]
        name = robots[int(torch.randint(len(robots), (1,), generator=g))]
        case = cell, name, seed, cutoff if cutoff == "auto" else float(cutoff)
        cases[f"{seed}-{digest(*case)}"] = case
    rows, lines = [row for _, row in results(pair, cases, out, jobs=jobs)], []
    for key in ("rate", "digits", "moving", "robot", "well", "slow", "sag", "model"):
        split = defaultdict(list)
        for r in rows:
            split[r[key]].append(r)
        lines += [line(f"{key} {value}", split[value]) for value in sorted(split, key=str)]
    print("share of intervals that hold the truth [%], of intervals said / quantities")
    table(("", "n", "errors", *GROUPS, "all", "width/oracle"), [*lines, line("all", rows)])
    for said, count in Counter(r["error"] for r in rows if r["error"]).items():
        print(f"{count:5d} x {said}")


if __name__ == "__main__":
    command(main)
