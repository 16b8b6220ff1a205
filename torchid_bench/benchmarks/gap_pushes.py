"""Pushes planted into real logs: are they found, when do they begin, and how large is the force?

    python -m torchid_bench.benchmarks.gap_pushes DATA --work DIR [--logs panda,ur10e] [--sizes 2 5] [--draws 3]
    python -m torchid_bench.benchmarks.gap_pushes DATA --work DIR --score

Each log is cut in two, as in `gap_planted.py`: the first half makes the model. A push of 0.1 to 3 s
with flanks of 30 ms, of random direction, is added to the torque of the second half by J' F. In its
window it is `size` times as large (root mean square, on the joint that feels it most) as what the
model leaves on that joint. Answers are kept in DIR.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchid.log.model import Log
from torchid.robot.jacobian import tool_jacobian
from torchid.robot.model import Robot
from torchid_bench.benchmarks.gap_plant import generator
from torchid_bench.benchmarks.gap_planted import answer, modelled, settings_of
from torchid_bench.benchmarks.planted_cases import SOURCES
from torchid_bench.benchmarks.runner import command, results, share, table

FLANK = 0.03
"""Time in which the force comes and goes [s]."""


def pushed(
    robot: Robot, log: Log, left: torch.Tensor, size: float, seed: tuple[str, int]
) -> tuple[Log, dict[str, Any]] | None:
    """The log with one push, and its key; None where no joint feels it.

    Args:
        robot, log: arm and log of the second half.
        left: (n,) what the model leaves [N m].
        size: times that.
        seed: of the log's name and the draw.
    """
    g = generator("pushes", *map(str, seed))
    assert log.tau is not None
    # Place in the log, length, and direction are the same for every size.
    rows = list(log.slices())[int(torch.randint(len(log.slices()), (1,), generator=g))]
    t = log.t[rows]
    length = 0.1 * 30.0 ** float(torch.rand(1, generator=g))
    length = min(length, 0.25 * float(t[-1] - t[0]))
    free = float(t[-1] - t[0]) - length - 1.0
    start = float(t[0]) + 0.5 + free * float(torch.rand(1, generator=g))
    direction = torch.randn(3, dtype=torch.float64, generator=g)
    direction /= direction.norm()
    # Half cosines as flanks: another form than the library's.
    rise = ((t - start) / FLANK).clamp(0, 1)
    fall = ((start + length - t) / FLANK).clamp(0, 1)
    shape = (1 - torch.cos(torch.pi * torch.minimum(rise, fall))) / 2
    unit = tool_jacobian(robot, log.q[rows])[:, :3].mT @ direction * shape[:, None]
    inside = shape > 0
    felt = unit[inside].square().mean(0).sqrt() / left
    if not float(felt.max()) > 0:
        return None
    force = size / float(felt.max())
    tau = log.tau.clone()
    tau[rows] += force * unit
    # Windows are on the trajectory's own clock.
    begun = start - float(t[0])
    key = {
        "start": begun, "stop": begun + length, "force": (force * direction).tolist(),
        "size": size, "felt": (felt * force).tolist(), "joint": int(felt.argmax()),
    }  # fmt: skip
    return log.replace(tau=tau), key


def asked(label: str, data: Path, work: Path, draw: int, size: float) -> dict[str, Any] | None:
    """What is answered of a log with one push."""
    robot, second, unplanted = modelled(label, SOURCES[label], data, work)
    left = torch.tensor([j["after"] for j in unplanted["how_far"]["per_joint"]]).double()
    made = pushed(robot, second, left, size, (label, draw))
    if made is None:
        return None
    case = {"planted": made[1], "answer": answer(robot, made[0], settings_of(SOURCES[label]))}
    print(label, draw, verdict(case), flush=True)
    return case


def verdict(case: dict[str, Any]) -> dict[str, Any]:
    """Whether the push was found, and how well."""
    key, names = case["planted"], case["answer"]["which"]
    out: dict[str, Any] = {"size": key["size"], "seconds": round(key["stop"] - key["start"], 2)}
    own = [w for w in names if w["effect"] == "contact"]
    true = np.array(key["force"])
    for w in own:
        own_window = w["parameters"]["start"], w["parameters"]["stop"]
        overlap = min(own_window[1], key["stop"]) - max(own_window[0], key["start"])
        union = max(own_window[1], key["stop"]) - min(own_window[0], key["start"])
        if overlap > 0.3 * union:
            force = np.array([w["parameters"][f"f{a}"] for a in "xyz"])
            out["onset"] = round(own_window[0] - key["start"], 3)
            out["force"] = round(float(np.linalg.norm(force - true) / np.linalg.norm(true)), 2)
    out["found"] = "onset" in out
    out["contacts"] = len(own)
    out["names"] = [f"{w['effect']}{w['joints']}" for w in names][:6]
    return out


def scored(work: Path, sizes: Sequence[float]) -> None:
    """A table, a line a size."""
    for folder in sorted(work.iterdir()):
        none = json.loads((folder / "none.json").read_text())
        print(f"{folder.name}, nothing planted: {[w['effect'] for w in none['which']]}")
    rows = []
    for size in sizes:
        cases = [verdict(json.loads(p.read_text())) for p in work.glob(f"*/push*-{size:g}.json")]
        hits = [c for c in cases if c["found"]]
        onset = sum(abs(c["onset"]) <= 0.05 for c in hits)
        force = sum(c["force"] <= 0.2 for c in hits)
        of = f"of {len(hits)}"
        rows.append((f"{size:g}", share(len(hits), len(cases)), f"{onset} {of}", f"{force} {of}"))
    heads = "times what the model leaves", "found", "onset within 50 ms", "force within 20 %"
    table(heads, rows)


def main(
    data: Path,
    *,
    work: Path,
    logs: tuple[str, ...] = tuple(SOURCES),
    sizes: Sequence[float] = (1.0, 2.0, 5.0, 10.0),
    draws: int = 3,
    first: int = 0,
    score: bool = False,
    jobs: int = 1,
) -> None:
    """Ask about all pushes that have no answer yet, or count what was answered."""
    if score:
        return scored(work, sizes)
    for label in logs:
        modelled(label, SOURCES[label], data, work)
        cases = {
            f"push{draw}-{size:g}": (label, data, work, draw, size)
            for draw in range(first, first + draws)
            for size in sizes
        }
        list(results(asked, cases, work / label, jobs=jobs))


if __name__ == "__main__":
    command(main)
