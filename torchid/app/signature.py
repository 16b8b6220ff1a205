"""Options of a command, read off its signature and docstrings.

A parameter of a command is an option, or, where it is annotated with a dataclass, one option for
each of that dataclass's fields: type and default stand there and nowhere else. What an option means
is said in the docstring, under `Args:` of the command or `Attributes:` of the dataclass.

Annotations say more: `Parsed` how text becomes a value, `WRITTEN` that a file is a result, `PLACE`
that a folder is neither an input nor a result. All other paths are inputs.
"""

import inspect
import os
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack
from copy import copy
from dataclasses import MISSING, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import typer

from torchid.app.faults import report
from torchid.errors import TorchidError
from torchid.files import inputs_kept, require_writable

Switch = Annotated[bool, "an option --name without its --no-name"]
WRITTEN, PLACE = "a file that is written", "a folder to work in"
_Project = Annotated[
    str | None,
    typer.Option(
        "--project",
        metavar="FILE|none",
        help="Project file (see `torchid init`); the nearest torchid.toml, here or above, if "
        "absent.",
    ),
]
Debug = Annotated[
    bool, typer.Option("--debug", help="Show the traceback of a fault of torchid itself.")
]
LARGEST_WHOLE, LARGEST_REAL = 10**6, 1e9
"""Of counts, and of sizes in SI units, times and frequencies."""
_LAST = (
    "held_out", "columns", "topic", "gain", "jobs", "tip", "root", "lock", "json_file", "out",
    "report", "seed", "quiet", "threads", "device_name", "project_file", "debug",
)  # fmt: skip
"""Options that many commands have stand at the end of the help, always in this order."""


@dataclass(frozen=True)
class Parsed:
    """An option that is text on the command line: `Annotated[tuple[str, ...], Parsed(names)]`.

    Attributes:
        read: the value of a text; raises a TorchidError.
        none: the text of a default that is None or empty; None where such an option is left out.
    """

    read: Callable[[str], Any]
    none: str | None = None

    def text(self, value: Any) -> str | None:
        """A default as it is written."""
        return (",".join(value) if isinstance(value, tuple) else str(value)) if value else self.none


class Fields:
    """Which fields of a dataclass are options: `Annotated[Settings, Fields("signs", rows="all")]`.

    Args:
        names: of fields that are options as they stand, one by one or with blanks between them.
        changed: of fields with an annotation in place of their own, or with another default. A
            field that is None by default, and that an annotation says is not, must be given.
    """

    def __init__(self, *names: str, **changed: Any):
        self.changed = dict.fromkeys(" ".join(names).split()) | changed

    def only(self, names: str, **changed: Any) -> "Fields":
        """Some of them, with other defaults or annotations for those that are `changed`."""
        return Fields(**{name: self.changed[name] for name in names.split()} | changed)


@dataclass(frozen=True)
class Option:
    """A parameter for typer, how the user writes it, and what its annotation says besides."""

    parameter: inspect.Parameter
    shown: str
    said: tuple[Any, ...]

    @property
    def name(self) -> str:
        """In Python."""
        return self.parameter.name

    @property
    def has_name(self) -> bool:
        """Whether it is written with its name; an argument is not."""
        return isinstance(get_args(self.parameter.annotation)[1], typer.models.OptionInfo)

    @property
    def takes(self) -> tuple[bool, bool]:
        """Whether it takes paths, and whether it takes several values."""
        kind = get_args(self.parameter.annotation)[0]
        kinds = {kind, *get_args(kind), *(k for part in get_args(kind) for k in get_args(part))}
        return Path in kinds, any(k is list or get_origin(k) is list for k in kinds)

    def value(self, given: Any) -> Any:
        """What the command gets for what typer gives.

        Raises:
            TorchidError: a number that is none, or beyond all that an option without a range of
                its own can mean; or a text that cannot be read.
        """
        most = LARGEST_WHOLE if isinstance(given, int) else LARGEST_REAL
        most = getattr(get_args(self.parameter.annotation)[1], "max", None) or most
        if isinstance(given, int | float) and not abs(given) <= most:
            raise TorchidError(
                f"{self.shown} is out of range.", got=given, expected=f"at most {most:g} in size"
            )
        parsed = next((one for one in self.said if isinstance(one, Parsed)), None)
        return given if parsed is None or given is None else parsed.read(given)


def command(function: Callable[..., None], *, project: bool = True) -> Callable[..., None]:
    """The function as typer takes it: all options in its signature, the help in its docstring.

    When it runs, nothing is written over an input, and a parameter that is a context manager, as
    `torchid.app.output.Output` is, is entered before the function and left behind it. A command of
    one robot looks for a project file (`torchid.app.project`).
    """
    hints = get_type_hints(function, include_extras=True)
    text, own = _parts(function, "Args")
    groups: dict[str, tuple[type, list[str]]] = {}
    options: list[Option] = []
    for parameter in inspect.signature(function).parameters.values():
        hint = hints[parameter.name]
        kind, chosen = get_args(hint)[:2] if get_origin(hint) is Annotated else (hint, None)
        if not is_dataclass(kind):
            options.append(_option(parameter.name, hint, parameter.default, own))
            continue
        assert isinstance(kind, type)
        made = list(_options(kind, chosen.changed if isinstance(chosen, Fields) else None, own))
        groups[parameter.name] = kind, [option.name for option in made]
        options += made
    if project and any(option.name == "tip" for option in options):
        options.append(_option("project_file", _Project, None, {}))
    options.append(_option("debug", Debug, False, {}))

    def run(**given: Any) -> None:
        _require_apart(options, given)
        values = {option.name: option.value(given[option.name]) for option in options}
        # These two are read before all others, and by nobody else.
        values = {name: v for name, v in values.items() if name not in ("project_file", "debug")}
        for name, (kind, names) in groups.items():
            values[name] = kind(**{key: values.pop(key) for key in names})
        with inputs_kept(_inputs(options, given)), ExitStack() as entered:
            for option in options:
                file = given[option.name] if WRITTEN in option.said else None
                # The folder of --out is made where it is missing, also for what goes into it.
                if file is not None and (file.parent != given.get("out") or file.parent.exists()):
                    require_writable(file, option.shown)
            for name in groups:
                if isinstance(values[name], AbstractContextManager):
                    entered.enter_context(values[name])
            try:
                function(**values)
            except KeyboardInterrupt as stop:  # typer would say nothing
                raise typer.Exit(report(stop, str)) from stop

    options.sort(key=lambda o: 1 + _LAST.index(o.name) if o.name in _LAST else 0)
    parameters = [option.parameter for option in options]
    run.__name__, run.__doc__ = function.__name__, text
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.options = options  # type: ignore[attr-defined]
    return run


def _inputs(options: list[Option], given: Mapping[str, Any]) -> list[Path]:
    """Files and folders that a command is told to read; what is given as text only where it is the
    name of a file."""
    found = []
    for option in options:
        if WRITTEN in option.said or PLACE in option.said:
            continue
        value = given[option.name]
        for one in value if isinstance(value, list | tuple) else [value]:
            if isinstance(one, Path) or (isinstance(one, str) and os.path.isfile(one)):
                found.append(Path(one))
    return found


def _require_apart(options: list[Option], given: Mapping[str, Any]) -> None:
    """Raise a TorchidError where two results are to be written to one file, or a result to what is
    named as a folder."""
    named = [option for option in options if given[option.name] is not None]
    results = [option for option in named if WRITTEN in option.said]
    taken: dict[str, str] = {}
    for option in [*results, *(o for o in named if PLACE in o.said)]:
        path = os.path.realpath(given[option.name])
        # Two places may be one folder.
        found = taken.setdefault if option in results else taken.get
        if (other := found(path, option.shown)) != option.shown:
            raise TorchidError(
                f"{option.shown} and {other} name the same file.", got=given[option.name]
            )


def _options(kind: type, changed: dict[str, Any] | None, own: dict[str, str]) -> Iterator[Option]:
    """Options of a dataclass's fields, all of them if not told which."""
    hints = get_type_hints(kind, include_extras=True)
    texts: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        said = _parts(base, "Attributes")[1]
        texts |= {name: text[:1].upper() + text[1:] for name, text in said.items()}
    for field in fields(kind):
        name, hint, default = field.name, hints[field.name], field.default
        if (changed is not None and name not in changed) or not field.init:
            continue
        other = (changed or {}).get(name)
        if isinstance(other, type) or get_origin(other) is not None:
            hint = other
        elif other is not None:
            default = other
        yield _option(
            name, hint, inspect.Parameter.empty if default is MISSING else default, texts | own
        )


def _option(name: str, hint: Any, default: Any, texts: dict[str, str]) -> Option:
    kind, *described = get_args(hint) if get_origin(hint) is Annotated else (hint,)
    info = next((copy(d) for d in described if isinstance(d, typer.models.ParameterInfo)), None)
    if info is None:
        names = (f"--{name.replace('_', '-')}",) if hint == Switch else ()
        info = typer.Option(*names)
    info.help = info.help or texts.get(name)
    parsed = next((d for d in described if isinstance(d, Parsed)), None)
    if parsed is not None:
        kind = str if parsed.none else str | None
        default = default if default is inspect.Parameter.empty else parsed.text(default)
    elif default is None and type(None) not in get_args(kind):
        default = inspect.Parameter.empty
    shown = info.default if isinstance(info.default, str) else f"--{name.replace('_', '-')}"
    parameter = inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[kind, info]
    )
    return Option(parameter, shown, tuple(described))


def _parts(documented: Any, section: str) -> tuple[str, dict[str, str]]:
    """A docstring before a section, and the section's texts by name, each in one line."""
    text, _, rest = (inspect.getdoc(documented) or "").partition(f"\n\n{section}:\n")
    found: dict[str, str] = {}
    for entry in re.split(r"^    (?=\w)", rest.partition("\n\n")[0], flags=re.MULTILINE)[1:]:
        names, _, words = entry.partition(": ")
        found |= dict.fromkeys(names.split(", "), " ".join(words.split()))
    return text, found
