"""Internal wrenches of given sets: tables and figures."""

from collections.abc import Sequence
from functools import partial

from torchid.report.panels import Figure, Figures
from torchid.report.table import Report, Table, cells, joint_numbers
from torchid_study.equal_torque.given_sets import GivenSets
from torchid_study.report.equal_torque import by_class, class_table, error_by_degree
from torchid_study.wrenches.classes import class_of


def report_of_given_sets(found: GivenSets, warnings: Sequence[str]) -> Report:
    """All that there is to see of given sets."""
    said, last = tables(found), headline(found)
    return Report(parts=said, warnings=warnings, last=last, figures=figures(found))


def tables(found: GivenSets) -> list[Table]:
    """Set by set, then by class and by reason where there are enough of them."""
    rho = found.comparison.correlation
    value = str(rho.rho) if rho.sets else "-"
    title = f"largest force error by class and reason [N]; Spearman's rho with the degree {value}"
    several = len(found.sets) > 1
    return [set_table(found), *([class_table(found.comparison, title)] if several else [])]


def unequal_torque(found: GivenSets) -> list[str]:
    """Says when the sets do not have the reference's torque: then the forces differ for that."""
    worst = found.torque_relative.amax(-1)
    # 0.01: relative difference of a joint's torque above which sets do not count as having equal
    # torque
    count = int((worst > 0.01).sum())
    if count == 0:
        return []
    return [
        f"{count} of {len(found.sets)} sets do not have the torque of the reference "
        f"'{found.reference.ids[0]}' (up to {100 * float(worst.max()):.2g} % off at one joint): "
        "these differences are not what equal torque leaves open. --reference ID compares with "
        "one of them"
    ]


def headline(found: GivenSets) -> str:
    """One sentence: how far the torques and the forces are apart."""
    worst = found.errors.force_rms.amax(-1)
    near, far = int(worst.argmin()), int(worst.argmax())
    ids = found.sets.ids
    extremes = f"{float(worst[near]):.3g} N ({ids[near]})"
    if len(ids) > 1:
        extremes = f"between {extremes} and {float(worst[far]):.3g} N ({ids[far]})"
    return (
        f"Against {_reference(found)}, on {found.motion.q.shape[0]} instants: the largest "
        f"force error over the joints is {extremes} RMS; torques differ by at most "
        f"{100 * float(found.torque_relative.max()):.2g} % of a joint's own."
    )


def set_table(found: GivenSets) -> Table:
    """Reasons, degree and force error per joint; the sets with the largest errors if many."""
    own, worst = found.errors, found.errors.force_rms.amax(-1)
    shown = list(range(len(found.sets)))
    title = f"force error against {_reference(found)} [N], RMS over the motion"
    most_rows = 40
    if len(shown) > most_rows:
        shown = sorted(worst.argsort(descending=True)[:most_rows].tolist())
        title += f" (the {most_rows} of {len(worst)} sets with the largest)"
    rows = [
        (
            found.sets.ids[k], f"{float(found.checked.degree[k]):.2g}",
            f"{100 * float(found.torque_relative[k].max()):.2g}",
            f"{float(own.moment_rms[k].max()):.3g}",
            *cells(own.force_rms[k]),
            " ".join(found.checked.reasons(k)) or "feasible",
        )
        for k in shown
    ]  # fmt: skip
    moment = f"{float(own.reference_moment_rms.max()):.3g}"
    rows.append(("itself", "", "", moment, *cells(own.reference_force_rms), ""))
    joints = joint_numbers(found.robot.n)
    columns = ("set", "degree", "torque [%]", "moment [N m]", *joints, "reasons")
    return Table(title, columns, rows, "l".ljust(len(columns) - 1, "r") + "p")


def figures(found: GivenSets) -> Figures:
    """What draws the figure, by the name of its file."""
    return {"force_by_degree": partial(degree_figure, found)}


def degree_figure(found: GivenSets) -> Figure:
    """Largest force error against the degree; ids beside the marks where there are few."""
    classes = [class_of(found.checked.reasons(k)) for k in range(len(found.sets))]
    # 15: sets whose marks have names
    return error_by_degree(
        f"{found.robot.name}: degree and force error",
        found.checked.degree.numpy(),
        found.errors.force_rms.amax(-1).numpy(),
        by_class(classes),
        enumerate(found.sets.ids) if len(classes) <= 15 else (),
    )


def _reference(found: GivenSets) -> str:
    name = found.reference.ids[0]
    return f"the nominal parameters of {name}" if name == found.robot.name else name
