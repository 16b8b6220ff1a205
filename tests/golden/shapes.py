"""The shape of a JSON document: which keys it has, and of what type their values are."""

from typing import Any

TYPES = {
    bool: "boolean", int: "number", float: "number", str: "string", type(None): "null",
    list: "array", dict: "object",
}  # fmt: skip

FREE = (
    *(
        f"{causes}[].{name}"
        for causes in ("which", "causes", "suspects", "small")
        for name in ("parameters", "file", "std", "unit", "probabilities")
    ),
    "model.effects[]", "corrected.effects[]",
    "]effects[].parameters", "]effects[].std", "sets[].effects[]", "sets[].degrees",
    "sets[].margins", "links[].degrees", "phi_min_without", "named[].shapes", "named[].std",
    "named[].units", "named[].values", "confusion", "confusion.*", "confusion_outside",
    "confusion_outside.*", "code", "by_cause", "by_cause.*", "verdicts", "detection",
)  # fmt: skip
"""Ends of the paths of objects whose keys are data (effects, coefficients, reasons, causes): any
key, and only the types of their values count. A leading `]` stands for the document itself."""


def shape(document: Any) -> dict[str, str]:
    """{path: types}: `where.joints[].gap_rms` is that of every entry, `which[].std.*` of any key.

    An entry `[]` or `*` stands for all of a list or a free object; a path's types are all that
    occur, so that a value which is null in some entries is `null|number`.
    """
    found: dict[str, set[str]] = {}
    _walk(document, "", found)
    return {path: "|".join(sorted(types)) for path, types in sorted(found.items())}


def _walk(value: Any, path: str, found: dict[str, set[str]]) -> None:
    found.setdefault(path, set()).add(TYPES[type(value)])
    if isinstance(value, list):
        for entry in value:
            _walk(entry, f"{path}[]", found)
    elif isinstance(value, dict):
        free = f"]{path}".endswith(FREE)
        for key, below in value.items():
            _walk(below, f"{path}.{'*' if free else key}".lstrip("."), found)


def losses(stored: dict[str, str], now: dict[str, str]) -> list[str]:
    """What a program that reads the stored shape would miss: a key that is gone, a type that it
    has not met. New keys are no loss, nor are paths below a list or object that is empty now."""
    said = []
    for path, types in stored.items():
        if path not in now:
            if not _empty_above(path, now):
                said.append(f"{path}: gone")
        elif new := set(now[path].split("|")) - set(types.split("|")):
            said.append(f"{path}: was {types}, is also {'|'.join(sorted(new))}")
    return said


def _empty_above(path: str, now: dict[str, str]) -> bool:
    """Whether a list or free object above has no entry now, so that nothing is said of these."""
    for k in range(len(path)):
        for end, above in (("[]", path[:k]), (".*", path[:k])):
            if path.startswith(end, k) and above in now and f"{above}{end}" not in now:
                return True
    return False
