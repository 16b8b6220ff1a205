"""What results of each kind say of their coefficients, and the models that they are."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import torch

from torchid.effects.base import Motion
from torchid.effects.registry import COLUMN_KINDS, KINDS, on_every_joint
from torchid.errors import TorchidError
from torchid.excitation.design import base_regressor
from torchid.feasibility.sets import read_other_effects, read_sets
from torchid.fleet.basis import common_basis, refuse_other_kinematics
from torchid.fleet.comparison import ComparedCause, State
from torchid.fleet.gap import effect_label
from torchid.fleet.torque import Model, described_model
from torchid.gap.record import GapRecord
from torchid.identification.model import model_torque
from torchid.identification.record import IdentificationRecord
from torchid.position.record import PositionFinding, PositionRecord
from torchid.results.cause import Cause
from torchid.results.record import robot_record
from torchid.results.words import count, listed, percent
from torchid.robot.inertia import InertialParameters, parameter_names, parameter_units
from torchid.robot.model import Robot
from torchid.typing import Bool, Float, Tensor


@dataclass(frozen=True, eq=False)
class Estimates:
    """What m results say of P coefficients, and the models that they are.

    Attributes:
        named: (P,) name, unit and, in a diagnosis, cause of each coefficient.
        values, std: (P, m); nan where a result has none.
        freedom: (m,) degrees of freedom of its standard deviations.
        about: (m,) words on each result.
        models: (m,) torques; none where they are not known.
        claims: (m,) variances of these; none where there are none.
        cutoff, reversal: of the filter under which they are compared along a log [Hz], and (n,)
            speed from which a joint's direction counts [rad/s; m/s].
        logs: (P,) of which values are logarithms, and their deviations, too; None of none.
        causes: of diagnoses, those that most name first.
        notes: sentences for the user.
    """

    named: Sequence[tuple[str, str, str]]
    values: Float[Tensor, "P m"]
    std: Float[Tensor, "P m"]
    freedom: Float[Tensor, " m"]
    about: Sequence[str]
    models: Sequence[Model] = ()
    claims: Sequence[Model] = ()
    cutoff: float | None = None
    reversal: Float[Tensor, " n"] | None = None
    logs: Bool[Tensor, " P"] | None = None
    causes: Sequence[ComparedCause] = ()
    notes: Sequence[str] = ()


def of_identifications(
    records: Mapping[str, IdentificationRecord], robot: Robot | None
) -> Estimates:
    """Estimates of identifications, in one basis.

    Args:
        records: by what to call them.
        robot: of which they are models, where it is known.

    Raises:
        TorchidError: of other kinematics, or of effects that are not the same columns in all.
    """
    shaped = [e.effect for r in records.values() for e in r.effects if e.places]
    if shaped:
        raise TorchidError(
            "a comparison takes identifications whose effects have no shapes, memory or load, and "
            "are on every joint.",
            got=", ".join(shaped),
            available=list(COLUMN_KINDS),
        )
    refuse_other_kinematics({label: r.model for label, r in records.items()})
    named, values, std = common_basis(records)
    notes = []
    every = dict.fromkeys(e for r in records.values() for e in r.settings.effects)
    for label, r in records.items():
        if missing := [e for e in every if e not in r.settings.effects]:
            notes.append(
                f"{label} was fitted without {', '.join(missing)}: what they explain may have gone "
                "into its other parameters"
            )
        if r.bounded:
            notes.append(f"{label}: fitted at the bound of physics, 0: {listed(r.bounded, most=5)}")
        if earlier := (r.sure or {}).get("sources", ())[:-1]:
            notes.append(
                f"{label} holds what was known before its log ({', '.join(earlier)}), and agrees "
                "with results of the same sessions for that"
            )
    notes += common_runs({label: r.fit.trajectories for label, r in records.items()})
    cutoffs = [r.cutoff for r in records.values()]
    if len(set(cutoffs)) > 1:
        notes.append("cut-offs differ: part of a difference may come from the filter")
    pairs = [_models(robot, r) for r in records.values()] if robot is not None else []
    return Estimates(
        [(*both, "") for both in named],
        values,
        std,
        torch.tensor([max(1.0, r.statistics.blocks - 1.0) for r in records.values()]).double(),
        ["no cut-off" if c is None else f"cut-off {c:g} Hz" for c in cutoffs],
        [model for model, _ in pairs],
        [claim for _, claim in pairs],
        min((c for c in cutoffs if c is not None), default=None),
        torch.stack([r.reversal for r in records.values()]).mean(0),
        notes=notes,
    )


def common_runs(given: Mapping[str, Sequence[str]]) -> list[str]:
    """Sentences on trajectories that more than one result was fitted on.

    Args:
        given: names of the trajectories of each result.
    """
    seen: dict[str, str] = {}
    return [
        f"{seen[name]} and {label} were both fitted on a trajectory called '{name}': "
        "if it is the same one, their errors are common and agreement says little"
        for label, names in given.items()
        for name in names
        if seen.setdefault(name, label) != label
    ]


def _models(robot: Robot, found: IdentificationRecord) -> tuple[Model, Model]:
    """Torque of an identification, and the variance of it that its covariance claims."""
    base, effects = found.base, on_every_joint(found.settings.effects, robot.n)

    def claimed(motion: Motion) -> Float[Tensor, "T n"]:
        rows = base_regressor(robot, base, motion, effects=effects)
        return ((rows @ found.covariance) * rows).sum(1).clamp(min=0).reshape(-1, robot.n)

    return partial(model_torque, robot, base, effects, found.values), claimed


def of_sets(files: Mapping[str, Path], robot: Robot) -> Estimates:
    """Of files of sets: the spread of a file's sets is how far a value is left open by it.

    Raises:
        TorchidError: files that do not fit the robot, or have different effects.
    """
    sets = [read_sets(path, robot) for path in files.values()]
    if any(s.effects != sets[0].effects for s in sets):
        raise TorchidError(
            "the sets have different effects.",
            got="; ".join(
                f"{label}: {', '.join(s.coefficient_names()) or 'none'}"
                for label, s in zip(files, sets, strict=True)
            ),
            expected="the same in all files",
        )
    models = []
    for s, path in zip(sets, files.values(), strict=True):
        mean = robot.with_parameters(InertialParameters(s.parameters.pi.mean(0)))
        own = iter(s.coefficients.mean(0).tolist())
        records = [effect.record(x) for effect, x in read_other_effects(path, robot)]
        records += [e.record([next(own) for _ in e.coefficients]) for e in s.effects]
        models.append(described_model(replace(mean, effects=tuple(records))))
    vectors = [s.vector.double() for s in sets]
    values = torch.stack([v.mean(0) for v in vectors], 1)
    std = torch.stack([v.std(0, correction=min(1, len(v) - 1)) for v in vectors], 1)
    names = [*parameter_names(robot.n_links), *sets[0].coefficient_names()]
    units = [*parameter_units(robot.n_links)]
    units += [c.unit for e in sets[0].effects for c in e.coefficients]
    # 1e-6: relative spread of the sets of a file below which they do not tell how sure a value is
    return Estimates(
        [(name, unit, "") for name, unit in zip(names, units, strict=True)],
        values,
        torch.where(std > 1e-6 * values.abs(), std, torch.nan),
        torch.tensor([max(1.0, len(s) - 1.0) for s in sets]).double(),
        [count(len(s), "set") for s in sets],
        models,
    )


def of_diagnoses(records: Mapping[str, GapRecord]) -> Estimates:
    """Of gap diagnoses: the coefficients of the causes that they name.

    Raises:
        TorchidError: of other kinematics.
    """
    refuse_other_kinematics({label: r.model for label, r in records.items()})
    own, named, sizes = list(records.values()), [], []
    causes = compared_causes(own)
    for cause, members in causes:
        place = max((_place(e) for e in members.values()), key=len)
        coefficients = dict.fromkeys(
            (e.effect, name, e.unit.get(name, ""))
            for e in members.values()
            for name in (*e.std, *e.shape)
        )
        for effect, name, unit in coefficients:
            size = torch.full((len(own), 2), torch.nan, dtype=torch.float64)
            for k, e in members.items():
                value = e.parameters.get(name)
                if e.effect == effect and isinstance(value, int | float):
                    size[k, 0], size[k, 1] = value, e.std.get(name) or torch.nan
            named.append((f"{name}{'_'.join(map(str, place))}", unit, cause.label))
            sizes.append(size)
    notes = []
    given = [{**robot_record(r.model), "name": ""} for r in own]
    if any(one != given[0] for one in given):
        notes.append(
            "the simulators as given differ: what is an effect of one gap may be part of the "
            "other's model"
        )
    if len({r.settings.effects for r in own}) > 1:
        notes.append("the diagnoses searched over different effects")
    robots = [r.corrected for r in own if r.corrected.parameters]
    closed = [
        "" if r.how_far.closed is None else f", {percent(r.how_far.closed)} closed" for r in own
    ]
    values, std = torch.stack(sizes).unbind(-1) if sizes else torch.empty(2, 0, len(own)).double()
    # 19: degrees of freedom of the fewest blocks that a diagnosis takes standard deviations from
    return Estimates(
        named,
        values,
        std,
        torch.full((len(own),), 19.0).double(),
        [f"{r.status.replace('_', ' ')}{said}" for r, said in zip(own, closed, strict=True)],
        [described_model(robot) for robot in robots] if len(robots) == len(own) else (),
        cutoff=min(r.band_hz for r in own),
        causes=[cause for cause, _ in causes],
        notes=notes,
    )


def compared_causes(
    own: Sequence[GapRecord | PositionRecord],
) -> list[tuple[ComparedCause, dict[int, Cause]]]:
    """Causes of diagnoses and, by the number of its diagnosis, what each is there; those that most
    name first."""
    causes, numbers = list[tuple[ComparedCause, dict[int, Cause]]](), range(len(own))
    for members in _causes([[*map(_as_cause, r.which)] for r in own]):
        place = max((_place(e) for e in members.values()), key=len)
        effects = [e for e, _ in Counter(e.effect for e in members.values()).most_common()]
        label = effect_label(" or ".join(effects), place)
        hidden = {
            k: e.smallest_detectable
            for k, r in enumerate(own)
            for e in r.not_testable
            if e.effect in effects and tuple(j + 1 for j in e.joints[:1]) == place
        }
        unseen: list[State] = ["not_testable" if k in hidden else "not_found" for k in numbers]
        states = tuple("named" if k in members else unseen[k] for k in numbers)
        smallest = tuple(None if k in members else hidden.get(k) for k in numbers)
        causes.append((ComparedCause(label=label, states=states, smallest=smallest), members))
    return sorted(causes, key=lambda pair: -pair[0].states.count("named"))


def _as_cause(entry: Cause | PositionFinding) -> Cause:
    return entry if isinstance(entry, Cause) else entry.cause


def _causes(entries: Sequence[Sequence[Cause]]) -> list[dict[int, Cause]]:
    """Entries that are one cause, by the number of their diagnosis, at most one of each: what most
    name first, then what cannot be told from it."""
    counts = Counter((e.effect, _place(e)) for own in entries for e in own)
    every = [(k, e) for k, own in enumerate(entries) for e in own]
    causes: list[dict[int, Cause]] = []
    for k, entry in sorted(every, key=lambda x: (-counts[x[1].effect, _place(x[1])], x[1].effect)):
        alike = (c for c in causes if k not in c and any(_same(entry, e) for e in c.values()))
        cause = next(alike, None)
        if cause is None:
            causes.append(cause := {})
        cause[k] = entry
    return causes


def _same(a: Cause, b: Cause) -> bool:
    """Whether two diagnoses may mean one cause."""
    one, two = _place(a), _place(b)
    if a.effect == b.effect:
        return one == two
    alike = a.effect in b.ambiguous_with or b.effect in a.ambiguous_with
    return alike and (one == two or not (one and two))


def _place(entry: Cause) -> tuple[int, ...]:
    """Joints from 1, and other places; none of the whole arm."""
    kind = KINDS.get(entry.effect)
    fields = ("joint",) if kind is None else kind.__dataclass_fields__
    if entry.common or "joint" not in fields:
        return ()
    numbers = [entry.parameters.get(name) for name in entry.places]
    return (
        *(j + 1 for j in entry.joints),
        *(int(n) for n in numbers if isinstance(n, int | float)),
    )
