"""What was exported of a robot, what a corrected file of it is worth, how wide to randomise it, and
its joints as text for a simulator's file."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from xml.sax.saxutils import quoteattr

import torch
from msgspec import UNSET

from torchid.effects.registry import KINDS
from torchid.export.correct_positions import WINDOW_S
from torchid.export.correction import Correction
from torchid.export.export import Export
from torchid.export.mjcf import attributes_of
from torchid.export.projection import Kept
from torchid.export.randomisation import Randomisation
from torchid.feasibility.margins import inertia_eigenvalues
from torchid.report.table import Report, Table, joint_table, plain_table, table_of
from torchid.results.words import count, effect_words, joints_words, listed, percent
from torchid.robot.model import JointType, Robot, joint_unit, torque_unit
from torchid.simulation.servo import Servos
from torchid.simulators.joint_dynamics import JointDynamics, Target, split
from torchid.simulators.nearest_fields import NearestFields


def report_of_export(done: Export) -> Report:
    """All that there is to see of an export."""
    first, *others = map(str, done.files)
    beside = f" (and {', '.join(others)})" if others else ""
    title = "reloaded and compared with the result's own model"
    return Report(
        parts=[table_of(title, done.comparisons), *effect_lines(done)],
        warnings=done.warnings,
        last=f"written: {done.dynamics.title} of '{done.dynamics.robot.name}': {first}{beside}",
    )


def effect_lines(done: Export) -> list[str]:
    """Where each effect went, one sentence a place."""
    sidecar = done.files[-1].name if len(done.files) > 1 else "the sidecar"
    places = ((f"in the {done.format} file", done.in_file), (f"in {sidecar}", done.beside))
    if done.files[0].suffix == ".py":
        own = "left to the simulator's own fields"
        places = (("added at run time", done.in_file), (own, done.beside))
    return [f"{count(len(words), 'effect')} {place}" for place, words in places if words]


def _given(nominal: Robot) -> str:
    """What a file is compared with."""
    return "robot as given" if nominal.parameters is not None else "base parameters alone"


def report_of_correction(done: Correction) -> Report:
    """All that there is to see of a correction."""
    judged = done.judged
    mine, full, before = (float(x.nanmean()) for x in (judged.engine, judged.full, judged.nominal))
    if judged.unit == "%":
        parts, of, given = correction_tables(done), "% of the torque", f"the {_given(done.nominal)}"
    else:
        parts, of, given = servo_tables(done), judged.unit, "the bare commands"
    less = f" ({percent(1 - mine / before)} less)" if before > 0 else ""
    warnings = [*done.warnings, *(w for export in done.exports for w in export.warnings)]
    return Report(
        verdict=f"{done.files[0].name} errs {mine:.1f} {of} in {judged.by}, {given} {before:.1f}"
        f"{less}, on {judged.held_out}. All effects leave {full:.1f}.",
        parts=parts,
        warnings=dict.fromkeys(warnings),
        last=f"written: {', '.join(map(str, done.files))}",
    )


def error_table(done: Correction, title: str, given: str, beside: str) -> Table:
    """Errors joint by joint of a robot as it was `given`, of all effects, of the file alone, and
    with what stands `beside` it."""
    judged = done.judged
    rows = [
        (given, judged.nominal),
        ("all effects", judged.full),
        ("the file alone, predicted", judged.claim),
        (f"the file alone, {judged.by}", judged.engine),
        (f"with {beside} at run time", judged.run_time),
    ]
    errors = [(name, [*v.tolist(), float(v.nanmean())]) for name, v in rows]
    return joint_table(title, errors, ".1f", last=("mean",))


def servo_tables(done: Correction) -> list[Table]:
    """Errors of servos in a simulator's file, and what it does not say of them."""
    again = f"position error, begun anew every {WINDOW_S:g} s [{done.judged.unit}]"
    title, record = "of the servos, without a field in the file", done.record
    assert record.servos_without is not UNSET
    return [
        error_table(done, again, "the position is the command", "set-points"),
        table_of(title, record.servos_without),
    ]


def correction_tables(done: Correction) -> list[Table]:
    """Errors, motion, effects without a field, and bodies."""
    judged, nominal = done.judged, done.nominal
    # Positions in degrees and millimetres.
    turns = (kind is JointType.REVOLUTE for kind in nominal.joint_types)
    units = torch.tensor([math.degrees(1) if turn else 1e3 for turn in turns], dtype=torch.float64)
    motion = [
        (f"after {one.horizon:g} s, {name}", away * units)
        for one in judged.forward
        for name, away in (
            (_given(nominal), one.nominal), ("all effects", one.full), ("the file", one.engine),
        )
        if away is not None
    ]  # fmt: skip
    projection = done.projection
    assert projection is not None
    kept = {"kept": [_kept(one, projection.to) for one in projection.kept]}
    band = f"error of the torque, while a joint moves, below {judged.band:.3g} Hz [%]"
    after = "error of the simulated motion, given the measured torque [deg; mm]"
    lost = (
        f"effects without a field, which stay beside the file (lost: RMS, {torque_unit(nominal)})"
    )
    return [
        error_table(done, band, _given(nominal), "effects"),
        joint_table(after, motion, ".2g"),
        table_of(lost, projection.kept, beside=kept),
        _bodies(projection.robot, nominal),
    ]


def _kept(one: Kept, to: str) -> str:
    """`57 % by friction 1.43 of joint 3; 0.76 of 1.7 lost`."""
    lost = f"{one.lost:.2g} of {one.made:.2g} lost"
    if not one.share > 0:
        return f"nothing; {lost}"
    words = f"{100 * one.share:.0f} % by "
    if one.joint is None or one.value is None:
        words += "the links' bodies"
    else:
        field = "friction" if to == "urdf" and one.field == "frictionloss" else one.field
        words += f"{field} {one.value:.3g} of joint {one.joint + 1}"
    return f"{words}; {lost}"


def _bodies(robot: Robot, nominal: Robot) -> Table:
    """Masses, how far centres of mass moved, and inertias, over the nominal ones."""
    new, old, links = robot.require_parameters("a correction"), nominal.parameters, []
    for i, name in enumerate(nominal.link_names):
        link: dict[str, object] = {"link": i + 1, "name": name, "mass [kg]": float(new.mass[i])}
        if old is not None and float(old.mass[i]) > 0:
            ratios = inertia_eigenvalues(new)[i] / inertia_eigenvalues(old)[i].clamp(min=1e-12)
            link["over nominal"] = float(new.mass[i] / old.mass[i])
            link["centre moved [mm]"] = 1e3 * float((new.com[i] - old.com[i]).norm())
            link["inertias over nominal"] = [float(ratios.min()), float(ratios.max())]
        links.append(link)
    return plain_table("bodies in the file", links)


def report_of_randomisation(done: Randomisation, files: Sequence[str]) -> Report:
    """What is shown of draws, whose ranges these files hold."""
    servos = isinstance(done.draws, Servos)
    of, what = ("the servos of ", "numbers") if servos else ("", "fields")
    return Report(
        verdict=f"{len(done)} draws of {of}'{done.name}'; {len(done.ranges)} {what} "
        f"differ, and {100 * done.level:g} % of the draws lie within each range.",
        parts=[
            table_of("ranges", done.ranges, "field name low high unit why"),
            table_of("torque that stays unexplained", done.residual),
        ],
        warnings=done.warnings,
        last=f"written: {', '.join(files)}",
    )


def simulator_block(robot: Robot, nearest: Sequence[NearestFields] = ()) -> str:
    """Attributes of the joints for MJCF and URDF. Of an effect without a field the nearest fields
    are in them, and a comment says what is lost; what none comes near is named there, too.
    What is a sensor's fault is in no field: the log is to be corrected.

    Args:
        robot: corrected.
        nearest: of its effects without a field.

    >>> from torchid import load_robot
    >>> print(simulator_block(load_robot("3r_friction")).splitlines()[1].split(" damping")[0])
    <joint name="joint_1"
    """
    lines = []
    formats: tuple[Target, ...] = ("mjcf", "urdf")
    for to in formats:
        mjcf = to == "mjcf"
        held, rest = split(robot, to)
        joints, own = list(held), [row for row in nearest if row.to == to]
        for row in own:
            joints[row.joint] = replace(joints[row.joint], **row.fields)
        angles = ', of a file with <compiler angle="radian"/>' if mjcf else ""
        lines.append(f"<!-- {to.upper()}: into the joint of the same name{angles} -->")
        for name, one in zip(robot.joint_names, joints, strict=True):
            said = _attributes(one, to).items()
            text = "".join(f' {key}="{value}"' for key, value in said if value != "0" or not mjcf)
            text = f"{text}/>" if mjcf else f"> <dynamics{text}/> </joint>"
            lines.append(f"<joint name={quoteattr(name)}{text}")
        lines += [f"<!-- {_nearest(row, held[row.joint], robot)} -->" for row in own]
        # A double hyphen would end a comment.
        written = {name for row in own for name in row.effects}
        left = dict.fromkeys(
            effect.name for effect, _ in rest if effect.name not in written and not effect.of_sensor
        )
        lines += [f"<!-- no field for: {listed(list(left)).replace('--', '-')} -->"] if left else []
    sensors: dict[str, list[int]] = {}
    for effect, _ in rest:  # no format has a field for one
        if effect.of_sensor:
            sensors.setdefault(effect.name, []).extend(effect.joints)
    lines += [
        f"<!-- correct the log, not the simulator: {effect_words(name)} of {joints_words(joints)}: "
        f"{KINDS[name].remedy.replace('--', '-')} -->"
        for name, joints in sensors.items()
    ]
    return "\n".join(lines)


def _attributes(joint: JointDynamics, to: Target, digits: int = 6) -> dict[str, str]:
    """Attributes of a joint, as the format calls them."""
    urdf = {"damping": (joint.damping,), "friction": (joint.friction,)}
    given: Mapping[str, tuple[float, ...]] = attributes_of(joint) if to == "mjcf" else urdf
    return {key: " ".join(f"{x + 0.0:.{digits}g}" for x in values) for key, values in given.items()}


def _nearest(row: NearestFields, held: JointDynamics, robot: Robot) -> str:
    """What the fields say of a joint's effects without one, and what is lost."""
    effects = [f"{effect_words(name)} ({KINDS[name].signature})" for name in row.effects]
    what = f"{joints_words([row.joint])}, {listed(effects)}:"
    made = f"{row.made:.2g} {joint_unit(robot, row.joint)} RMS"
    if not row.fields:
        return f"{what} no field comes near; all {made} are lost"
    before = _attributes(held, row.to, 3)
    after = _attributes(replace(held, **row.fields), row.to, 3)
    said = [
        f"{key} {value} instead of {before.get(key, 0)}"
        for key, value in after.items()
        if value != before.get(key, "0")
    ]
    return f"{what} the nearest is {listed(said)}; {row.lost:.2g} of {made} are lost"
