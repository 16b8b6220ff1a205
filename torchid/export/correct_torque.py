"""A diagnosis carried out into the simulator: projected, run in its engine on the log, written.

    project -> files of all folds -> engine: torque of the held-out motion -> file -> engine: motion

Nothing is written before the engine has run the file on the log.
"""

import math
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch
from msgspec import structs

from torchid.design.columns import Columns, Model
from torchid.design.repeats import find_repeats
from torchid.effects.registry import KINDS
from torchid.errors import TorchidError
from torchid.export.correction import (
    Correction,
    CorrectionRequest,
    Forward,
    Judged,
    of_joints,
    without_field,
)
from torchid.export.dynamics import Dynamics, in_places_of, require_same_arm
from torchid.export.engines import AtRunTime, InMujoco, engine_of
from torchid.export.export import SUFFIXES, edited_of
from torchid.export.projection import PRICE, Projection, Projector, Target
from torchid.export.write_actuator import adds_any
from torchid.export.write_xml import xml_of
from torchid.extraction.entropic import SPREAD
from torchid.gap.data import Data, read
from torchid.gap.describe.traces import traces
from torchid.gap.diagnosis import TorqueDiagnosis, Trace
from torchid.gap.folds import Folds, make_folds
from torchid.results.cause import held_out_words
from torchid.results.words import effect_words, listed
from torchid.robot.model import Robot, joint_list
from torchid.simulation.shooting import starts_of, windows_of
from torchid.simulation.two_models import HORIZONS, errors_after, simulated
from torchid.typing import Float, Tensor

STARTS = 128
"""Forward simulations, as many as a diagnosis makes."""

NO_BETTER = 1.02
"""Mean error over that of the nominal robot from which a file is refused."""


def correct_torque(asked: CorrectionRequest, full: Robot | TorqueDiagnosis) -> Correction:
    """Write a robot as a simulator's file can say it, refitted to the log's torque; errors are
    those of `torchid.correct`."""
    robot, log, held_out, settings = asked.robot, asked.log, asked.held_out, asked.settings
    before, corrected = _models(asked, full)
    require_same_arm(corrected, robot, "result is")
    corrected = in_places_of(corrected, robot)
    if held_out is None and settings.held_out_fraction > 0:
        log, held_out = log.split(1 - settings.held_out_fraction)
    # Units were asked when the log was diagnosed.
    data, apart = read(robot, log, held_out, settings, force=True)
    repeats = find_repeats(data.segments).groups(len(data.segments))
    folds = make_folds(data.samples, settings.folds, repeats)
    data = data.without_silent(Columns(Model.of(before), data.samples), folds.parts)
    projector = Projector(robot, corrected, data, asked.to)
    projection = projector.projection()
    judged = _judged(asked, full, projector, projection.robot, apart, folds)
    beside = [
        f"{one.effect}{of_joints(one.joints)} ({one.lost:.2g} of {one.made:.2g} RMS are lost)"
        for one in projection.kept
    ]
    words = f"'{robot.name}', corrected and refitted to {asked.to}"
    if projection.at_bounds:
        words += f" (at a bound: {listed(projection.at_bounds, most=4)})"
    title = words + without_field(beside)
    files = [asked.write(Dynamics(projection.robot, "robot", title), title)]
    if asked.with_effects:
        every = torch.ones(len(data.samples), dtype=torch.bool)
        title = f"{words}, with effects beside it"
        beside_it = Dynamics(projector.with_effects(every), "robot", title)
        files.append(asked.write(beside_it, title, ending="_effects"))
        if asked.with_effects is not True and adds_any(beside_it.robot):
            files.append(asked.write(beside_it, title, asked.with_effects))
    warnings = _warnings(projection, judged, robot, data.silent)
    return Correction(robot, judged, tuple(files), warnings, projection)


def _models(asked: CorrectionRequest, full: Robot | TorqueDiagnosis) -> tuple[Robot, Robot]:
    """The robot that was diagnosed, and what it became."""
    if isinstance(full, TorqueDiagnosis):
        return full.robot, full.corrected
    return asked.robot, full


def _judged(
    asked: CorrectionRequest,
    full: Robot | TorqueDiagnosis,
    projector: Projector,
    robot: Robot,
    apart: Data | None,
    folds: Folds,
) -> Judged:
    """What the file of a robot is worth in its engine, on a log apart; of a diagnosis without one
    fits without each fold judge the kind of file.

    Raises:
        TorchidError: it is no better than the robot as given.
    """
    data, to, (before, corrected) = projector.data, asked.to, _models(asked, full)
    by_folds = apart is None and isinstance(full, TorqueDiagnosis)
    parts, fitted = [torch.ones(len(data.samples), dtype=torch.bool)], [robot]
    if by_folds:
        parts = [folds.fitted(k) for k in range(folds.count)]
        fitted = [projector.without(part) for part in parts]
    running = [AtRunTime.of(projector.with_effects(part)) for part in parts]
    on, split = data if apart is None else apart, folds if by_folds else None
    if isinstance(full, TorqueDiagnosis):
        shown: Sequence[Trace] = full.traces
    else:
        shown = traces(on.samples, None, [Model.of(before)], [Model.of(corrected)], data.band)
    original = edited_of(asked.robot, to)
    with TemporaryDirectory() as drafts:
        whole = Path(drafts) / f"whole{SUFFIXES[to]}"
        engines = []
        for k, one in enumerate(fitted):
            path = whole.with_stem(f"fold_{k}")
            engines.append(engine_of(path, _in_file(one, path, original, to)))
        own = traces(on.samples, split, [Model.of(one) for one in fitted], engines, data.band)
        all_of_it = traces(on.samples, split, running[:1], running, data.band)
        torques = {
            "nominal": [x.before for x in shown],
            "full": [x.after for x in shown],
            "claim": [x.before for x in own],
            "engine": [x.after for x in own],
            "run_time": [x.after for x in all_of_it],
        }
        errors: dict[str, Any] = {
            name: _percent(shown, some, data.silent) for name, some in torques.items()
        }
        alone = "parts that were not fitted" if by_folds else "the log that was fitted"
        held_out = alone if apart is None else held_out_words(s.name for s in apart.segments)
        judged = Judged(unit="%", held_out=held_out, by=engines[0].name, band=data.band, **errors)
        _require_better(judged)
        inside = _in_file(robot, whole, original, to)
        forward = _forward(asked, full, inside, whole, on, data.silent)
        return structs.replace(judged, forward=forward)


def _require_better(judged: Judged) -> None:
    """Raise TorchidError for a file that is no better than the robot as given."""
    found, given = float(judged.engine.nanmean()), float(judged.nominal.nanmean())
    if found > NO_BETTER * given:
        raise TorchidError(
            "the corrected file is no better than the robot as given, so nothing was written.",
            got=f"{found:.1f} % of the joints' torque in {judged.by}",
            expected=f"less than {given:.1f} %, on {judged.held_out}",
        )


def _in_file(robot: Robot, path: Path, original: Robot | None, to: Target) -> Robot:
    """Write a robot's file, and the robot as it is in it."""
    written, file, _, _ = xml_of(robot, path, original, to)
    path.write_bytes(file.to_bytes())
    return written


def _percent(
    shown: Sequence[Trace], torques: Sequence[Float[Tensor, "T n"]], silent: Sequence[int]
) -> Tensor:
    """(n,) of torques (one a trajectory), while joints move; nan of joints without a signal."""
    left, whole = torch.zeros(2, shown[0].measured.shape[1], dtype=torch.float64)
    for trace, torque in zip(shown, torques, strict=True):
        counts = trace.counting.double()
        left = left + ((trace.measured - torque).square() * counts).sum(0)
        whole = whole + (trace.measured.square() * counts).sum(0)
    error = 100 * (left / whole.clamp(min=1e-300)).sqrt()
    error[list(silent)] = math.nan
    return error


def _forward(
    asked: CorrectionRequest,
    full: Robot | TorqueDiagnosis,
    robot: Robot,
    path: Path,
    on: Data,
    silent: Sequence[int],
) -> tuple[Forward, ...]:
    """Where the file of a robot, the robot as given and the diagnosed one are after each horizon,
    from the same starts; of joints whose torque says nothing, nothing is known."""
    starts = starts_of(on.segments, min(HORIZONS), STARTS, asked.settings.seed)
    if not len(starts.first):
        return ()
    windows = windows_of(on.segments, starts, max(HORIZONS))
    inside = None
    with suppress(TorchidError):  # it refuses a URDF that Pinocchio reads
        inside = InMujoco(path, robot).positions(windows)
    positions = [*(simulated(model, windows) for model in _models(asked, full)), inside]
    known = torch.ones(robot.n, dtype=torch.float64)
    known[list(silent)] = math.nan
    out = []
    for horizon in HORIZONS:
        count, errors = errors_after(horizon, positions, windows)
        out.append(Forward(horizon, count, *(None if x is None else x * known for x in errors)))
    return tuple(out)


def _warnings(
    projection: Projection, judged: Judged, nominal: Robot, silent: Sequence[int]
) -> tuple[str, ...]:
    """What a person should know before using the file."""
    said = []
    if silent:
        said.append(
            f"{joint_list(silent)}: the measured torque holds no signal, "
            "so the file keeps the friction of the robot as given, and nothing is judged there"
        )
    sensors = list(dict.fromkeys(k.effect for k in projection.kept if KINDS[k.effect].of_sensor))
    if sensors:
        said.append(
            f"of the sensor, not of the arm: {listed(map(effect_words, sensors))}; the file makes "
            "the torque that the log reads. For the arm's own correct the log first"
        )
    if not projection.believable:
        said.append(
            "masses within a factor 2 of the nominal ones, second moments of a fifth of theirs and "
            "centres of mass within 5 cm of the links would cost "
            f"{100 * projection.believable_price:.0f} % more torque error than any parameters "
            f"leave; the bodies in the file cost {100 * projection.price:.0f} %"
        )
    elif projection.price > PRICE:
        said.append(
            f"the bodies cost {100 * projection.price:.0f} % more torque error than any parameters "
            "leave, and no others would cost much less"
        )
    if projection.at_bounds:
        said.append(
            f"at a bound of what is believable: {listed(projection.at_bounds, most=4)}; the torque "
            "asks for more"
        )
    if any(one.starts and one.engine is None for one in judged.forward):
        said.append("MuJoCo refuses the file: it was not simulated forwards")
    if nominal.parameters is not None:
        odd = projection.odd_links(nominal.parameters)
        if odd:
            names = ", ".join(str(i + 1) for i in odd)
            why = "; a URDF has no field for the rotors, so links hold them"
            said.append(
                f"link {names}: a principal inertia more than {SPREAD:g} times as large, or as "
                f"small, as the nominal one{why if projection.to == 'urdf' else ''}"
            )
    said += judged.worse_than_claimed
    return tuple(said)
