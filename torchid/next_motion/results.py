"""The next motion for a result: an identification's or a diagnosis's."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from torchid.errors import TorchidError
from torchid.excitation.clearance import Clearance
from torchid.excitation.design import optimise_trajectory
from torchid.excitation.informed import InformedDesign, design_for
from torchid.excitation.torque import corrected_torque_limits
from torchid.identification.record import SCHEMA as IDENTIFICATION
from torchid.identification.values import read_prior
from torchid.json_data import read_json
from torchid.next_motion.ambiguity import SCHEMA as GAP
from torchid.next_motion.ambiguity import read_open
from torchid.next_motion.rivals import rivals
from torchid.next_motion.separating_motion import Separation, design_separation
from torchid.robot.model import Robot

EVALUATIONS = 75
"""Trajectories that the search for a separating motion tries a restart."""


@dataclass(frozen=True, eq=False)
class NextMotion:
    """What was designed for a result.

    Attributes:
        design: for an identification, or for a diagnosis.
        kind: of what the diagnosis leaves open; empty for an identification.
        notes: sentences for the user.
    """

    design: InformedDesign | Separation
    kind: str = ""
    notes: tuple[str, ...] = ()


def read_result(path: Path) -> Mapping[str, Any]:
    """An identification or a diagnosis, as JSON.

    Raises:
        TorchidError: another kind of file, or of another version.
    """
    data = read_json(path, "a result")
    schema = data.get("schema")
    if schema in (IDENTIFICATION, GAP):
        return data
    kind = str(schema).partition("/")[0]
    commands = {GAP.partition("/")[0]: "gap", IDENTIFICATION.partition("/")[0]: "identify"}
    again = f"it is of another version: torchid {commands.get(kind)} ROBOT LOG... --json FILE"
    raise TorchidError(
        f"'{path}' is not a result that a motion can be designed for.",
        got=f"schema {schema}",
        available=[IDENTIFICATION, GAP],
        hint=again if kind in commands else None,
    )


def next_motion(
    path: Path,
    data: Mapping[str, Any],
    robot: Robot,
    *,
    criterion: str | None,
    seed: int,
    restarts: int,
    harmonics: int,
    duration: float,
    usage: float,
    clearance: Clearance | None,
    progress: Callable[[str, int, int], None] | None = None,
) -> NextMotion:
    """The motion that fixes what an identification knows least, or separates what a diagnosis
    cannot tell apart.

    Args:
        path, data: of the result, from `read_result`.
        robot: with limits.
        criterion: `a_optimal` (default) or `d_optimal` for an identification; None for a diagnosis.
        seed: of the random starts.
        restarts: their number.
        harmonics: of the series.
        duration: [s].
        usage: share of the limits that may be used.
        clearance: what the motion keeps clear of.
        progress: called with (stage, done, total).

    Raises:
        TorchidError: another criterion, or a result that asks for no motion.
    """

    def told(stage: str) -> Callable[[int, int], None] | None:
        return None if progress is None else partial(progress, stage)

    series: dict[str, Any] = {"harmonics": harmonics, "duration": duration, "usage": usage}
    if data["schema"] != GAP:
        goal: Any = criterion or "a_optimal"
        if goal == "condition":
            raise TorchidError(
                "for an identification motions have other criteria.",
                got=goal,
                available=["a_optimal", "d_optimal"],
            )
        prior = read_prior(path, robot)
        return NextMotion(
            design_for(
                robot, prior, seed=seed, goal=goal, restarts=restarts, clearance=clearance,
                progress=told("designing"), **series,
            )
        )  # fmt: skip
    if criterion is not None:
        raise TorchidError("for a gap diagnosis motions are designed to separate.", got=criterion)
    found = read_open(path, data, robot)
    limits = corrected_torque_limits(found.setting.robot, found.setting.given, usage=usage)
    ordinary = optimise_trajectory(
        robot, seed=seed, restarts=restarts, torque=limits, clearance=clearance,
        progress=told("a plain motion to compare with"), **series,
    ).trajectory  # fmt: skip
    made = design_separation(
        found.setting, rivals(found, ordinary), ordinary, seed=seed, usage=usage,
        clearance=clearance, evaluations=EVALUATIONS * restarts, progress=told("separating"),
    )  # fmt: skip
    return NextMotion(made, found.kind, tuple(found.notes))
