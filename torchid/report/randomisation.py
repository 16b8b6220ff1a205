"""How wide to randomise, for people."""

from collections.abc import Sequence

from torchid.export.randomise import Randomisation
from torchid.report.table import Shown, Table


def randomisation_shown(done: Randomisation, files: Sequence[str]) -> Shown:
    """What is shown of drawn robots, whose ranges these files hold."""
    return Shown(
        verdict=headline(done),
        parts=tables(done),
        warnings=done.warnings,
        last=f"written: {', '.join(files)}",
    )


def headline(done: Randomisation) -> str:
    """What was drawn, in one sentence."""
    others = sum(one.draws for one in done.explanations[1:])
    beside = f", {others} of them of explanations that the log cannot tell apart" if others else ""
    return (
        f"{len(done)} draws of '{done.robot.name}'{beside}; {len(done.ranges)} fields differ, and "
        f"{100 * done.level:g} % of the draws lie within each range."
    )


def tables(done: Randomisation) -> list[Table]:
    """Ranges with their reasons, and the torque that stays unexplained."""
    names = done.robot.joint_names
    return [
        Table(
            "ranges",
            ("field", "of", "low", "high", "unit", "why"),
            [
                (r.field, r.name, f"{r.low:.4g}", f"{r.high:.4g}", r.unit, r.why)
                for r in done.ranges
            ],
            words=("field", "of", "unit", "why"),
        ),
        Table(
            "torque that stays unexplained",
            ("joint", "low", "high", "why"),
            [(names[b.joint], f"{b.low:.3g}", f"{b.high:.3g}", b.why) for b in done.residual],
            words=("joint", "why"),
        ),
    ]
