"""Classes of parameter sets by the reasons why they are infeasible."""

from collections.abc import Collection, Iterable, Mapping

from torchid.feasibility.margins import kinds

FEASIBLE = "feasible"
MIXED = "mixed"
KINDS: Mapping[str, str] = {
    "inertia": "inertia only",
    "com": "CoM only",
    "mass": "mass only",
    "total_mass": "total mass only",
}
"""Class of the sets all of whose reasons are of one kind; a reason is `kind_what` or `kind`."""


def class_of(reasons: Collection[str]) -> str:
    """Class of a set with these reasons: feasible without any, `... only` when all are of one kind
    (inertia_3 and inertia_5, say), mixed otherwise."""
    found = kinds(tuple(reasons))
    if len(found) != 1:
        return MIXED if found else FEASIBLE
    (kind,) = found
    return KINDS.get(kind, f"{kind} only")


def ordered_classes(names: Iterable[str]) -> list[str]:
    """The different classes among the names: feasible first, mixed last."""
    order = [FEASIBLE, *KINDS.values()]
    last = len(order)
    return sorted(
        set(names),
        key=lambda n: (order.index(n) if n in order else last + (n == MIXED), n),
    )
