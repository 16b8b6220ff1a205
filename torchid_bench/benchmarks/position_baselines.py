"""Servo models that fitters in use have, on the folds of `position_folds.py` and by its measures.

    python -m torchid_bench.benchmarks.position_baselines ROBOT LOG... [--folds 5] [--only pace,ladder_2]

All are fitted by torchid's own fitter and simulated by its own loop (dry friction holds), so that
models alone are compared: `delayed` is the command, late by the best constant; `pace` has an
armature, damping, dry friction, an offset and a delay at the gain that the robot's maker gives its
simulator; `playground` a gain beside them; `ladder_2` to `ladder_4` add a Stribeck curve, friction
that grows with the load, and both, as bam's M2 to M4 do. `boosting` (needs scikit-learn) predicts
positions from late commands and play operators of them, joint by joint.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import torch

from torchid.log.model import Log
from torchid.position.data import WINDOW_S, prepare
from torchid.position.effects import CORE
from torchid.position.fit import fit
from torchid.position.model import ServoArm
from torchid.position.problem import MOST_WINDOWS, some_of
from torchid.position.replay import replay
from torchid.position.search import _start
from torchid.simulation.servo import INDEX
from torchid.simulation.servo_loop import windows_of
from torchid_bench.benchmarks.position_errors import HEADS, judged, read_folds
from torchid_bench.benchmarks.runner import command, table

MAKERS_KP = [17.8]
"""Of the SO-101's STS3215 in TheRobotStudio's `joints_properties.xml` [N m/rad]."""
STRIBECK = ("stiction", "stribeck_speed")
LADDER = {
    "pace": tuple(name for name in CORE if name != "kp"),
    "playground": CORE,
    "ladder_2": (*CORE, *STRIBECK),
    "ladder_3": (*CORE, "load_share"),
    "ladder_4": (*CORE, *STRIBECK, "load_share"),
}
LATEST = 20
"""Samples that a command may be late."""
PLAYS = (0.005, 0.01, 0.02, 0.04, 0.08)
"""Half widths of play operators [rad]."""


def servo(robot, training: Log, names: tuple[str, ...], gains: list[float]):
    """An arm whose servos have these parameters alone, as (log, seconds) -> positions (T, n); the
    gains [N m/rad] are the maker's where kp is none of them."""
    data = prepare(robot, training)
    windows = some_of(windows_of(data.tracks, WINDOW_S), 3 * MOST_WINDOWS)
    start = _start(data, CORE)
    if "kp" not in names:
        start.joint[:, INDEX["kp"]] = torch.as_tensor(gains, dtype=start.joint.dtype)
    free = {name: torch.ones(robot.n, dtype=torch.bool) for name in names}
    servos = fit(data, start, free, windows, iterations=30)
    arm = ServoArm(robot, servos, data.scale)
    return lambda log, seconds: replay(arm, [log], windows=seconds).simulated[0].q


def delayed(training: Log):
    """The command, late by the best constant of each joint."""
    error = torch.stack(
        [
            torch.cat([(late(p.u, k) - p.q).square() for p in training.trajectories()]).mean(0)
            for k in range(LATEST)
        ]
    )
    best = error.argmin(0).tolist()
    return lambda log, _: torch.stack([late(log.u, k)[:, j] for j, k in enumerate(best)], -1)


def late(u: torch.Tensor, samples: int) -> torch.Tensor:
    return u[(torch.arange(len(u)) - samples).clamp(min=0)]


def play(u: np.ndarray, width: float) -> np.ndarray:
    """What a play of this half width leaves of a signal (T, n)."""
    out, at = np.empty_like(u), u[0]
    for k, value in enumerate(u):
        at = np.clip(at, value - width, value + width)
        out[k] = at
    return out


def boosting(training: Log):
    """Positions beside the command, from late commands and their plays; in windows from where each
    one starts, since a measured start is told to all."""
    from sklearn.ensemble import HistGradientBoostingRegressor

    def features(log: Log) -> list[np.ndarray]:
        u = log.u.numpy()
        plays = [play(u, width) for width in PLAYS]
        lags = [late(log.u, k).numpy() for k in (1, 2, 3, 4, 6, 8, 12, 20)]
        own = [np.stack([*(x[:, j] - u[:, j] for x in lags + plays)], -1) for j in range(log.n)]
        return [np.concatenate([x, u], -1) for x in own]

    parts = training.trajectories()
    given = [features(p) for p in parts]
    learners = []
    for j in range(training.n):
        x = np.concatenate([g[j] for g in given])
        y = np.concatenate([(p.q - p.u)[:, j].numpy() for p in parts])
        learners.append(HistGradientBoostingRegressor(max_iter=300, random_state=0).fit(x, y))

    def told(log: Log, seconds: float | None) -> torch.Tensor:
        beside = [learner.predict(x) for learner, x in zip(learners, features(log), strict=True)]
        q = log.u + torch.tensor(np.stack(beside, -1))
        if seconds is None:
            return q
        length = round(seconds / float(log.t.diff().median()))
        first = torch.arange(len(q)) // length * length
        return q + (log.q - q)[first]

    return told


def main(
    robot: str,
    logs: Sequence[Path],
    *,
    folds: int = 5,
    only: tuple[str, ...] = ("delayed", *LADDER, "boosting"),
    gains: Sequence[float] = MAKERS_KP,
) -> None:
    """Fit and judge models; the gains are the maker's, of all joints or each."""
    arm, parts, places = read_folds(robot, logs, folds)
    makers = {"delayed": delayed, "boosting": boosting} | {
        name: partial(servo, arm, names=names, gains=gains) for name, names in LADDER.items()
    }
    table(HEADS, judged({name: makers[name] for name in only}, parts, places))


if __name__ == "__main__":
    command(main)
