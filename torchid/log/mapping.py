"""Which columns of somebody else's table are t, q, dq, ddq, tau, i, ext and traj, and their units.

As text, entries are separated by commas:

    q=pos_{j} deg, dq=vel_{j} deg/s, tau=-eff_{j} mNm, t=stamp ns

An entry is KEY=SOURCE, with a minus before the source for the other sign, a unit after it, then a
factor `*0.001` (or ` /1000`), and at the end, after a space, what is added to the raw numbers:
`q=present_position_{j} rev/4096 -2048`; `*[1,-1,1]` and `+[0,-90,0]` are one a joint. A source is

    pos_{j}                one column a joint, counted from 1; {j0} from 0, {2..7} these numbers,
                           {3,1,2} these in this order
    joint_pos              an array (samples, joints), or a column
    state[:,0:7]           some columns of an array, counted from 0 as in Python
    [shoulder, elbow]      named columns, in the robot's order; [q1, q2, q3-q2]: a sum or
                           difference of two, of joints that are coupled
    'Joint {j} (deg)'      a name with spaces, commas or brackets

`*` in a source stands for anything, and every value of it is a trajectory (`demo_*/q`); `t=500 Hz`
makes up the time where none is recorded; `none` leaves out what would be taken by its name, and
`tau1=none` says that joint 1 has no torque sensor, whether or not there is a column for it. `ext`
is a known external torque, which is subtracted from tau; `ext2=load_cell N` that of joint 2 alone.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import yaml

from torchid.errors import LogError
from torchid.log.units import UNITS, unit_factor
from torchid.yaml_data import parsed_yaml

KEYS = tuple(UNITS)
SENSORLESS = re.compile(r"(?:tau|i)([1-9]\d*)")
"""Key of a joint whose torque or current is not measured."""
_ONE_JOINT = re.compile(r"ext[1-9]\d*")
_ALIASES = {"current": "i", "time": "t"}
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_FACTOR = re.compile(rf"(?:\s*\*|\s+/|(?<=\s(?:rev|deg|rpm|rad))/)\s*({_NUMBER}|\[[^\]]*\])\s*$")
_OFFSET = re.compile(rf"\s([-+])\s*({_NUMBER}|\[[^\]]*\])\s*$")
_EXAMPLE = "q=pos_{j} deg,tau=eff_{j},t=time ms"


@dataclass(frozen=True)
class Source:
    """Where one signal comes from.

    Attributes:
        columns: a column, an array, or a pattern; several: one a joint.
        factors: to our units and sign: one, or one a joint.
        offsets: added to the numbers of the column before: one, or one a joint.
        unit: as it was written; empty if it was not.
        rate: of samples without time stamps [Hz]; t only.
    """

    columns: tuple[str, ...]
    factors: tuple[float, ...] = (1.0,)
    offsets: tuple[float, ...] = (0.0,)
    unit: str = ""
    rate: float | None = None

    def at(self, value: str) -> "Source":
        """The source with `*` replaced."""
        return replace(self, columns=tuple(c.replace("*", value) for c in self.columns))


@dataclass(frozen=True)
class ColumnMapping:
    """Sources by key (`KEYS`); None for what is to be left out.

    Attributes:
        sources: by key.
        text: as it was given.
    """

    sources: Mapping[str, Source | None]
    text: str = ""

    def at(self, value: str) -> "ColumnMapping":
        """The mapping with `*` replaced."""
        changed = {k: None if s is None else s.at(value) for k, s in self.sources.items()}
        return ColumnMapping(changed, self.text)


def read_mapping(given: "str | Path | Mapping[str, Any] | ColumnMapping") -> ColumnMapping:
    """A mapping from text, a yaml file, or a dict like its content.

    In yaml a value is the text of an entry, a list of columns, or
    {columns: .., unit: .., factor: .., offset: ..}.

    Raises:
        LogError: an unknown key or unit, or something that cannot be read.
    """
    if isinstance(given, ColumnMapping):
        return given
    if isinstance(given, Mapping):
        return _from_dict(given, "columns")
    if isinstance(given, Path) or ("=" not in given and given.lower().endswith((".yaml", ".yml"))):
        path = Path(given)
        try:
            content = parsed_yaml(path.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
            raise LogError(
                f"the column mapping '{path}' cannot be read.", got=_where_and_why(error)
            ) from error
        if not isinstance(content, Mapping):
            raise LogError(
                f"the column mapping '{path}' is not a mapping.",
                got=type(content).__name__,
                expected="lines such as `q: pos_{j} deg`",
            )
        return _from_dict(content, f"'{given}'")
    sources = {}
    for entry in _split(given, ","):
        key, equals, value = entry.partition("=")
        if not equals:
            raise LogError(
                "`columns=...` has an entry without `=`.",
                got=entry.strip() or given,
                expected=f"KEY=SOURCE, such as {_EXAMPLE}, or a yaml file",
            )
        key = _key(key, "`columns=...`")
        if key in sources:
            raise LogError(f"`columns=...` gives {key} twice.", got=given)
        sources[key] = _source(key, value)
    return ColumnMapping(sources, given)


def _where_and_why(error: Exception) -> str:
    """One line: where a yaml file is wrong, and what is wrong there."""
    if not isinstance(error, yaml.MarkedYAMLError) or error.problem_mark is None:
        return str(error).splitlines()[0]
    text = f"line {error.problem_mark.line + 1}: {error.problem}"
    if error.context is None or error.context_mark is None:
        return text
    return f"{text}, {error.context} that begins in line {error.context_mark.line + 1}"


def _from_dict(content: Mapping[str, Any], name: str) -> ColumnMapping:
    sources: dict[str, Source | None] = {}
    for given, value in content.items():
        key = _key(str(given), name)
        if value is None:
            sources[key] = None
        elif isinstance(value, str | int | float):
            sources[key] = _source(key, str(value))
        elif isinstance(value, list):
            sources[key] = _built(key, tuple(str(c) for c in value), "", (1.0,))
        elif isinstance(value, Mapping) and value.keys() <= {"columns", "unit", "factor", "offset"}:
            names = _listed(value.get("columns", ""))
            factors = tuple(_number(f, key) for f in _listed(value.get("factor", 1.0)))
            offsets = tuple(_number(x, key, "offset") for x in _listed(value.get("offset", 0.0)))
            unit = str(value.get("unit") or "")
            sources[key] = _built(key, tuple(map(str, names)), unit, factors, offsets)
        else:
            raise LogError(
                f"{name}: {key} cannot be understood.",
                got=value,
                expected="`pos_{j} deg`, a list of columns, or {columns: .., unit: .., factor: .., "
                "offset: ..}",
            )
    return ColumnMapping(sources, str(dict(content)))


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _key(text: str, name: str) -> str:
    key = _ALIASES.get(text.strip(), text.strip())
    if key not in KEYS and not SENSORLESS.fullmatch(key) and not _ONE_JOINT.fullmatch(key):
        raise LogError(f"{name} maps an unknown column.", got=text.strip(), available=KEYS)
    return key


def _source(key: str, text: str) -> Source | None:
    """One entry's value (see the module)."""
    rest = text.strip()
    if rest == "none":
        return None
    if SENSORLESS.fullmatch(key):
        raise LogError("of a single joint the mapping says only that there is none.", got=rest)
    offsets: tuple[float, ...] = (0.0,)
    if match := _OFFSET.search(rest):
        sign = -1.0 if match[1] == "-" else 1.0
        offsets = tuple(sign * _number(x, key, "offset") for x in match[2].strip("[] ").split(","))
        rest = rest[: match.start()]
    factors: tuple[float, ...] = (1.0,)
    if match := _FACTOR.search(rest):
        text = match[1]
        factors = tuple(_number(part, key) for part in text.strip("[] ").split(","))
        if match[0].lstrip().startswith("/"):
            factors = tuple(1 / f for f in factors)
        rest = rest[: match.start()]
    if rest.startswith("-"):
        factors, rest = tuple(-f for f in factors), rest[1:].lstrip()
    # The unit is behind the first space outside quotes and brackets.
    name, *words = _split(rest, " ", most=1)
    unit = words[0].strip() if words else ""
    if name.startswith("[") and name.endswith("]"):
        columns = tuple(_unquoted(c.strip()) for c in _split(name[1:-1], ","))
    else:
        columns = (_unquoted(name),)
    return _built(key, columns, unit, factors, offsets)


def _built(
    key: str,
    columns: tuple[str, ...],
    unit: str,
    factors: tuple[float, ...],
    offsets: tuple[float, ...] = (0.0,),
) -> Source:
    if not columns or not all(columns):
        raise LogError(f"the column mapping of {key} names no column.", expected=_EXAMPLE)
    if key == "t" and unit == "Hz":
        rate = float(columns[0]) if re.fullmatch(_NUMBER, columns[0]) else 0.0
        if not 0.0 < rate < float("inf"):
            raise LogError("the sampling rate is not a positive number.", got=columns[0])
        return Source(columns, factors, unit=unit, rate=rate)
    scale = unit_factor(key, unit) if unit else 1.0
    if scale is None:
        units = list(UNITS[key.rstrip("0123456789")])
        raise LogError(
            f"{key} cannot be in this unit.",
            got=unit,
            available=[*units, "Hz (t=500 Hz)"] if key == "t" else units,
            hint="quote names that have spaces: q='Joint {j} pos' deg; a factor: *0.001",
        )
    return Source(columns, tuple(scale * f for f in factors), offsets, unit)


def _unquoted(text: str) -> str:
    return text[1:-1] if len(text) > 1 and text[0] in "'\"`" and text[-1] == text[0] else text


def _split(text: str, separator: str, most: int | None = None) -> list[str]:
    """Split outside quotes and brackets."""
    parts, depth, quote = [""], 0, ""
    for c in text:
        if quote:
            quote = "" if c == quote else quote
        elif c in "'\"`":
            quote = c
        elif c in "[{(":
            depth += 1
        elif c in "]})":
            depth -= 1
        elif c == separator and depth == 0 and (most is None or len(parts) <= most):
            parts.append("")
            continue
        parts[-1] += c
    return parts


def _number(text: object, key: str, word: str = "factor") -> float:
    try:
        value = float(str(text))
    except ValueError:
        value = float("nan")
    if not abs(value) < float("inf") or (value == 0.0 and word == "factor"):
        example = "such as *0.001" if word == "factor" else "such as -2048"
        raise LogError(f"the {word} of {key} is not a number.", got=text, expected=example)
    return value
