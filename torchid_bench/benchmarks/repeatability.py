"""How far a fit's numbers vary from one draw of an arm's motions to the next, and what each says of
that itself.

    python -m torchid_bench.benchmarks.repeatability positions ROBOT LOG... --work DIR [--draws 10] [--fits torchid,sysid]
    python -m torchid_bench.benchmarks.repeatability torques ROBOT LOG... --work DIR [--gain K1,K2,..]

Draws have no motion in common. Of commands and positions each is some whole motions, to which
torchid's diagnosis and mujoco.sysid with offsets (31 numbers of six joints: `peers_positions`) are
fitted; of torques each is an equal part of the time, to which `torchid.identify` and Pinocchio's
regressor with friction by ordinary least squares are. A deviation is what a fit states: torchid's
covariance; `sysid.calculate_intervals`; s² (X'X)⁻¹. What is searched on a logarithmic scale is
compared there. A number counts where three draws have it.

The score: how many numbers x draws are within 1.96 stated deviations of the mean of the other draws.
"""

import io
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.linalg import qr

import torchid
from torchid.design.bands import CUTOFF
from torchid.design.motion import measurements
from torchid.effects.servo import INDEX
from torchid.log.model import Log
from torchid.log.readers import read_log
from torchid.position.data import WINDOW_S, prepare
from torchid.position.diagnosis import PositionDiagnosis
from torchid.position.fit import absolute
from torchid.robot.library import load_robot
from torchid_bench.benchmarks.peers_positions import FITTED, chunks_of, fit, residual
from torchid_bench.benchmarks.runner import command, digest, results, share, table
from torchid_bench.benchmarks.sysid_toolbox import sysid_toolbox

HALF_95 = 1.96
FEWEST = 3
"""Draws that a number must be in."""
TOLERANCE = 1e-6
"""Of the pivots of a regressor's columns that are independent [1]."""
HEAD = ("fit", "numbers", "draws", "within 1.96 stated deviations", "spread / stated, median",
        "CPU s a draw", "spread farthest beyond what is stated")  # fmt: skip

Numbers = Mapping[str, tuple[float, float]]
"""Values of a fit and the deviations that it states, by name."""


def of_torchid(robot: str, logs: Sequence[Path]) -> dict[str, Any]:
    """Numbers of servos that a diagnosis finds."""
    begun = time.process_time()
    diagnosis = torchid.diagnose(load_robot(robot), read_log(list(logs)))
    assert isinstance(diagnosis, PositionDiagnosis)
    values = absolute(diagnosis.corrected.servos)
    numbers = {
        f"{name} {known.joint + 1}": (float(values[known.joint, INDEX[name]]), float(deviation))
        for known in diagnosis.known
        for name, deviation in zip(known.names, known.covariance.diagonal().sqrt(), strict=True)
    }
    return {"numbers": numbers, "seconds": time.process_time() - begun}


def of_sysid(robot: str, logs: Sequence[Path], windows: int) -> dict[str, Any]:
    """Numbers that mujoco.sysid finds of servos with offsets."""
    sysid, begun = sysid_toolbox(), time.process_time()
    arm = load_robot(robot)
    data = prepare(arm, read_log(list(logs)))
    spec, best = fit(arm, data, FITTED["offset"], windows, firm=True)
    function = residual(spec, data, chunks_of(data, WINDOW_S, windows))
    at, step = best.as_vector(), 1e-4
    moved = np.stack([at, *(at + step * np.eye(len(at)))], 1)
    each = np.concatenate(function(moved, best)[0])
    with redirect_stdout(io.StringIO()):
        slopes = (each[:, 1:] - each[:, :1]) / step
        _, half = sysid.calculate_intervals([each[:, 0]], slopes)
    names = [name for name, p in best.items() for _ in range(p.size)]
    deviations = np.asarray(half, dtype=float) / HALF_95
    numbers = {n: (float(x), float(s)) for n, x, s in zip(names, at, deviations, strict=True)}
    return {"numbers": numbers, "seconds": time.process_time() - begun}


def of_identify(robot: str, log: Log) -> dict[str, Any]:
    """Base parameters and friction, by what torchid does without settings."""
    begun = time.process_time()
    model = torchid.identify(load_robot(robot), log)
    std = model.covariance.diagonal().sqrt()
    rows = zip(model.base.names, model.values.tolist(), std.tolist(), model.free, strict=True)
    numbers = {name: (value, std) for name, value, std, free in rows if free}
    return {"numbers": numbers, "seconds": time.process_time() - begun}


def of_pinocchio(robot: str, log: Log, kept: Sequence[int] = ()) -> dict[str, Any]:
    """Independent columns of Pinocchio's torque regressor, with viscous and dry friction and an
    offset of each joint, by ordinary least squares.

    Args:
        robot, log: as elsewhere.
        kept: columns that are independent; those of this log where there are none.
    """
    from tests.oracles import PinocchioOracle

    begun, arm = time.process_time(), load_robot(robot)
    oracle = PinocchioOracle(arm)
    blocks, torques = [], []
    for m in measurements(log.even, CUTOFF):
        inside = slice(m.edge, m.samples - m.edge, max(1, int(m.rate / (2.5 * CUTOFF))))
        motion = [x.numpy()[inside] for x in (m.whole.q, m.whole.dq, m.whole.ddq)]
        for q, dq, ddq in zip(*motion, strict=True):
            rigid = oracle.pin.computeJointTorqueRegressor(oracle.model, oracle.data, q, dq, ddq)
            own = (np.diag(dq), np.diag(np.sign(dq)), np.eye(arm.n))
            blocks.append(np.concatenate([rigid, *own], 1))
        torques.append(m.tau.numpy()[inside].ravel())
    x, y = np.concatenate(blocks), np.concatenate(torques)
    size = np.linalg.norm(x, axis=0).clip(1e-12)
    if not len(kept):
        _, r, order = qr(x / size, mode="economic", pivoting=True)
        pivots = abs(r.diagonal())
        kept = sorted(order[: int((pivots > TOLERANCE * pivots[0]).sum())].tolist())
    a = x[:, kept] / size[kept]
    value = np.linalg.lstsq(a, y, rcond=None)[0]
    left = ((y - a @ value) ** 2).sum() / (len(y) - len(kept))
    std = np.sqrt(left * np.linalg.inv(a.T @ a).diagonal()) / size[kept]
    numbers = {
        f"{k}": (float(v), float(s)) for k, v, s in zip(kept, value / size[kept], std, strict=True)
    }
    return {"numbers": numbers, "seconds": time.process_time() - begun, "kept": list(kept)}


def scored(name: str, draws: Sequence[Mapping[str, Any]]) -> tuple[object, ...]:
    """A row of the table."""
    each = defaultdict[str, list[tuple[float, float]]](list)
    for draw in draws:
        for number, pair in draw["numbers"].items():
            each[number].append(pair)
    hits = count = 0
    ratios = {}
    for number, pairs in each.items():
        if len(pairs) < FEWEST:
            continue
        x, std = np.array(pairs).T
        others = (x.sum() - x) / (len(x) - 1)
        hits += int((abs(x - others) <= HALF_95 * std).sum())
        count += len(x)
        ratios[number] = float(x.std(ddof=1) / max(np.median(std), 1e-300))
    worst = sorted(ratios, key=ratios.__getitem__, reverse=True)[:3]
    seconds = np.mean([draw["seconds"] for draw in draws])
    return (
        name, len(ratios), len(draws), share(hits, count), f"{np.median(list(ratios.values())):.2g}",
        f"{seconds:.3g}", ", ".join(f"{n} ({ratios[n]:.0f} x)" for n in worst),
    )  # fmt: skip


def positions(
    robot: str,
    logs: Sequence[Path],
    *,
    work: Path,
    draws: int = 10,
    motions: int = 3,
    windows: int = 60,
    fits: tuple[str, ...] = ("torchid", "sysid"),
    seed: int = 0,
) -> None:
    """Fit draws of whole motions."""
    order = np.random.default_rng(seed).permutation(len(logs))
    sorted_logs = sorted(logs)
    parts = [[sorted_logs[i] for i in order[k * motions :][:motions]] for k in range(draws)]
    parts = [part for part in parts if len(part) == motions]
    make = {"torchid": (of_torchid, ()), "sysid": (of_sysid, (windows,))}
    values = defaultdict[str, list[Mapping[str, Any]]](list)
    # Draw by draw, so that what is interrupted has as many of each.
    for part in parts:
        for name in fits:
            function, more = make[name]
            case = (robot, part, *more)
            key = f"{name}_{digest(name, *[p.name for p in part], *more)}"
            values[name] += [one for _, one in results(function, {key: case}, work)]
    table(HEAD, [scored(name, own) for name, own in values.items()])


def torques(
    robot: str, logs: Sequence[Path], *, work: Path, draws: int = 10, gain: tuple[float, ...] = ()
) -> None:
    """Fit parts of the time of all logs."""
    log = read_log(list(logs))
    if gain:
        log = log.with_torque(torch.tensor(gain, dtype=torch.float64))
    each = log.trajectories()
    total = sum(float(x.t[-1] - x.t[0]) for x in each)
    parts = []
    for one in each:
        count = max(1, round(draws * float(one.t[-1] - one.t[0]) / total))
        edges = torch.linspace(float(one.t[0]), float(one.t[-1]), count + 1)
        parts += [one.select((one.t >= a) & (one.t <= b)) for a, b in pairwise(edges)]
    values = defaultdict[str, list[Mapping[str, Any]]](list)
    kept = of_pinocchio(robot, log)["kept"]
    makers = {"torchid": (of_identify, ()), "Pinocchio": (of_pinocchio, (kept,))}
    for name, (function, more) in makers.items():
        cases = {
            f"{name}_{k}_{digest(len(parts))}": (robot, part, *more) for k, part in enumerate(parts)
        }
        values[name] = [one for _, one in results(function, cases, work)]
    table(HEAD, [scored(name, own) for name, own in values.items()])


if __name__ == "__main__":
    command(positions, torques)
