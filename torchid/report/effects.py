"""The effects for people and as plain data: a list of all, and each one in full."""

from collections.abc import Sequence
from functools import cache
from typing import Any

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Effect
from torchid.effects.registry import KINDS
from torchid.effects.rivals import Rival, rivals
from torchid.effects.servo import INDEX, PARAMETERS, ServoEffect
from torchid.excitation.trajectories import random_trajectory
from torchid.json_data import picked
from torchid.report.table import Table
from torchid.results.words import unit_words, value_words
from torchid.robot.library import load_robot

SEED, SECONDS, RATE, CUTOFF = 1, 20.0, 25.0, 8.0
"""The motion that effects are compared along: its seed, duration [s], samples [Hz], band [Hz]."""
Kind = type[Effect] | ServoEffect


def known_rivals(kind: type[Effect]) -> tuple[Rival, ...]:
    """What an effect is confused with on a KUKA LWR IV+, computed once a process."""
    return _all_rivals(tuple(KINDS.items()))[kind.name]


@cache
def _all_rivals(kinds: tuple[tuple[str, type[Effect]], ...]) -> dict[str, tuple[Rival, ...]]:
    robot = load_robot("kuka_lwr4")
    trajectory = random_trajectory(robot, SEED, fill=True, duration=SECONDS)
    motion = trajectory.sample(RATE)
    motion = motion._replace(torque=inverse_dynamics(robot, *motion.state))
    joints = (0, 1, robot.n - 1)  # a vertical axis, the one that carries all, the tool's
    return rivals(robot, [motion], CUTOFF, joints=joints, kinds=dict(kinds))


def effect_record(kind: Kind) -> dict[str, Any]:
    """One effect as plain data."""
    if isinstance(kind, ServoEffect):
        parameters = [PARAMETERS[INDEX[name]] for name in kind.parameters]
        coefficients = [picked(p, "name unit meaning") for p in parameters]
        shapes, rivals = [], [kind.twin] if kind.twin else []
        signature, source = "", ""
    else:
        coefficients = [picked(c, "name unit non_negative meaning") for c in kind.coefficients]
        shapes = [picked(s, "name unit meaning") for s in kind.shapes]
        rivals = [r.name for r in known_rivals(kind)]
        signature, source = kind.signature, kind.source
    return {
        **picked(kind, "effect=name family meaning equation"), "coefficients": coefficients,
        "shapes": shapes, "signature": signature, "confused_with": rivals,
        **picked(kind, "experiment remedy"), "source": source, "logs": list(kind.logs()),
    }  # fmt: skip


def effect_table(kind: Kind) -> Table:
    """All that is known of an effect."""
    one = effect_record(kind)
    numbers = [*one["coefficients"], *one["shapes"]]
    place = {} if isinstance(kind, ServoEffect) else {"place": kind.where}
    facts = place | {x: one[x] for x in ("logs", "signature", "confused_with", "experiment",
                                         "remedy", "source") if one[x]}  # fmt: skip
    rows = [
        ("equation", one["equation"]),
        *((f"{x['name']} [{unit_words(x['unit'])}]", x["meaning"]) for x in numbers),
        *((key.replace("_", " "), value_words(value)) for key, value in facts.items()),
    ]
    return Table(f"{kind.name}: {kind.meaning}", ("", ""), rows, "lp")


def effects_table(kinds: Sequence[Kind]) -> Table:
    """Effects by name, family, numbers, logs that can show them, and meaning."""
    rows = []
    for kind in kinds:
        if isinstance(kind, ServoEffect):
            names = list(kind.parameters)
        else:
            names = [c.name for c in kind.coefficients]
        numbers = ", ".join(names) if len(names) < 6 else f"{', '.join(names[:2])}, .. {names[-1]}"
        rows.append((kind.name, kind.family, numbers, " ".join(kind.logs()), kind.meaning))
    columns = ("effect", "family", "numbers", "logs", "what it is")
    return Table(f"{len(rows)} effects", columns, rows, "ppppp")
