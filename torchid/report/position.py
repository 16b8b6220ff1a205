"""A diagnosis of commands and positions for people: the verdict, and tables."""

import math

from torchid.position.diagnosis import PositionDiagnosis, Size
from torchid.report.table import Table


def position_verdict(result: PositionDiagnosis) -> str:
    """How far, and by what, in two sentences."""
    plain, answered = float(result.plain_servo.whole.mean()), float(result.answered.whole.mean())
    names = list(dict.fromkeys(f.effect for f in result.findings))
    said = (
        f"Whole motions are foretold to {answered:.1f} mrad (mean of the joints, held out), "
        f"a plain servo reaches {plain:.1f}, the command alone "
        f"{float(result.commanded.whole.mean()):.1f}."
    )
    if not names:
        return f"{said} Nothing beside a plain servo is needed."
    return f"{said} What closes it: {', '.join(names)}."


def position_tables(result: PositionDiagnosis) -> list[Table]:
    """Where, which and how far."""
    joints = [
        (
            str(j + 1),
            name,
            *(
                f"{float(x[j]):.1f}"
                for x in (
                    result.commanded.whole, result.plain_servo.whole, result.answered.whole,
                    result.plain_servo.windows, result.answered.windows,
                )
            ),
            f"{float(result.gains[0][j]):.1f}" + (" (ratio)" if result.ratio_only[j] else ""),
        )
        for j, name in enumerate(result.data.robot.joint_names)
    ]  # fmt: skip
    where = Table(
        "Position error of motions left out [mrad]",
        ("joint", "name", "command", "plain", "answered", "plain 2 s", "answered 2 s", "kp"),
        joints,
        names=("name",),
        note="kp [N m/rad]; (ratio): without a load on the joint its torques are known up to one "
        "factor",
    )
    regimes = [
        (name, *(f"{float(b):.1f} -> {float(a):.1f}" for b, a in zip(*both, strict=True)))
        for name, both in result.regimes.items()
    ]
    when = Table(
        "By regime, plain -> answered [mrad]",
        ("regime", *(f"joint {j + 1}" for j in range(result.servos.n))),
        regimes,
        names=("regime",),
    )
    findings = [
        (
            f.effect,
            "all" if f.joint is None else str(f.joint),
            ", ".join(_size(s) for s in f.sizes),
            f"{f.error_without:.1f} -> {f.error_with:.1f}",
            ", ".join(f.ambiguous_with) or "-",
        )
        for f in result.findings
    ]
    which = Table(
        "What lies between command and position",
        ("effect", "joint", "size (95 %)", "without -> with [mrad]", "or"),
        findings,
        names=("effect",),
        words=("size (95 %)", "or"),
        note="error in windows of 2 s when all else is fitted without the effect, and with it",
    )
    return [where, when, *([which] if findings else [])]


def _size(size: Size) -> str:
    unit = "" if size.unit == "1" else f" {size.unit}"
    low, high = size.interval
    if math.isnan(low):
        return f"{size.name} {size.value:.3g}{unit}"
    return f"{size.name} {size.value:.3g} [{low:.3g}, {high:.3g}]{unit}"
