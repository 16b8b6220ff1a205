"""`torchid wrenches`: internal forces and moments of sets with the same torque."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import torchid
from torchid.app import options as opt
from torchid.app.output import Computed, Output
from torchid.app.signature import command
from torchid.errors import TorchidError
from torchid.study.equal_torque.settings import MARGIN

if TYPE_CHECKING:
    from torchid.effects.base import Motion


@command
def wrenches_command(
    *,
    arm: opt.Arm,
    sets: Annotated[list[Path] | None, typer.Option(metavar="FILE")] = None,
    per_kind: Annotated[int, typer.Option(min=15, max=100_000)] = 200,
    reference: Annotated[str | None, typer.Option(metavar="ID")] = None,
    trajectory: Annotated[Path | None, typer.Option(metavar="LOG")] = None,
    max_acceleration: opt.Accelerations = None,
    geometry: Annotated[str | None, typer.Option(metavar="GROUP")] = None,
    total_mass: opt.TotalMass = None,
    margin: Annotated[float, typer.Option(min=0, max=100)] = MARGIN,
    variants: bool = True,
    resamples: opt.Count = 1000,
    seed: opt.Seed = 0,
    output: Computed,
) -> None:
    """Compare the internal forces of parameter sets: by reason, by degree, by joint.

    Examples: `torchid wrenches 3r --per-kind 300 --out result`;
    `torchid wrenches arm.urdf --sets sets/sets.json --reference run_1 --trajectory motion.csv`

    Args:
        sets: Sets to compare with the robot's nominal parameters. May be given several times.
            Without: families of sets with equal torque, feasible and not, are drawn.
        per_kind: Sets of each kind of violation.
        reference: With --sets: compare with this set, not with the nominal one.
        trajectory: Motion to compare on. Default: a sinusoid within the robot's limits.
        geometry: Bounds whose CoM boxes are the links' geometry. Default: normal_corrected, or
            normal.
        total_mass: Interval of the total mass [kg]. Default: the robot's, or 0.9 to 1.25 times the
            nominal one (not with --sets).
        margin: Where the nominal parameters are not feasible: smallest eigenvalue of the
            pseudo-inertias of the reference [kg m^2, kg].
        variants: Ask the question again with other outer bounds.
        resamples: Of the bootstrap of the intervals.
    """
    from torchid.report.equal_torque import findings, shown
    from torchid.study.equal_torque.setting import equal_torque_setting, logged_motion

    found = opt.limited(arm.load(), None, max_acceleration)
    motion = None if trajectory is None else logged_motion(torchid.read_log(trajectory), found)
    if reference is not None and not sets:
        raise TorchidError("--reference names one of the sets of --sets.", got=reference)
    if sets:
        _given(found, sets, reference, geometry, total_mass, motion, resamples, seed, output)
        return
    setting = equal_torque_setting(found, geometry=geometry, total_mass=total_mass, margin=margin)
    with output.progress() as progress:
        study = torchid.equal_torque_study(
            setting.robot,
            per_kind=per_kind,
            setting=setting,
            motion=motion,
            with_variants=variants,
            resamples=resamples,
            seed=seed,
            progress=progress,
        )
    data = {**study.plain(), "findings": findings(study)}
    output.give(data, "wrenches.json", lambda _: shown(study))


def _given(
    robot: "torchid.Robot",
    files: list[Path],
    reference: str | None,
    geometry: str | None,
    total_mass: tuple[float, float] | None,
    motion: "Motion | None",
    resamples: int,
    seed: int,
    output: Output,
) -> None:
    from torchid.feasibility.sets import other_robot, read_all_sets
    from torchid.report.given_sets import shown, unequal
    from torchid.study.equal_torque.record import given_record

    sets = read_all_sets(files, robot)
    if reference is not None and reference not in sets.ids:
        raise TorchidError(
            "--reference names none of the sets.", got=reference, available=sets.ids[:20]
        )
    found = torchid.compare_wrenches(
        robot, sets, reference, motion=motion, geometry=geometry, total_mass=total_mass,
        resamples=resamples, seed=seed,
    )  # fmt: skip
    told = [note for file in files if (note := other_robot(file, robot))] + unequal(found)
    data = given_record(found, tuple(str(file) for file in files)).plain() | {"warnings": told}
    output.give(data, "wrenches.json", lambda _: shown(found, told), seed=seed)
