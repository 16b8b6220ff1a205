"""`torchid wrenches`: internal forces and moments of sets with the same torque."""

from pathlib import Path
from typing import Annotated

import typer

import torchid
from torchid.app import options as opt
from torchid.app.inputs import RECORDED
from torchid.app.output import Drawn
from torchid.app.signature import command
from torchid.errors import TorchidError
from torchid_study.equal_torque.settings import MARGIN


@command
def wrenches_command(
    *,
    arm: opt.Arm,
    sets: Annotated[list[Path] | None, typer.Option(metavar="FILE")] = None,
    per_kind: Annotated[int, typer.Option(min=15, max=100_000)] = 200,
    reference: Annotated[str | None, typer.Option(metavar="ID")] = None,
    trajectory: Annotated[Path | None, typer.Option(metavar="LOG"), RECORDED] = None,
    max_acceleration: opt.Accelerations = None,
    geometry: Annotated[str | None, typer.Option(metavar="GROUP")] = None,
    total_mass: opt.TotalMass = None,
    margin: Annotated[float, typer.Option(min=0, max=100)] = MARGIN,
    resamples: opt.Count = 1000,
    seed: opt.Seed = 0,
    output: Annotated[Drawn, "wrenches.json"],
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
        max_acceleration: Acceleration limits, in place of the robot's (a URDF has none).
        geometry: Bounds whose CoM boxes are the links' geometry. Default: normal_corrected, or
            normal.
        total_mass: Interval of the total mass [kg]. Default: the robot's, or 0.9 to 1.25 times the
            nominal one (not with --sets).
        margin: Where the nominal parameters are not feasible: smallest eigenvalue of the
            pseudo-inertias of the reference [kg m^2, kg].
        resamples: Of the bootstrap of the intervals.
    """
    from msgspec import structs

    from torchid.feasibility.sets import other_robot, read_all_sets
    from torchid_study.equal_torque.given_sets import given_record
    from torchid_study.equal_torque.setting import equal_torque_setting, logged_motion
    from torchid_study.report.wrenches import (
        findings,
        report_of_equal_torque,
        report_of_given_sets,
        unequal_torque,
    )

    robot = opt.with_limits(arm.load(), None, max_acceleration)
    motion = None if trajectory is None else logged_motion(torchid.read_log(trajectory), robot)
    if reference is not None and not sets:
        raise TorchidError("--reference names one of the sets of --sets.", got=reference)
    if not sets:
        setting = equal_torque_setting(
            robot, geometry=geometry, total_mass=total_mass, margin=margin
        )
        with output.progress() as progress:
            study = torchid.equal_torque_study(
                setting.robot, per_kind=per_kind, setting=setting, motion=motion,
                resamples=resamples, seed=seed, progress=progress,
            )  # fmt: skip
        families = structs.replace(study.record, findings=tuple(findings(study.record)))
        output.give(families, "wrenches.json", report_of_equal_torque)
        return
    given = read_all_sets(sets, robot)
    comparison = torchid.compare_wrenches(
        robot, given, reference, motion=motion, geometry=geometry, total_mass=total_mass,
        resamples=resamples, seed=seed,
    )  # fmt: skip
    notes = [note for file in sets if (note := other_robot(file, robot))]
    record = given_record(comparison, tuple(map(str, sets)))
    record = structs.replace(record, warnings=(*notes, *unequal_torque(record)))
    output.give(record, "wrenches.json", report_of_given_sets, seed=seed)
