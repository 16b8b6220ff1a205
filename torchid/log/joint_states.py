"""From messages of joint states to columns: joints by name, in any order, split over messages.

Publishers differ: some list grippers with the arm, some send the arm in parts, some leave velocity
or effort empty or NaN, some forget the stamp.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from torchid.errors import LogError
from torchid.log.joint_names import in_robot_order

_SIGNALS = {"q": "position", "dq": "velocity", "tau": "effort"}


class JointState(NamedTuple):
    """One message: when it was received and stamped [ns], joints, and their numbers by signal
    (position, velocity, effort); empty arrays where it has none."""

    received: int
    stamp: int
    names: tuple[str, ...]
    signals: dict[str, np.ndarray]


@dataclass(frozen=True)
class JointColumns:
    """What the messages of one topic come to.

    Attributes:
        arrays: t (T,) [s from the first message], q and, where there are any, dq, tau (T, n);
            traj (T,) where time begins again; position, velocity, effort of every joint as
            `joint.position` etc., (T,).
        joints: names of the n joints, in the order of the columns.
        stamped: whether t is from the messages' stamps; the time of receipt otherwise.
        start: when t is 0, on the clock of t [ns].
        late: how much later than stamped a message is received, typically; 0 where t is the time
            of receipt [ns].
        warnings: one sentence each.
    """

    arrays: dict[str, np.ndarray]
    joints: tuple[str, ...]
    stamped: bool
    start: int
    late: int
    warnings: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Group:
    """Messages that list the same joints: time (T,) [ns], signals by name (T, k)."""

    names: tuple[str, ...]
    time: np.ndarray
    signals: dict[str, np.ndarray]


def joint_columns_of(
    messages: Iterable[JointState],
    robot_joints: Sequence[str],
    label: str,
    spare: Sequence[str] = (),
) -> JointColumns:
    """Columns of joint states, for the robot's joints, or for all that come together most.

    Args:
        messages: of one topic.
        robot_joints: names in the robot's order; empty where the robot is not known.
        label: of the topic, for the messages.
        spare: other joints that may be there (`Robot.spare`).

    Raises:
        LogError: no message with positions, or the joints are not the robot's.
    """
    warnings: list[str] = []
    listed = list(messages)
    stamps = [m.stamp for m in listed]
    stamped = bool(listed) and min(stamps) > 0 and max(stamps) > min(stamps)
    groups = _groups(listed, stamped, label, warnings)
    if robot_joints:
        everything = list(dict.fromkeys(name for group in groups for name in group.names))
        joints, notes = in_robot_order(everything, robot_joints, label, spare)
    else:
        largest = max(groups, key=lambda g: (len(g.names), len(g.time)))
        joints, notes = in_robot_order(largest.names, (), label)
        others = dict.fromkeys(n for g in groups for n in g.names if n not in joints)
        warnings += [f"{label}: left out: {', '.join(others)}"] if others else []
    used = _covering(groups, joints)
    partly = [g for g in groups if g not in used and set(g.names) & set(joints)]
    if partly:
        count = sum(len(g.time) for g in partly)
        warnings.append(f"{label}: {count} messages with some of the joints are left out.")
    whole = used[0] if len(used) == 1 else _joined(used, label, warnings)
    # Messages in the order of their stamps, repeated ones once; which run each belongs to.
    steps = np.diff(whole.time, prepend=whole.time[:1])
    # time that jumps back further begins another recording
    reset_s = 1.0
    runs = np.cumsum(steps < -reset_s * 1e9)
    order = np.lexsort((whole.time, runs))
    time, run = whole.time[order], runs[order]
    same = (np.diff(time) == 0) & (np.diff(run) == 0)
    again = np.concatenate([[False], same])
    if again.any():
        warnings.append(f"{label}: {int(again.sum())} messages repeat a time stamp: left out.")
    if (steps[steps > -reset_s * 1e9] < 0).any():
        warnings.append(f"{label}: messages are not in the order of their stamps: sorted.")
    whole, runs = _picked(whole, order[~again]), run[~again]
    arrays = _arrays(whole, joints, label, warnings)
    arrays["t"] = (whole.time - whole.time.min()) * 1e-9
    if runs.any():
        arrays["traj"] = runs
    late = int(np.median([m.received - m.stamp for m in listed])) if stamped else 0
    start = int(whole.time.min())
    return JointColumns(arrays, tuple(joints), stamped, start, late, (*notes, *warnings))


def _groups(
    messages: list[JointState], stamped: bool, label: str, warnings: list[str]
) -> list[_Group]:
    """Messages by the joints they list, without those that cannot be used."""
    if messages and not stamped:
        warnings.append(f"{label}: messages are not stamped; the time of receipt is taken.")
    byname: dict[tuple[str, ...], list[JointState]] = {}
    for message in messages:
        if len(message.names) == len(message.signals["position"]) > 0:
            # The message with its joints in the order of their names.
            order = sorted(range(len(message.names)), key=message.names.__getitem__)
            if order == list(range(len(order))):
                ordered = message
            else:
                names = tuple(message.names[k] for k in order)
                signals = {
                    s: values[order] if len(values) == len(order) else values
                    for s, values in message.signals.items()
                }
                ordered = message._replace(names=names, signals=signals)
            byname.setdefault(ordered.names, []).append(ordered)
    if not byname:
        raise LogError(
            f"{label} has no message with positions.",
            got=f"{len(messages)} messages",
            expected="a name and a position for every joint",
        )
    unusable = len(messages) - sum(len(group) for group in byname.values())
    if unusable:
        warnings.append(f"{label}: {unusable} messages without positions are left out.")
    return [_group(names, group, stamped, label, warnings) for names, group in byname.items()]


def _group(
    names: tuple[str, ...],
    messages: list[JointState],
    stamped: bool,
    label: str,
    warnings: list[str],
) -> _Group:
    """Messages that lack a signal that most have are left out; a signal that most lack is."""
    present: dict[str, list[bool]] = {}
    for signal in ("velocity", "effort"):
        there = [len(m.signals[signal]) == len(names) for m in messages]
        partial = sum(0 < len(m.signals[signal]) < len(names) for m in messages)
        if partial:
            warnings.append(
                f"{label}: {partial} messages have {signal} for some of their joints only, and do "
                "not say for which: taken for none."
            )
        if 2 * sum(there) >= len(there):
            present[signal] = there
        elif any(there):
            warnings.append(
                f"{label}: {signal} is in {sum(there)} of {len(there)} messages: left out."
            )
    keep = np.all([[True] * len(messages), *present.values()], axis=0)
    if not keep.any():
        # Half of the messages have one and half have the other: torque is what cannot be computed.
        warnings.append(f"{label}: no message has velocity and effort: velocity is left out.")
        del present["velocity"]
        keep = np.array(present["effort"])
    if not keep.all():
        warnings.append(
            f"{label}: {int((~keep).sum())} of {len(keep)} messages have no "
            f"{' or no '.join(present)}: left out."
        )
    kept = [m for m, k in zip(messages, keep, strict=True) if k]
    time = np.array([m.stamp if stamped else m.received for m in kept], dtype=np.int64)
    signals = {s: np.stack([m.signals[s] for m in kept]) for s in ("position", *present)}
    return _Group(names, time, signals)


def _covering(groups: Sequence[_Group], joints: Sequence[str]) -> list[_Group]:
    """The group that has all joints, or those that have them together; the longest first."""
    longest = sorted(groups, key=lambda g: -len(g.time))
    whole = [g for g in longest if set(joints) <= set(g.names)]
    if whole:
        return whole[:1]
    used, missing = [], set(joints)
    for group in longest:
        if missing & set(group.names):
            used.append(group)
            missing -= set(group.names)
    return used


def _joined(groups: Sequence[_Group], label: str, warnings: list[str]) -> _Group:
    """Joints that come in different messages, at the times of those that come most often."""
    ordered = [_picked(g, np.unique(g.time, return_index=True)[1]) for g in groups]
    first = max(g.time[0] for g in ordered)
    last = min(g.time[-1] for g in ordered)
    base = ordered[0].time[(ordered[0].time >= first) & (ordered[0].time <= last)]
    if len(base) < 2:
        raise LogError(f"{label}: the parts of the arm were not recorded at the same time.")
    if any(not np.isin(base, g.time).all() for g in ordered[1:]):
        parts = "; ".join(", ".join(g.names) for g in ordered)
        warnings.append(
            f"{label}: the joints come in separate messages ({parts}), interpolated to the times "
            "of the first."
        )
    shared = [s for s in ("position", "velocity", "effort") if all(s in g.signals for g in ordered)]
    names = [name for g in ordered for name in g.names]
    x = (base - first) * 1e-9
    signals = {
        s: np.stack(
            [np.interp(x, (g.time - first) * 1e-9, v) for g in ordered for v in g.signals[s].T], 1
        )
        for s in shared
    }
    return _Group(tuple(names), base, signals)


def _picked(group: _Group, rows: np.ndarray) -> _Group:
    signals = {s: v[rows] for s, v in group.signals.items()}
    return _Group(group.names, group.time[rows], signals)


def _arrays(
    group: _Group, joints: Sequence[str], label: str, warnings: list[str]
) -> dict[str, np.ndarray]:
    """Signals of the joints, and of every joint alone."""
    columns = [group.names.index(joint) for joint in joints]
    arrays: dict[str, np.ndarray] = {}
    for key, signal in _SIGNALS.items():
        if signal not in group.signals:
            continue
        values = group.signals[signal][:, columns]
        if key != "q" and np.isnan(values).all():
            warnings.append(f"{label}: {signal} is NaN throughout: left out.")
            continue
        arrays[key] = values
    for signal, values in group.signals.items():
        arrays |= {f"{name}.{signal}": values[:, k] for k, name in enumerate(group.names)}
    return arrays
