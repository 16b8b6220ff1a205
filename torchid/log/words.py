"""What names of columns and topics say: quantity, unit, measured or commanded."""

import re
from collections.abc import Iterable, Sequence

from torchid.log.units import unit_factor

# Words in the names of what is measured; the first kind that fits is taken.
_QUANTITIES = {
    "t": r"t|ts|time|timestamp|stamp|times|secs?|seconds|clock|tout|elapsed|time(s|ms|us|ns|sec)",
    "ddq": r"ddq|qdd|qddot|qacc|acc|accel|accelerations?",
    "dq": r"dq|qd|qdot|qvel|dpos|vel|velocity|velocities|speeds?|omega",
    "tau": r"tau|eff|efforts?|torques?|trq|tq|moments?",
    "i": r"i|cur|currents?|amps?",
    "ql": r"ql|qlink|linkside",
    "q": r"q|qpos|pos|positions?|angles?|theta|jointpos|joints?|state",
    "u": r"u|actions?|goals?|cmd|commands?|commanded|targets?|setpoints?",
}
_MEASURED = re.compile(r"act|actual|meas|measured|msr|observation|obs")
_PLAIN = re.compile(r"q|pos|positions?|angles?|qd|dq|vel|tau|eff|efforts?|torques?|states?")
_COMMANDED = (
    r"cmd|commands?|commanded|des|desired|ref|reference|target|goal|setpoint|set|action|leader"
)
_UNWANTED = re.compile(rf"{_COMMANDED}|tcp|tool|cart|ext|error")
_SOURCE = re.compile(rf"{_MEASURED.pattern}|{_COMMANDED}|error")
_UNITS = {
    "t": {"ns": "ns", "nsec": "ns", "nanoseconds": "ns", "us": "us", "usec": "us", "ms": "ms",
          "msec": "ms", "timens": "ns", "timeus": "us", "timems": "ms", "s": "s", "sec": "s"},
    "q": {"deg": "deg", "degrees": "deg", "rad": "rad"},
    "dq": {"deg": "deg/s", "degs": "deg/s", "degrees": "deg/s", "rpm": "rpm", "rad": "rad/s",
           "rads": "rad/s"},
    "ddq": {"deg": "deg/s^2", "rad": "rad/s^2"},
    "tau": {"mnm": "mNm", "ncm": "Ncm", "nm": "Nm"},
    "i": {"ma": "mA"},
    "ql": {"deg": "deg", "degrees": "deg", "rad": "rad"},
    "u": {"deg": "deg", "degrees": "deg", "rad": "rad"},
}  # fmt: skip
_BRACKETED = re.compile(r"\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))\s*$")


def words_of(name: str) -> list[str]:
    """The words of a name, in small letters, without numbers."""
    apart = re.sub(r"([a-z])([A-Z])", r"\1 \2", re.sub(r"\d+", " ", name))
    return [word.lower() for word in re.split(r"[^A-Za-z]+", apart) if word]


def quantity_of(words: Iterable[str]) -> str | None:
    """The key (`torchid.log.mapping.KEYS`) of what the words name."""
    words = list(words)
    for key, pattern in _QUANTITIES.items():
        if any(re.fullmatch(pattern, word) for word in words):
            return key
    return None


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
    found = _BRACKETED.search(name)
    if found is None or found.start() == 0:
        return name, ""
    return name[: found.start()], (found[1] or found[2] or "").strip()


def is_unit_word(word: str) -> bool:
    """Whether a part of a name is a unit: deg, nm."""
    return any(word.lower() in units for units in _UNITS.values())
