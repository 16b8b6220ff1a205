"""A corrected file for people: what it is worth, what it keeps of each effect, its bodies."""

import math

from torchid.export.correct import Correction
from torchid.export.projection import Kept
from torchid.feasibility.margins import inertia_eigenvalues
from torchid.report.table import Shown, Table, cells, joint_numbers
from torchid.robot.model import JointType, Robot
from torchid.typing import Tensor


def _given(nominal: Robot) -> str:
    """What a file is compared with."""
    return "robot as given" if nominal.parameters is not None else "base parameters alone"


def shown(done: Correction) -> Shown:
    """All that there is to see of a correction."""
    warnings = [*done.warnings, *(w for export in done.exports for w in export.warnings)]
    return Shown(
        verdict=headline(done),
        parts=tables(done),
        warnings=dict.fromkeys(warnings),
        last=f"written: {', '.join(map(str, done.files))}",
    )


def headline(done: Correction) -> str:
    """What the file is worth, in one sentence."""
    judged = done.judged
    means = [float(x.nanmean()) for x in (judged.engine, judged.full, judged.nominal)]
    return (
        f"On {judged.held_out} {judged.by} with the corrected file misses {means[0]:.1f} % of the "
        f"joints' torque on average; with all effects it would be {means[1]:.1f} %, and with the "
        f"{_given(done.nominal)} it is {means[2]:.0f} %."
    )


def tables(done: Correction) -> list[Table]:
    """Errors, motion, effects without a field, and bodies."""
    judged, nominal, n = done.judged, done.nominal, done.nominal.n
    joints = joint_numbers(n)
    rows = [
        (_given(nominal), judged.nominal),
        ("all effects", judged.full),
        ("the file alone, claimed", judged.claim),
        (f"the file alone, {judged.by}", judged.engine),
        ("with effects at run time", judged.run_time),
    ]
    out = [
        Table(
            f"error of the torque, while a joint moves, below {judged.band:.3g} Hz [%]",
            ("", *joints, "mean"),
            [(name, *cells([*v.tolist(), float(v.nanmean())], ".1f")) for name, v in rows],
            words=("",),
        )
    ]
    motion = []
    turns = [kind is JointType.REVOLUTE for kind in nominal.joint_types]
    for one in judged.forward:
        kinds = [
            (_given(nominal), one.nominal),
            ("all effects", one.full),
            ("the file", one.engine),
        ]
        motion += [
            (f"{one.horizon:g} s", name, *_away(v, turns)) for name, v in kinds if v is not None
        ]
    if motion:
        title = "simulated motion, given the measured torque: error after a while [deg; mm]"
        out.append(Table(title, ("after", "model", *joints), motion, words=("model",)))
    if done.projection.kept:
        out.append(
            Table(
                "effects without a field, which stay beside the file",
                ("effect", "joints", "kept"),
                [_kept(one, done.projection.to) for one in done.projection.kept],
                words=("effect", "kept"),
            )
        )
    return [*out, _bodies(done.projection.robot, nominal)]


def _away(error: Tensor, turns: list[bool]) -> list[str]:
    """Positions in degrees and millimetres."""
    pairs = zip(error.tolist(), turns, strict=True)
    return [
        "-" if math.isnan(x) else f"{math.degrees(x) if turn else 1e3 * x:.2g}" for x, turn in pairs
    ]


def _kept(one: Kept, to: str) -> tuple[str, str, str]:
    joints = ", ".join(str(j + 1) for j in one.joints) or "the arm"
    words = f"{100 * one.share:.0f} % by "
    if one.joint is None or one.value is None:
        words += "the links' bodies"
    else:
        field = "friction" if to == "urdf" and one.field == "frictionloss" else one.field
        words += f"{field} {one.value:.3g} of joint {one.joint + 1}"
    return one.effect.name.replace("_", " "), joints, words


def _bodies(robot: Robot, nominal: Robot) -> Table:
    """Masses, how far centres of mass moved, and inertias, over the nominal ones."""
    new = robot.require_parameters("a correction")
    old = nominal.parameters
    rows = []
    for i, name in enumerate(nominal.link_names):
        cells = ["-", "-", "-"]
        if old is not None and float(old.mass[i]) > 0:
            moved = float((new.com[i] - old.com[i]).norm())
            ratios = inertia_eigenvalues(new)[i] / inertia_eigenvalues(old)[i].clamp(min=1e-12)
            low, high = float(ratios.min()), float(ratios.max())
            cells = [
                f"{float(new.mass[i] / old.mass[i]):.2f}",
                f"{1e3 * moved:.0f}",
                f"{low:.2f} - {high:.2f}",
            ]
        rows.append((str(i + 1), name, f"{float(new.mass[i]):.3g}", *cells))
    columns = (
        "", "link", "mass [kg]", "over nominal", "centre moved [mm]", "inertias over nominal"
    )  # fmt: skip
    return Table("bodies in the file", columns, rows, words=("link",))
