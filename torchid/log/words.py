"""What names of columns and topics say: quantity, unit, measured or commanded."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from torchid.log.units import unit_factor
from torchid.yaml_data import parsed_yaml

NAMES: dict[str, Any] = parsed_yaml(
    Path(__file__).with_name("names.yaml").read_text(encoding="utf-8")
)
"""What names say, as names.yaml has it."""
_COMMANDED: str = NAMES["commanded"]
_MEASURED, _PLAIN, _UNWANTED, _SOURCE = map(
    re.compile,
    (
        NAMES["measured"],
        NAMES["plain"],
        f"{_COMMANDED}|{NAMES['unwanted']}",
        f"{NAMES['measured']}|{_COMMANDED}|error",
    ),
)
_UNITS: dict[str, dict[str, str]] = NAMES["units"]
_BRACKETED = re.compile(r"\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))\s*$")


def words_of(name: str) -> list[str]:
    """The words of a name, in small letters, without numbers."""
    apart = re.sub(r"([a-z])([A-Z])", r"\1 \2", re.sub(r"\d+", " ", name))
    return [word.lower() for word in re.split(r"[^A-Za-z]+", apart) if word]


def quantity_of(words: Iterable[str]) -> str | None:
    """The key (`torchid.log.mapping.KEYS`) of what the words name."""
    words = list(words)
    return next(
        (
            key
            for key, pattern in NAMES["quantities"].items()
            if any(re.fullmatch(pattern, word) for word in words)
        ),
        None,
    )


def looks_measured(words: Sequence[str]) -> float:
    """How much a name looks like a measurement; below zero: like a command, or no joint's."""
    wanted = sum(bool(_MEASURED.fullmatch(word)) for word in words)
    wanted += any(_PLAIN.fullmatch(word) for word in words)
    return wanted - 2 * sum(bool(_UNWANTED.fullmatch(word)) for word in words) - 0.01 * len(words)


def is_commanded(words: Iterable[str]) -> bool:
    """Whether words say that something was commanded."""
    return any(re.fullmatch(_COMMANDED, word) for word in words)


def source_words(name: str) -> tuple[str, ...]:
    """The words of a name that tell measurements from commands."""
    return tuple(word for word in words_of(name) if _SOURCE.fullmatch(word))


def unit_in(name: str, key: str) -> str | None:
    """The unit that a name says its column is in: in brackets, or as a word; None for none."""
    _, inside = without_unit(name)
    if inside and unit_factor(key, inside) is not None:
        return inside
    said = [word.lower() for word in re.split(r"[^A-Za-z]+", name)]
    return next((_UNITS[key][word] for word in said if word in _UNITS[key]), None)


def without_unit(name: str) -> tuple[str, str]:
    """A name without what stands in brackets at its end, and that."""
    match = _BRACKETED.search(name)
    if match is None or match.start() == 0:
        return name, ""
    return name[: match.start()], (match[1] or match[2] or "").strip()


def is_unit_word(word: str) -> bool:
    """Whether a part of a name is a unit: deg, nm."""
    return any(word.lower() in units for units in _UNITS.values())
