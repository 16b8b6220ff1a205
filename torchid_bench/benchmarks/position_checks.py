"""A real arm against itself, by the answer's parameters and their deviations.

    python -m torchid_bench.benchmarks.position_checks halves ROBOT LOG...   # first against second half of a session
    python -m torchid_bench.benchmarks.position_checks planted ROBOT LOG...  # with and without what is planted

`halves`: how many of the parameters that both halves have agree within 95 % intervals, and which do
not, with what they are worth: by how much the other half's value makes an own loss larger. `planted`:
what can be added to logs without moving the arm again (a command that was sent earlier, a channel in
another scale, a zero that is off) is added to all motions, each on its own joint, and must come back
as the difference of two answers.
"""

from collections.abc import Sequence
from pathlib import Path

import torch

from torchid.log.model import Log
from torchid.position.answered import best_answer
from torchid.position.data import WINDOW_S, PositionData
from torchid.position.fit import searched
from torchid.position.judge import Equations, equations, value_interval
from torchid.position.problem import MOST_WINDOWS, pose, some_of
from torchid.position.servo_model import Motions, ServoModel
from torchid.simulation.servo import INDEX
from torchid.simulation.servo_loop import windows_of
from torchid_bench.benchmarks.position_errors import read_folds
from torchid_bench.benchmarks.runner import command

PLANTED = {1: ("delay", 0.04), 3: ("scale", 1.08), 4: ("offset", 0.05)}
"""By joint, from 1: two samples late [s], a factor on the command [1], and a zero [rad]."""


def answered(robot, parts: Sequence[Log]) -> tuple[PositionData, ServoModel, Equations]:
    answered = best_answer(pose(robot, Log.concatenate(list(parts))))
    data, found = answered.motions.data, answered.model
    windows = some_of(windows_of(data.tracks, WINDOW_S), 3 * MOST_WINDOWS)
    return data, found, equations(data, found.servos, found.free, windows)


def halves(robot: str, logs: Sequence[Path]) -> None:
    """Whether what is fitted to the first half of the motions agrees with the second half's."""
    robot, parts, _ = read_folds(robot, logs, 1)
    half = len(parts) // 2
    one, two = answered(robot, parts[:half]), answered(robot, parts[half:])
    inside, pairs = 0, 0
    for name in one[2].names:
        if name not in two[2].names:
            continue
        for j in range(robot.n):
            columns = [a[2].names.index(name) for a in (one, two)]
            if not all(bool(a[1].free[name][j]) for a in (one, two)):
                continue
            at = [float(searched(a[1].servos)[j, INDEX[name]]) for a in (one, two)]
            std = [float(a[2].deviations()[j, k]) for a, k in zip((one, two), columns, strict=True)]
            apart = abs(at[0] - at[1]) / (std[0] ** 2 + std[1] ** 2) ** 0.5
            inside, pairs = inside + (apart <= 1.96), pairs + 1
            values = [float(a[1].servos.of(name)[j]) for a in (one, two)]
            ends = [value_interval(name, v, s) for v, s in zip(values, std, strict=True)]
            said = " and ".join(
                f"{v:.4g} [{low:.4g}, {high:.4g}]"
                for v, (low, high) in zip(values, ends, strict=True)
            )
            print(f"{'' if apart <= 1.96 else 'apart ':6s}{name} {j + 1}: {said}  {apart:.1f}")
    print(f"{inside} of {pairs} agree within 95 % ({inside / max(1, pairs):.2f})")
    for who, (data, found, _), (_, other, _) in (("first", one, two), ("second", two, one)):
        windows = windows_of(data.tracks, WINDOW_S)
        own, far = (f.losses(Motions(data, windows)) for f in (found, other))
        share = " ".join(f"{x:.2f}" for x in (far / own).tolist())
        print(f"loss of the {who} half by the other's servos, over that by its own: {share}")


def with_planted(log: Log) -> Log:
    """What is logged of an arm that has more and does the same."""
    u = log.u.clone()
    step = float(log.t.diff().median())
    for joint, (name, size) in PLANTED.items():
        j = joint - 1
        if name == "delay":  # it was sent earlier, and the arm did the same
            k = round(size / step)
            u[:, j] = u[(torch.arange(len(u)) + k).clamp(max=len(u) - 1), j]
        elif name == "scale":  # what the arm was told is larger than what is logged
            u[:, j] = u[:, j] / size
        else:  # the arm stands farther than its command says
            u[:, j] = u[:, j] - size
    return log.replace(u=u)


def planted(robot: str, logs: Sequence[Path]) -> None:
    """What is found of what is planted."""
    robot, parts, _ = read_folds(robot, logs, 1)
    plain = answered(robot, parts)
    more = answered(robot, [with_planted(p) for p in parts])
    for joint, (name, size) in PLANTED.items():
        # A zero that is off is a torque over the gain.
        kp = [
            float(a[1].servos.of("kp")[joint - 1]) if name == "offset" else 1.0
            for a in (plain, more)
        ]
        before, after = (
            float(a[1].servos.of(name)[joint - 1]) / k
            for a, k in zip((plain, more), kp, strict=True)
        )
        known = more[2]
        deviation = (
            float(known.deviations()[joint - 1, known.names.index(name)]) / kp[1]
            if name in known.names else float("nan")
        )  # fmt: skip
        found = after / before if name == "scale" else after - before
        print(f"{name} of joint {joint}: planted {size}, found {found:.4g} +- {deviation:.2g} "
              f"({before:.4g}, then {after:.4g})")  # fmt: skip
    for what, a in (("without", plain), ("with", more)):
        free = {k: [j + 1 for j in torch.nonzero(on).flatten().tolist()]
                for k, on in a[1].free.items()}  # fmt: skip
        print(what, free, f"plane {a[1].plane}")


if __name__ == "__main__":
    command(halves, planted)
