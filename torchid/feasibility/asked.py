"""What a check is about: sets of a file, or a robot's nominal parameters."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from torchid.effects.registry import Valued, nominal_effects, nominal_others
from torchid.errors import TorchidError
from torchid.feasibility.plausibility import Finding
from torchid.feasibility.sets import (
    ParameterSets,
    nominal_set,
    other_robot,
    read_other_effects,
    read_sets,
)
from torchid.feasibility.units import nominal_findings
from torchid.json_data import read_json
from torchid.robot.config_files import names_robot
from torchid.robot.library import load_both, load_robot, named_robot
from torchid.robot.model import Robot
from torchid.robot.tree import Choice


@dataclass(frozen=True)
class SetsToCheck:
    """What a check is about.

    Attributes:
        robot: whose bounds, shapes and limits count.
        sets: of parameters.
        others: effects beside them.
        findings: what the elements of the robot's own file show.
        warnings: one sentence each.
    """

    robot: Robot
    sets: ParameterSets
    others: Sequence[Valued]
    findings: Sequence[Finding]
    warnings: tuple[str, ...]


def asked_about(params: str, robot: str | None, choice: Choice) -> SetsToCheck:
    """The sets, or the robot, that a name or a file stands for.

    Args:
        params: a file of parameter sets (.json), or a robot, whose nominal parameters are meant.
        robot: whose bounds, shapes and limits count, if it is another than the file says.
        choice: of its part.

    Raises:
        TorchidError: neither a file nor a robot; or robots with different numbers of links.
    """
    if not names_robot(params):
        if not Path(params).is_file():
            raise TorchidError(
                f"'{params}' is neither a file nor a built-in robot.",
                expected="a .json of parameter sets, or a robot",
            )
        if robot is None:
            named = named_robot(Path(params), read_json(Path(params), "parameter sets"), choice)
        else:
            named = load_robot(robot, **choice.options)
        sets = read_sets(Path(params), named)
        noticed = other_robot(Path(params), named)
        others = read_other_effects(Path(params), named)
        return SetsToCheck(named, sets, others, (), () if noticed is None else (noticed,))
    own, named = load_both(params, robot, choice)
    nominal_effects(named)  # known, complete and in range, though they do not count here
    if own.n_links != named.n_links:
        raise TorchidError(
            f"'{own.name}' and the robot '{named.name}' have different numbers of links.",
            got=own.n_links,
            expected=named.n_links,
        )
    also = nominal_findings(own)
    # The parameters' link frames need not be those of the robot that counts.
    apart = [str(i + 1) for i, d in enumerate(own.frames_apart(named).tolist()) if d > 1e-6]
    differ = (
        f"'{own.name}' and '{named.name}' place the frames of links {', '.join(apart)} "
        "differently: boxes of centres of mass, shapes and the torque may not be meant for these "
        "parameters"
    )
    notes = (differ,) if apart else ()
    return SetsToCheck(named, nominal_set(own), nominal_others(own), also, notes)
