"""A mapping that may be meant, from the names of a table's columns: proposed, never applied."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from torchid.log.columns import is_wanted
from torchid.log.guess_units import guessed_units
from torchid.log.mapping import read_mapping
from torchid.log.table import Table

# Words in the names of what is measured; the first kind that fits is taken.
_WORDS = {
    "t": r"t|ts|time|timestamp|stamp|times|secs?|seconds|clock|tout|elapsed|time(s|ms|us|ns|sec)",
    "ddq": r"ddq|qdd|qddot|qacc|acc|accel|accelerations?",
    "dq": r"dq|qd|qdot|qvel|dpos|vel|velocity|velocities|speeds?|omega",
    "tau": r"tau|eff|efforts?|torques?|trq|tq|moments?",
    "i": r"i|cur|currents?|amps?",
    "q": r"q|qpos|pos|positions?|angles?|theta|jointpos|joints?|state",
}
_WANTED = re.compile(r"act|actual|meas|measured|msr|observation|obs")
_PLAIN = re.compile(r"q|pos|positions?|angles?|qd|dq|vel|tau|eff|efforts?|torques?")
_UNWANTED = re.compile(
    r"cmd|command(ed)?|des|desired|ref|reference|target|goal|set|action|tcp|tool|cart|ext|error"
)
_UNITS = {
    "t": {"ns": "ns", "nsec": "ns", "nanoseconds": "ns", "us": "us", "usec": "us", "ms": "ms",
          "msec": "ms", "timens": "ns", "timeus": "us", "timems": "ms"},
    "q": {"deg": "deg", "degrees": "deg"},
    "dq": {"deg": "deg/s", "degs": "deg/s", "degrees": "deg/s", "rpm": "rpm"},
    "ddq": {"deg": "deg/s^2"},
    "tau": {"mnm": "mNm", "ncm": "Ncm"},
    "i": {"ma": "mA"},
}  # fmt: skip


@dataclass(frozen=True)
class _Group:
    """Columns that may be one signal.

    Attributes:
        source: as a mapping writes it.
        key: what the words say it is.
        joints: number of columns; 0 where the shape is not known.
        score: how much its name looks like a measurement.
    """

    source: str
    key: str
    joints: int
    score: float


def proposal(table: Table) -> tuple[str, tuple[str, ...]] | None:
    """A text for --columns, and the units in it that are guessed from the numbers' ranges; None
    where time or positions cannot be guessed.

    Columns that have our names need no mapping and are not in it.
    """
    names = [name for name in table.columns if not is_wanted(name)]
    groups = [*_singles(names), *_arrays(table, names), *_numbered(names), *_named(names)]
    chosen: dict[str, _Group] = {}
    for key in ("t", "q", "dq", "tau", "i"):
        joints = chosen["q"].joints if "q" in chosen else 0
        fitting = [g for g in groups if g.key == key and (not joints or g.joints in (0, joints))]
        if fitting and not _own(table, key):
            chosen[key] = max(fitting, key=lambda g: g.score)
    if any(key not in chosen and not _own(table, key) for key in ("t", "q")):
        return None
    if "tau" in chosen:
        chosen.pop("i", None)
    text = _text(chosen, {})
    if not text:
        return None
    units = guessed_units(read_mapping(text), table)
    time = chosen["t"].source if "t" in chosen else ""
    return _every_group(_text(chosen, units), time, names), tuple(units.values())


def _text(chosen: Mapping[str, _Group], units: Mapping[str, str]) -> str:
    return ",".join(f"{k}={g.source} {units.get(k, '')}".strip() for k, g in chosen.items())


def _every_group(text: str, time: str, names: list[str]) -> str:
    """With `*` for the number of a group, where there are several like it: demo_*/q."""
    group = re.match(r"(.*?)\d+([/.].*)", time)
    if group is None:
        return text
    before, after = (re.escape(part.split(" ")[0]) for part in group.groups())
    if sum(re.fullmatch(rf"{before}\d+{after}", name) is not None for name in names) < 2:
        return text
    number = time[len(group[1]) : len(time) - len(group[2])]
    return text.replace(f"{group[1]}{number}{group[2][0]}", f"{group[1]}*{group[2][0]}")


def _own(table: Table, key: str) -> bool:
    return (f"{key}1" if key != "t" else "t") in table.columns or (
        table.arrays and key in table.columns
    )


def _words(name: str) -> list[str]:
    apart = re.sub(r"([a-z])([A-Z])", r"\1 \2", re.sub(r"\d+", " ", name))
    return [word.lower() for word in re.split(r"[^A-Za-z]+", apart) if word]


def _kind(words: Iterable[str]) -> str | None:
    words = list(words)
    for key, pattern in _WORDS.items():
        if any(re.fullmatch(pattern, word) for word in words):
            return key
    return None


def _score(words: list[str]) -> float:
    wanted = sum(bool(_WANTED.fullmatch(word)) for word in words)
    wanted += any(_PLAIN.fullmatch(word) for word in words)
    return wanted - 2 * sum(bool(_UNWANTED.fullmatch(word)) for word in words) - 0.01 * len(words)


def _written(names: list[str], key: str) -> str:
    """The source as a mapping writes it: quoted if need be, with the unit that the name says."""
    quoted = [f"'{n}'" if re.search(r"[\s,\"=\[\]()*-]", n) else n for n in names]
    said = [word.lower() for word in re.split(r"[^A-Za-z]+", names[0])]
    unit = next((_UNITS[key][word] for word in said if word in _UNITS[key]), None)
    source = quoted[0] if len(names) == 1 else f"[{', '.join(quoted)}]"
    return f"{source} {unit}" if unit else source


def _singles(names: list[str]) -> list[_Group]:
    """Columns that may be the time."""
    found = []
    for name in names:
        words = _words(name.rsplit("/", 1)[-1])
        if _kind(words) == "t" and not re.search(r"\d", name.rsplit("/", 1)[-1]):
            found.append(_Group(_written([name], "t"), "t", 1, _score(_words(name))))
    return found


def _arrays(table: Table, names: list[str]) -> list[_Group]:
    """Arrays (T, n), or of unknown shape in a file that may have some."""
    found = []
    for name in names:
        shape = table.columns[name]
        if not (table.arrays or (shape and len(shape) == 2)) or (shape and len(shape) != 2):
            continue
        if shape and 1 in shape:
            continue
        words = _words(name)
        key = _kind(reversed(words)) if words else None
        if key in (None, "t"):
            continue
        joints = min((k for k in shape or () if k > 0), default=0)
        found.append(_Group(_written([name], str(key)), str(key), joints, 0.5 + _score(words)))
    return found


def _numbered(names: list[str]) -> list[_Group]:
    """Columns that differ in one number, which counts from 0 or 1."""
    families: dict[tuple[str, str], set[int]] = {}
    for name in names:
        for m in re.finditer(r"\d+", name):
            families.setdefault((name[: m.start()], name[m.end() :]), set()).add(int(m[0]))
    found = []
    for (before, after), numbers in families.items():
        first = min(numbers)
        if first > 1 or numbers != set(range(first, first + len(numbers))) or len(numbers) < 2:
            continue
        words = _words(f"{before} {after}")
        key = _kind(words)
        if key in (None, "t"):
            continue
        source = _written([f"{before}{{{'j' if first else 'j0'}}}{after}"], str(key))
        found.append(_Group(source, str(key), len(numbers), _score(words)))
    return found


def _named(names: list[str]) -> list[_Group]:
    """Columns such as shoulder.pos, elbow.pos: what they have in common says what they are."""
    families: dict[str, list[str]] = {}
    for name in names:
        first, last = (
            re.fullmatch(p, name) for p in (r"([^._/ ]+)[._/ ].+", r".+[._/ ]([^._/ ]+)")
        )
        for part in {m[1] for m in (first, last) if m is not None}:
            if _kind([part.lower()]) not in (None, "t"):
                families.setdefault(part, []).append(name)
    found = []
    for part, members in families.items():
        if len(members) < 2 or _numbered(members):
            continue
        key = str(_kind([part.lower()]))
        score = _score(_words(members[0])) - 0.2
        found.append(_Group(_written(members, key), key, len(members), score))
    return found
