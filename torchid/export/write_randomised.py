"""Ranges and draws in the words of simulators: MuJoCo (csv), mjlab, Isaac Lab, npz.

Read for the two packages: mjlab v1.6 (`mjlab.envs.mdp.dr`, since v1.2), and Isaac Lab's main branch
after 2.3 (`isaaclab.envs.mdp.randomize_joint_parameters` and `Articulation.write_joint_*_to_sim`).
"""

import csv
import io
import math
from collections.abc import Iterator, Sequence
from string import Template

from torchid import __version__
from torchid.export.record import RandomisationRecord, RangeRow
from torchid.robot.config_files import config_folder
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
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(("field", "parameter", "joint", "low", "high", "centre", "unit", "why"))
    for r in done.ranges:
        field = SERVOS.get(r.field, "at run time")
        writer.writerow((field, r.field, r.name, r.low, r.high, r.centre, r.unit, r.why))
    return out.getvalue()


def ranges_csv(done: RandomisationRecord, joints: Sequence[str]) -> str:
    """One row a range, then the torque that stays unexplained."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(("field", "name", "low", "high", "centre", "unit", "why"))
    for r in done.ranges:
        row = (MUJOCO.get(r.field, r.field), r.name, r.low, r.high, r.centre, r.unit, r.why)
        writer.writerow(row)
    for band in done.residual:
        joint = joints[band.joint]
        ends = (-HALF_95 * band.unexplained, HALF_95 * band.unexplained)
        writer.writerow(("qfrc_applied", joint, *ends, 0.0, "", band.why))
    return out.getvalue()


def _said(done: RandomisationRecord, package: str, version: str) -> list[str]:
    """The first lines of a file."""
    share = f"{100 * done.level:g} %"
    return [
        f'"""Ranges of \'{done.robot}\' that hold {share} of what its log leaves open.',
        "",
        f"Written by torchid {__version__} for {package}, of which {version} was read. Ranges of",
        "single fields take no notice of how fields vary together: the draws beside this file do.",
        '"""',
        "",
    ]


def _terms(done: RandomisationRecord, wanted: tuple[str, ...]) -> Iterator[tuple[str, RangeRow]]:
    """Ranges of fields with a Python name each."""
    for r in done.ranges:
        if r.field in wanted:
            joined = "".join(c if c.isalnum() else "_" for c in f"{r.field}_{r.name}")
            yield joined, r


def _pair(r: RangeRow) -> str:
    return f"({r.low!r}, {r.high!r})"


def mjlab(done: RandomisationRecord, stem: str, joints: Sequence[str]) -> str:
    """EVENTS: one term a range, to be merged into an environment's `events`."""
    lines = [
        *_said(done, "mjlab", "v1.6"),
        "from mjlab.envs.mdp import dr",
        "from mjlab.managers.event_manager import EventTermCfg",
        "from mjlab.managers.scene_entity_config import SceneEntityCfg",
        "",
        'ENTITY = "robot"  # name of the arm in the scene',
        f'DRAWS = "{stem}_draws.npz"  # correlated draws, all of them bodies',
        "",
        "EVENTS = {",
    ]
    for name, r in _terms(done, tuple(_MJLAB)):
        lines += [
            f"    # {r.why}",
            f"    {name!r}: EventTermCfg(",
            '        mode="startup",',
            f"        func=dr.{_MJLAB[r.field]},",
            "        params={",
            f'            "asset_cfg": SceneEntityCfg(ENTITY, joint_names=({r.name!r},)),',
            f'            "ranges": {_pair(r)},  # {r.unit}',
            '            "operation": "abs",',
            "        },",
            "    ),",
        ]
    for name, r in _terms(done, ("mass",)):
        # Mass and inertia together grow by exp(2 alpha), the centre of mass staying.
        ends = [0.5 * math.log(x / r.centre) for x in (r.low, r.high)]
        lines += [
            f"    # {r.why} Of the centre, {r.centre!r} kg.",
            f"    {name!r}: EventTermCfg(",
            '        mode="startup",',
            "        func=dr.pseudo_inertia,",
            "        params={",
            f'            "asset_cfg": SceneEntityCfg(ENTITY, body_names=({r.name!r},)),',
            f'            "alpha_range": ({ends[0]!r}, {ends[1]!r}),',
            "        },",
            "    ),",
        ]
    return "\n".join([*lines, "}", *_beside(done, joints), ""])


def isaaclab(done: RandomisationRecord, stem: str, joints: Sequence[str]) -> str:
    """Events: one term for all joints, which takes whole draws, and one a mass."""
    text = (config_folder("templates") / "randomiser_isaaclab.txt").read_text(encoding="utf-8")
    said = "\n".join(_said(done, "Isaac Lab", "the main branch after 2.3"))
    lines = [f"{said}\n{Template(text).substitute(stem=stem).rstrip()}"]
    for name, r in _terms(done, ("mass",)):
        lines += [
            f"    # {r.why}",
            f"    {name} = EventTermCfg(",
            "        func=mdp.randomize_rigid_body_mass,",
            '        mode="startup",',
            "        params={",
            f'            "asset_cfg": SceneEntityCfg("robot", body_names={r.name!r}),',
            f'            "mass_distribution_params": {_pair(r)},  # kg',
            '            "operation": "abs",',
            "        },",
            "    )",
        ]
    return "\n".join([*lines, *_beside(done, joints), ""])


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
