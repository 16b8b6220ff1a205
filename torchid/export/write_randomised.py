"""Ranges and draws in the words of simulators: MuJoCo (csv), mjlab, Isaac Lab, npz.

Read for the two packages: mjlab v1.6 (`mjlab.envs.mdp.dr`, since v1.2), and Isaac Lab's main branch
after 2.3 (`isaaclab.envs.mdp.randomize_joint_parameters` and `Articulation.write_joint_*_to_sim`).
"""

import csv
import io
import math
from collections.abc import Iterable, Sequence

from torchid import __version__
from torchid.export.record import RandomisationRecord, RangeRow
from torchid.robot.config_files import filled_template
from torchid.statistics.proportion import HALF_95

MUJOCO = {
    "damping": "dof_damping",
    "friction": "dof_frictionloss",
    "armature": "dof_armature",
    "stiffness": "jnt_stiffness",
    "offset": "qfrc_spring at q = 0",
    "mass": "body_mass",
    "com_x": "body_ipos[0]",
    "com_y": "body_ipos[1]",
    "com_z": "body_ipos[2]",
}
"""Fields of mjModel."""

SERVOS = {
    "damping": "dof_damping", "coulomb": "dof_frictionloss", "armature": "dof_armature",
    "kp": "actuator_gainprm[0] / scale, -actuator_biasprm[1]", "kd": "-actuator_biasprm[2]",
    "offset": "actuator_biasprm[0]", "clip": "actuator_forcerange about the offset",
    "delay": "actuator_delay", "lag": "actuator_dynprm[0]", "stop_low": "jnt_range[0]",
    "stop_high": "jnt_range[1]",
}  # fmt: skip
"""Fields of mjModel of what an MJCF says of servos."""

_MJLAB = {
    "damping": "joint_damping",
    "friction": "joint_friction",
    "armature": "joint_armature",
    "stiffness": "joint_stiffness",
}


def servo_csv(done: RandomisationRecord) -> str:
    """One row a range of a servo's number."""
    rows = ((SERVOS.get(r.field, "at run time"), r.field, *_row(r)) for r in done.ranges)
    return _csv("field parameter joint low high centre unit why", rows)


def ranges_csv(done: RandomisationRecord, joints: Sequence[str]) -> str:
    """One row a range, then the torque that stays unexplained."""
    rows = [(MUJOCO.get(r.field, r.field), *_row(r)) for r in done.ranges]
    for band in done.residual:
        half = HALF_95 * band.unexplained
        rows.append(("qfrc_applied", joints[band.joint], -half, half, 0.0, "", band.why))
    return _csv("field name low high centre unit why", rows)


def _row(r: RangeRow) -> tuple[str, float, float, float, str, str]:
    return r.name, r.low, r.high, r.centre, r.unit, r.why


def _csv(columns: str, rows: Iterable[Sequence[object]]) -> str:
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows([columns.split(), *rows])
    return out.getvalue()


def _head(done: RandomisationRecord, package: str, stem: str) -> str:
    """The first lines of a file."""
    share = f"{100 * done.level:g}"
    words = {"robot": done.robot, "share": share, "version": __version__, "stem": stem}
    return filled_template(f"randomiser_{package}.txt", **words).rstrip()


def _event(template: str, r: RangeRow, **own: object) -> str:
    """One term, of a range of a joint's or a link's."""
    term = "".join(c if c.isalnum() else "_" for c in f"{r.field}_{r.name}")
    words = {"name": repr(r.name), "low": r.low, "high": r.high, "unit": r.unit, "why": r.why}
    return filled_template(template, term=term, **words, **own).rstrip()


def mjlab(done: RandomisationRecord, stem: str, joints: Sequence[str]) -> str:
    """EVENTS: one term a range, to be merged into an environment's `events`."""
    events = [
        _event("joint_event_mjlab.txt", r, function=_MJLAB[r.field])
        for r in done.ranges
        if r.field in _MJLAB
    ]
    for r in (r for r in done.ranges if r.field == "mass"):
        # Mass and inertia together grow by exp(2 alpha), the centre of mass staying.
        least, most = (0.5 * math.log(x / r.centre) for x in (r.low, r.high))
        own = {"least": least, "most": most, "centre": r.centre}
        events.append(_event("mass_event_mjlab.txt", r, **own))
    return "\n".join([_head(done, "mjlab", stem), *events, "}", *_beside(done, joints), ""])


def isaaclab(done: RandomisationRecord, stem: str, joints: Sequence[str]) -> str:
    """Events: one term for all joints, which takes whole draws, and one a mass."""
    masses = [_event("mass_event_isaaclab.txt", r) for r in done.ranges if r.field == "mass"]
    head = _head(done, "isaaclab", stem)
    return "\n".join([head, *masses, *_beside(done, joints), ""])


def _beside(done: RandomisationRecord, joints: Sequence[str]) -> list[str]:
    """What no event sets, as comments: fields of other simulators, effects, unexplained torque."""
    written = (*_MJLAB, "mass")
    lines = [
        f"#   {r.field} {r.name}: {r.low:.6g} to {r.high:.6g} {r.unit}"
        for r in done.ranges
        if r.field not in written
    ]
    lines += [
        f"#   torque of {joints[b.joint]}: +-{HALF_95 * b.unexplained:.3g}, "
        f"lasting {b.correlation:.2g} s, stays unexplained"
        for b in done.residual
    ]
    return ["", "# Without an event here:", *lines] if lines else []
