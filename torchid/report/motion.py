"""A planned motion for people: what it asks of the drives, how near it comes, and what it adds."""

import math
from functools import partial

from torchid.excitation.clearance import FAR_ROOM, Clearance, Nearest
from torchid.excitation.design import Excitation, InformedDesign
from torchid.excitation.torque import TorqueUse
from torchid.next_motion.planned import Planned, not_checked
from torchid.next_motion.separating_motion import Separation
from torchid.next_motion.separation import DECISIVE, Rival, name_pairs, other_means
from torchid.report.log import trajectory_figure
from torchid.report.table import Report, Table, plain_table
from torchid.results.words import count, effect_words, listed, number_list, percent, short
from torchid.robot.model import Robot, joint_unit


def report_of_design(planned: Planned) -> Report:
    """What the design of motions gained."""
    hardly = [HARDLY_BETTER] if any(design.hardly for design in planned.designs) else []
    match planned.designs:
        case [InformedDesign() as one]:
            return Report(
                verdict=informed_verdict(one), parts=[informed_table(one)], warnings=hardly
            )
        case [Separation() as one]:
            verdict, table = separation_verdict(one, one.kind), separation_table(one, one.kind)
            return Report(verdict=verdict, parts=[table], warnings=[*one.notes, *hardly])
    said = [
        f"trajectory {k}: condition number {design.start_condition:.0f} (median random start) "
        f"-> {design.condition_after:.0f}"
        for k, design in enumerate(planned.designs, start=1)
        if isinstance(design, Excitation)
    ]
    return Report(parts=said, warnings=hardly)


def report_of_motion(planned: Planned) -> Report:
    """What motions ask of the drives, or that it is not known, and how near they come; and a figure
    of each."""
    robot, use, log = planned.robot, planned.use, planned.log
    parts: list[Table | str] = [] if use is None else [torque_table(robot, use)]
    reason = not_checked(robot) if use is None else None
    drives = [reason] if reason else [] if use is None else friction_warning(use)
    if planned.clearance is not None and planned.nearest is not None:
        parts += [nearest_words(planned.clearance, planned.nearest), *planned.clearance.notes]
    title = f"{robot.name}: {planned.kind} trajectory"
    return Report(
        parts=parts,
        warnings=(*drives, *planned.unknown, *log.warnings),
        figures={
            f"trajectory_{k}": partial(trajectory_figure, robot, part, f"{title} {k}")
            for k, part in enumerate(log.trajectories(), start=1)
        },
    )


def torque_table(robot: Robot, use: TorqueUse) -> Table:
    """The largest torque of every joint beside its limits."""
    columns = zip(use.largest.tolist(), use.limits.tolist(), use.share.tolist(), strict=True)
    rows = [
        {"joint": f"{j + 1} [{joint_unit(robot, j)}]", "torque": size}
        | ({"limits": ends, "share": percent(share)} if math.isfinite(ends[1] - ends[0]) else {})
        for j, (size, ends, share) in enumerate(columns)
    ]
    return plain_table(f"largest torque, by the {use.source}", rows)


HARDLY_BETTER = "a plain exciting motion, driven a tenth longer, tells as much as the designed one."


def friction_warning(use: TorqueUse) -> tuple[str, ...]:
    """A warning that the forecast of torque has no friction in it; nothing where it has some."""
    if not use.frictionless:
        return ()
    every = len(use.frictionless) == len(use.largest)
    of = "" if every else f" of joint {number_list(use.frictionless)}"
    return (
        f"the forecast torque has no friction in it{of}: the drives need more. Friction is known "
        "from the robot's `effects`, a URDF's <dynamics>, or --for an identification.",
    )


def nearest_words(clearance: Clearance, nearest: Nearest) -> str:
    """How near the motions come, in one sentence."""
    if math.isinf(nearest.spare):
        return f"room: nothing comes nearer than {1000 * (clearance.clearance + FAR_ROOM):.0f} mm."
    return (
        f"room: {nearest.second} comes nearest to {nearest.first}, {1000 * nearest.distance:.0f} "
        f"mm after {nearest.time:.1f} s (at least {1000 * (nearest.distance - nearest.spare):.0f} "
        "mm are kept at every instant)."
    )


MOST_ROWS = 20


def informed_verdict(d: InformedDesign) -> str:
    """What the motion does for the least known parameters."""
    count, every = int(d.targets.sum()), len(d.prior.base)
    which = f"the {count} worst of {every} parameters" if count < every else "all parameters"
    said = (
        f"Drive this motion{', or a plain one' * d.hardly}: it cuts the uncertainty of {which} to "
        f"{percent(d.shrinks(d.after))} (a plain one so long: {percent(d.shrinks(d.with_plain))})."
    )
    unknown = int((~d.prior.known).sum())
    if unknown:
        said += f" {unknown} that the log did not determine at all are among them."
    return said


def informed_table(d: InformedDesign) -> Table:
    """Standard deviations before, after a plain motion, after this one; the worst known first."""
    relative = d.before / d.prior.values.abs().clamp(min=1e-300)
    order = [k for k in relative.argsort(descending=True).tolist() if bool(d.targets[k])]
    rows = []
    for k in order:
        value, now = f"{float(d.prior.values[k]):.3g}", f"{float(d.before[k]):.2g}"
        if not math.isfinite(float(d.before[k])):
            value, now = "-", "unknown"
        name = f"{short(d.prior.base.names[k], 40)} [{d.prior.base.units[k]}]"
        rows.append((name, value, now, f"{float(d.with_plain[k]):.2g}", f"{float(d.after[k]):.2g}"))
    columns = ("parameter", "value", "now", "after a plain motion", "after this motion")
    return Table("predicted standard deviations", columns, rows, "p", most=MOST_ROWS)


def separation_verdict(s: Separation, kind: str) -> str:
    """What the motion separates, or shows."""
    of_all = len(s.rivals)
    after, without = (sum(t.reached >= 1 for t in x) for x in (s.after, s.with_plain))
    drive = "Drive this motion, or a plain one" if s.hardly else "Drive this motion"
    plain = f"a plain exciting motion of the same length {without}"
    if kind == "not_testable":
        seen = [r for r, apart in zip(s.rivals, s.after, strict=True) if apart.reached >= 1]
        names = listed(name_pairs(seen).replace("_", " ").split("; "), most=3)
        out = (
            f"{drive if seen else 'Drive another motion'}: of {count(of_all, 'cause')} that the "
            f"log could not have shown this one shows {after}, where a cause is a tenth of the "
            f"joint's torque{': ' if seen else ''}{names}; {plain}."
        )
    else:
        names = listed(dict.fromkeys(effect_words(r.truth.effect.name) for r in s.rivals))
        rival, apart = min(zip(s.rivals, s.after, strict=True), key=lambda pair: pair[1].reached)
        hardest = _place(rival) + (f" against {rival.name}" if rival.name else "")
        times = math.ceil(DECISIVE / max(apart.difference, 1e-9))
        out = (
            f"{drive}: it is expected to settle {after} of {count(of_all, 'question')} about "
            f"{names}, {plain}."
        )
        if apart.reached < 1 and (times == 1 or times >= 20):
            out += f" It will hardly settle {hardest}."
        elif apart.reached < 1:
            out += f" The hardest, {hardest}, takes {times} drives."
    both = {(r.name, r.truth.effect.name) for r in s.rivals}
    nested = [r for r in s.hopeless if (r.truth.effect.name, r.name) in both]
    for one, other in dict.fromkeys((r.truth.effect.name, r.name) for r in nested):
        out += (
            f" {one} is a special case of {other}: the simpler one stands where nothing of the "
            "rest is seen."
        )
    lost = [r for r in s.hopeless if r not in nested]
    if lost:
        out += (
            f" No motion tried settles {name_pairs(lost)}. What would: "
            f"{other_means(r.truth.effect.name for r in lost)}."
        )
    return out


def separation_table(s: Separation, kind: str) -> Table:
    """Every pair, both ways, the hardest first; * where it decides."""
    testing = kind == "not_testable"
    rows = []
    pairs = zip(s.rivals, s.with_plain, s.after, strict=True)
    for r, *both in sorted(pairs, key=lambda pair: pair[2].reached):
        second = f"{max(r.truth.values, key=abs):.3g}" if testing else r.name
        differences = (f"{t.difference:.3g} {'*' if t.reached >= 1 else ' '}" for t in both)
        rows.append((_place(r), second, *differences))
    headings = ("effect", "size") if testing else ("if it is", "and not")
    title = "expected difference of the squared residuals, in noise units; * decides"
    columns = (*headings, "plain motion", "this motion")
    return Table(title, columns, rows, "pp", most=MOST_ROWS)


def _place(r: Rival) -> str:
    effect = r.truth.effect
    if len(r.truth.effects) > 1:
        return f"{effect.name}, every joint"
    return effect.name + (f", joint {number_list(effect.joints)}" if effect.joints else "")
