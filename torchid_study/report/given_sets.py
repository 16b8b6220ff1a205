"""Internal wrenches of given sets: tables and figures."""

from collections.abc import Sequence
from functools import partial

from torchid.report.panels import Figure, Figures
from torchid.report.table import Report, Table, cells, joint_numbers
from torchid_study.equal_torque.given_sets import GivenSets
from torchid_study.report.equal_torque import by_class, class_table, error_by_degree
from torchid_study.wrenches.classes import class_of


def report_of_given_sets(given: GivenSets, warnings: Sequence[str]) -> Report:
    """All that there is to see of given sets."""
    said, last = tables(given), headline(given)
    return Report(parts=said, warnings=warnings, last=last, figures=figures(given))


def tables(given: GivenSets) -> list[Table]:
    """Set by set, then by class and by reason where there are enough of them."""
    rho = given.comparison.correlation
    value = str(rho.rho) if rho.sets else "-"
    title = f"largest force error by class and reason [N]; Spearman's rho with the degree {value}"
    several = len(given.sets) > 1
    return [set_table(given), *([class_table(given.comparison, title)] if several else [])]


def unequal_torque(given: GivenSets) -> list[str]:
    """Says when the sets do not have the reference's torque: then the forces differ for that."""
    worst = given.torque_relative.amax(-1)
    # 0.01: relative difference of a joint's torque above which sets do not count as having equal
    # torque
    count = int((worst > 0.01).sum())
    if count == 0:
        return []
    return [
        f"{count} of {len(given.sets)} sets do not have the torque of the reference "
        f"'{given.reference.ids[0]}' (up to {100 * float(worst.max()):.2g} % off at one joint): "
        "these differences are not what equal torque leaves open. --reference ID compares with "
        "one of them"
    ]


def headline(given: GivenSets) -> str:
    """One sentence: how far the torques and the forces are apart."""
    worst = given.errors.force_rms.amax(-1)
    near, far = int(worst.argmin()), int(worst.argmax())
    ids = given.sets.ids
    extremes = f"{float(worst[near]):.3g} N ({ids[near]})"
    if len(ids) > 1:
        extremes = f"between {extremes} and {float(worst[far]):.3g} N ({ids[far]})"
    return (
        f"Against {_reference(given)}, on {given.motion.q.shape[0]} instants: the largest "
        f"force error over the joints is {extremes} RMS; torques differ by at most "
        f"{100 * float(given.torque_relative.max()):.2g} % of a joint's own."
    )


def set_table(given: GivenSets) -> Table:
    """Reasons, degree and force error per joint; the sets with the largest errors if many."""
    own, worst = given.errors, given.errors.force_rms.amax(-1)
    shown = list(range(len(given.sets)))
    title = f"force error against {_reference(given)} [N], RMS over the motion"
    most_rows = 40
    if len(shown) > most_rows:
        shown = sorted(worst.argsort(descending=True)[:most_rows].tolist())
        title += f" (the {most_rows} of {len(worst)} sets with the largest)"
    rows = [
        (
            given.sets.ids[k], f"{float(given.checked.degree[k]):.2g}",
            f"{100 * float(given.torque_relative[k].max()):.2g}",
            f"{float(own.moment_rms[k].max()):.3g}",
            *cells(own.force_rms[k]),
            " ".join(given.checked.reasons(k)) or "feasible",
        )
        for k in shown
    ]  # fmt: skip
    moment = f"{float(own.reference_moment_rms.max()):.3g}"
    rows.append(("itself", "", "", moment, *cells(own.reference_force_rms), ""))
    joints = joint_numbers(given.robot.n)
    columns = ("set", "degree", "torque [%]", "moment [N m]", *joints, "reasons")
    return Table(title, columns, rows, "l".ljust(len(columns) - 1, "r") + "p")


def figures(given: GivenSets) -> Figures:
    """What draws the figure, by the name of its file."""
    return {"force_by_degree": partial(degree_figure, given)}


def degree_figure(given: GivenSets) -> Figure:
    """Largest force error against the degree; ids beside the marks where there are few."""
    classes = [class_of(given.checked.reasons(k)) for k in range(len(given.sets))]
    # 15: sets whose marks have names
    return error_by_degree(
        f"{given.robot.name}: degree and force error",
        given.checked.degree.numpy(),
        given.errors.force_rms.amax(-1).numpy(),
        by_class(classes),
        enumerate(given.sets.ids) if len(classes) <= 15 else (),
    )


def _reference(given: GivenSets) -> str:
    name = given.reference.ids[0]
    return f"the nominal parameters of {name}" if name == given.robot.name else name
