"""Results of one kind side by side: each is a unit of a fleet, of one session.

results -> estimates of the same coefficients, with their standard deviations -> random effects
results -> models -> torque on a common motion
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from msgspec import UNSET, UnsetType

from torchid.errors import TorchidError
from torchid.fleet.comparison import (
    ComparedParameter,
    Comparison,
    Kind,
    PositionErrors,
    Verdict,
)
from torchid.fleet.estimates import Estimates, of_diagnoses, of_identifications, of_sets
from torchid.fleet.servo_estimates import errors_on, of_positions
from torchid.fleet.torque import common_motion, torque_spread
from torchid.identification.result import Identification
from torchid.inputs import LogLike, RobotLike, as_log, as_robot
from torchid.log.model import Log
from torchid.results.answer import Diagnosis
from torchid.results.files import read
from torchid.robot.library import named_robot
from torchid.robot.model import Robot
from torchid.robot.tree import Choice
from torchid.statistics.multiple import benjamini_hochberg
from torchid.statistics.random_effects import Sessions, heterogeneity, intervals, means, spreads

KINDS: dict[str, Kind] = {
    "torchid.identification/1": "identifications",
    "torchid.gap/2": "gap diagnoses",
    "torchid.position_gap/1": "position diagnoses",
    "torchid.parameter_sets/1": "parameter sets",
}


@dataclass(frozen=True)
class Given:
    """A result that is compared.

    Attributes:
        label: short name, unique among the results compared.
        path: of its file; the label, where there is none.
        record: what it holds.
    """

    label: str
    path: Path
    record: Any

    @property
    def kind(self) -> Kind:
        """What kind of result it is."""
        return KINDS[self.record.schema]


def compare_results(
    results: Sequence[str | Path | Identification | Diagnosis],
    *,
    robot: RobotLike | None = None,
    on: LogLike | None = None,
    seed: int = 0,
) -> Comparison:
    """Which coefficients agree between results, which differ and by what spread, which are never
    determined; how far apart the torques are.

    Args:
        results: two or more: identifications or diagnoses, or files of them (identification.json,
            gap.json) or of parameter sets (sets.json); all of one kind.
        robot: for the torque, where files do not record it.
        on: a log along whose motion the torques are compared (random motion if None), or, of
            diagnoses of positions, the positions.
        seed: of random motion.

    Raises:
        TorchidError: fewer than two, of different kinds or kinematics, files that hold no results,
            or a log but no robot.

    >>> import torchid
    >>> robot = torchid.load_robot("3r")
    >>> motion = torchid.excite(robot, duration=10.0, restarts=1, iterations=0).log()
    >>> settings = torchid.Settings(effects=(), cutoff=10.0)
    >>> runs = [torchid.identify(robot, torchid.simulate(robot, motion, seed=k), settings=settings)
    ...         for k in (1, 2)]
    >>> found = compare_results(runs)
    >>> found.labels, len(found.having("differ"))
    (('result 1', 'result 2'), 0)
    """
    robot = None if robot is None else as_robot(robot)
    given = read_results(results)
    arm = robot or common_robot(given)
    return compared(given, arm, on=None if on is None else as_log(on, arm), seed=seed)


def read_results(given: Sequence[str | Path | Identification | Diagnosis]) -> list[Given]:
    """Results of one kind, files or objects, in the order given.

    Raises:
        TorchidError: fewer than two, files that are no results, or of different kinds.
    """
    if len(given) < 2:
        raise TorchidError(
            "a comparison needs two results or more.", got=", ".join(map(str, given)) or None
        )
    paths = [Path(one) for one in given if isinstance(one, str | Path)]
    whole = [p.resolve() for p in paths]
    if len(set(whole)) < len(whole):
        raise TorchidError("a result is given twice.", got=Counter(paths).most_common(1)[0][0])
    # The shortest ends of the paths that tell them apart; files that a command named itself are
    # called by their folder.
    parts = [(*p.parent.parts, p.stem) for p in whole]
    if len(paths) > 1 and len({p.stem for p in paths}) == 1:
        parts = [p[:-1] for p in parts]
    lengths = range(1, 1 + max(map(len, parts), default=0))
    ends = (["/".join(p[-k:]) for p in parts] for k in lengths)
    labels = iter(next((e for e in ends if len(set(e)) == len(e)), map(str, paths)))
    hint = "of an extraction, the file of its sets: sets.json"
    results = []
    for k, one in enumerate(given, start=1):
        if isinstance(one, str | Path):
            found = read(one, tuple(KINDS), "a result that can be compared", hint)
            results.append(Given(next(labels), Path(one), found))
        else:
            results.append(Given(f"result {k}", Path(f"result {k}"), one.record))
    if len({r.kind for r in results}) > 1:
        raise TorchidError(
            "only results of the same kind can be compared.",
            got=", ".join(f"{r.path} ({r.kind})" for r in results),
            expected="all of one kind",
        )
    return results


def common_robot(results: Sequence[Given], choice: Choice | None = None) -> Robot | None:
    """The robot that results record or name; of identifications and diagnoses None where none
    records it.

    Args:
        results: of one kind.
        choice: of the part of a named URDF or MJCF: in place of the recorded one.

    Raises:
        TorchidError: files of sets that name different robots, or one that is not where it was.
    """
    if results[0].kind == "position diagnoses":
        return None
    if results[0].kind != "parameter sets":
        return next((r.record.model for r in results if r.record.model is not None), None)
    names = list(dict.fromkeys(str(r.record.robot) for r in results))
    if len(names) > 1:
        raise TorchidError("the sets are of different robots.", got=", ".join(names))
    return named_robot(results[0].path, results[0].record.named, choice)


def compared(
    results: Sequence[Given], robot: Robot | None, *, on: Log | None = None, seed: int = 0
) -> Comparison:
    """As `compare_results`, of results that were read."""
    kind = results[0].kind
    if robot is None and (on is not None or kind == "parameter sets"):
        what = "a replay" if kind == "position diagnoses" else "torque"
        raise TorchidError(f"{what} needs the robot.", expected="`robot=...`")
    positions: PositionErrors | UnsetType = UNSET
    if kind == "position diagnoses":
        records = {r.label: r.record for r in results}
        found = of_positions(records)
        if robot is not None and on is not None:
            positions = errors_on(records, robot, on)
    elif kind == "identifications":
        found = of_identifications({r.label: r.record for r in results}, robot)
    elif kind == "parameter sets" and robot is not None:
        found = of_sets({r.label: r.path for r in results}, robot)
    else:
        found = of_diagnoses({r.label: r.record for r in results})
    torque, notes = None, list(found.notes)
    if robot is not None and found.models:
        motion = common_motion(robot, on, seed, found.cutoff, found.reversal)
        torque = torque_spread(found.models, motion, found.claims)
    elif kind != "position diagnoses":
        notes.append(
            "no torque: the models were not recorded; `robot=...` names the robot of "
            "identifications, and torchid gap records a corrected model"
        )
    arm = "" if robot is None else robot.name
    return Comparison(
        robot=" and ".join(dict.fromkeys(r.record.robot or arm for r in results)),
        kind=kind,
        labels=tuple(r.label for r in results),
        about=tuple(found.about),
        parameters=_random_effects(found),
        causes=tuple(found.causes),
        torque=torque,
        positions=positions,
        notes=tuple(notes),
    )


def _random_effects(found: Estimates) -> tuple[ComparedParameter, ...]:
    """The spread of every coefficient over the results, and whether they differ; of what is given
    as logarithms, judged there and told as values."""
    if not found.named:
        return ()
    logs = torch.zeros(len(found.named), dtype=torch.bool) if found.logs is None else found.logs
    size = torch.where(logs[:, None], 1.0, found.values.abs())
    # 1e-9: standard deviation that a value has at least, as a share of the largest
    least = 1e-9 * size.nan_to_num().amax(1, keepdim=True).clamp(min=1e-100)
    std = torch.maximum(found.std, least)
    data = Sessions(found.values, std.square(), torch.arange(std.shape[1]))
    p = heterogeneity(data, found.freedom)
    tested = p.isfinite()
    p[tested] = benjamini_hochberg(p[tested])
    # 0.5: relative standard deviation from which a value cannot be told from zero
    unknown = ((std > 0.5 * size) | ~data.counts).all(1)
    between, daily = spreads(data)
    ends, _ = intervals(data, between, daily)
    population = means(data, between, daily)
    # Deviations of logarithms are shares of the values.
    own = torch.where(logs[:, None], found.values.exp(), found.values)
    centre = torch.where(logs, population.centre.exp(), population.centre)
    factor = torch.where(logs, centre, 1.0)
    own_std = found.std * torch.where(logs[:, None], own, 1.0)
    out = []
    for k, (name, unit, cause) in enumerate(found.named):
        verdict: Verdict = "never_determined" if bool(unknown[k]) else "agree"
        # 0.05: share of false ones among the coefficients that are said to differ
        if not (tested[k] and p[k] >= 0.05):
            verdict = "differ" if tested[k] else "not_compared"
        out.append(
            ComparedParameter(
                name=name,
                unit=unit,
                cause=cause,
                verdict=verdict,
                own=own[k],
                own_std=own_std[k],
                mean=float(centre[k]),
                std=float(factor[k] * population.centre_variance[k].sqrt()),
                between=float(factor[k] * between[k]) if tested[k] else math.nan,
                between_ci95=tuple((factor[k] * ends[k]).tolist()),
                p=float(p[k]),
            )
        )
    return tuple(out)
