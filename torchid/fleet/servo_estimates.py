"""What diagnoses of commands and positions say of their servos' numbers."""

from collections.abc import Mapping, Sequence

import msgspec
import torch
from msgspec import UNSET

from torchid.effects.servo import INDEX, PARAMETERS, PER_KP, TORQUES, as_share
from torchid.errors import TorchidError
from torchid.fleet.comparison import PositionErrors
from torchid.fleet.estimates import Estimates, common_runs, compared_causes
from torchid.log.model import Log
from torchid.position.model import ServoArm
from torchid.position.record import PositionRecord
from torchid.position.replay import accuracy
from torchid.results.words import listed, percent
from torchid.robot.model import Robot, error_unit, joint_list
from torchid.simulation.servo import Servos
from torchid.typing import Tensor

SURE = 1e6
"""Degrees of freedom of deviations that are wide enough for few motions already [1]."""


def of_positions(records: Mapping[str, PositionRecord]) -> Estimates:
    """Numbers of servos, on a logarithmic scale where they are searched so.

    Where the log of any diagnosis tells a joint's torques in their ratios alone, all are compared
    there as shares of its kp.

    Raises:
        TorchidError: of arms with other joints.
    """
    own = list(records.values())
    joints = [tuple(j.name for j in r.where.joints) for r in own]
    if len(set(joints)) > 1:
        each = (f"{x}: {', '.join(names)}" for x, names in zip(records, joints, strict=True))
        message, expected = "the diagnoses are of other arms.", "the same joints in all"
        raise TorchidError(message, got="; ".join(each), expected=expected)
    ratios = [j for j in range(len(joints[0])) if any(r.where.joints[j].ratio_only for r in own)]
    causes = compared_causes(own)
    named, sizes, logs = [], [], []
    for j in range(len(joints[0])):
        known = {name for r in own for name in _covariance(r, j)[0]}
        for p in PARAMETERS:
            share = j in ratios and p.name in TORQUES
            if p.name not in known or (share and p.name == "kp"):
                continue
            keys = {p.name, as_share(p.name)}
            of = [
                cause.label
                for cause, members in causes
                if any(j in e.joints and keys & e.parameters.keys() for e in members.values())
            ]
            title = as_share(p.name) if share else p.name
            named.append((f"{title} {j + 1}", PER_KP[p.unit] if share else p.unit, ", ".join(of)))
            sizes.append(torch.tensor([_number(r, j, p.name, share) for r in own]))
            logs.append(p.kind == "log")
    runs = {x: [m.motion for m in r.how_far.per_motion] for x, r in records.items()}
    notes = common_runs(runs)
    if ratios:
        words = "torques are compared as shares of kp, as a log tells their ratios alone"
        notes.append(f"{joint_list(ratios)}: {words}")
    if older := [label for label, r in records.items() if r.known is UNSET]:
        notes.append(f"{listed(older)} of an older version: no standard deviations of servos in it")
    if len({r.servos.repeated_command_ends_profile for r in own}) > 1:
        notes.append("a repeated command ends the profile of the servos in some alone")
    values, std = torch.stack(sizes).unbind(-1) if sizes else torch.empty(2, 0, len(own)).double()
    about = [
        f"{r.status.replace('_', ' ')}, {percent(r.how_far.closed)} closed, "
        f"{r.how_far.answered.whole_mrad:.3g} mrad left"
        for r in own
    ]
    return Estimates(
        named, values, std, torch.full((len(own),), SURE).double(), about, notes=notes,
        logs=torch.tensor(logs, dtype=torch.bool), causes=[cause for cause, _ in causes],
    )  # fmt: skip


def _covariance(record: PositionRecord, joint: int) -> tuple[Sequence[str], Tensor]:
    """Names and covariance of what the log told of a joint's servo."""
    for one in () if record.known is UNSET else record.known:
        if one.joint == joint:
            return one.names, one.covariance
    return (), torch.empty(0, 0)


def _number(record: PositionRecord, joint: int, name: str, share: bool) -> tuple[float, float]:
    """A number of a joint's servo, or its share of kp, and its deviation, both of the logarithm
    where it is searched so; nan where the answer has none."""
    names, covariance = _covariance(record, joint)
    p, row = PARAMETERS[INDEX[name]], record.servos.joints[joint]
    value = torch.tensor(row.get(name, p.neutral), dtype=torch.float64)
    if name not in names and float(value) == p.neutral:
        return torch.nan, torch.nan
    kp = row["kp"] if share else 1.0
    value = (value / kp).log() if p.kind == "log" else value / kp
    if name not in names:
        return float(value), torch.nan
    # How it answers to each of the known numbers, of which kp is a logarithm.
    along = covariance.new_zeros(len(names))
    along[names.index(name)] = 1.0 if p.kind == "log" else 1.0 / kp
    if share and "kp" in names:
        along[names.index("kp")] = -1.0 if p.kind == "log" else -float(value)
    return float(value), float((along @ covariance @ along).clamp(min=0).sqrt())


def errors_on(records: Mapping[str, PositionRecord], robot: Robot, log: Log) -> PositionErrors:
    """How far the servos of each diagnosis go from where the arm went along a log.

    Raises:
        LogError, TorchidError: as `torchid.replay`.
    """
    errors = []
    for label, r in records.items():
        servos = Servos.from_record(msgspec.to_builtins(r.servos), robot.n, label)
        moving = torch.tensor([not j.never_moves for j in r.where.joints])
        errors.append(accuracy(ServoArm(robot, servos, r.log_scale), log, moving))
    whole, windows = torch.stack([torch.stack([e.whole, e.windows]) for e in errors], 1)
    source = f"the motion of {', '.join(log.names)}"
    return PositionErrors(source, error_unit(robot), whole, windows)
