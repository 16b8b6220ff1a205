"""Options of a command, read off its signature and docstrings.

A parameter of a command is an option, or, where it is annotated with a dataclass, one option for
each of that dataclass's fields: type and default stand there and nowhere else. What an option means
is said in the docstring, under `Args:` of the command or `Attributes:` of the dataclass.

Annotations say more: `Parsed` how text becomes a value, and `torchid.app.inputs` what a file is.
Names of files behind a dataclass, `Annotated[Output, Fields(..), "gap.json"]`, are those of results
in the folder of --out, where a second run does not take their place unless it is told to.
"""

import inspect
import re
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack
from copy import copy
from dataclasses import MISSING, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import typer

from torchid.app.faults import report
from torchid.app.inputs import (
    inputs_of,
    require_apart,
    require_free,
    require_inputs,
    require_results,
)
from torchid.errors import TorchidError
from torchid.files import inputs_kept

Switch = Annotated[bool, "an option --name without its --no-name"]
Debug = Annotated[
    bool, typer.Option("--debug", help="Show the traceback of a fault of torchid itself.")
]
LARGEST_WHOLE, LARGEST_REAL = 10**6, 1e9
"""Of counts, and of sizes in SI units, times and frequencies."""
_REST = "*"
_PANELS = (
    ("Options", "to result loaded effects effect causes *"),
    ("Options", "held_out save out pictures report save_model"),
    ("Two logs", "simulated real before no_rows"),
    ("Search", "time background parameters worthwhile worthwhile_torque gain_std max_effects"),
    ("Search", "runs stages generations population penalty schedule engine certificate"),
    ("Fit", "cutoff held_out_fraction rows reversal method covariance signs essential"),
    ("Fit", "error_cutoff"),
    (
        "Motion",
        "kind criterion basis usage speed count harmonics restarts clearance floor workspace",
    ),
    ("Noise", "noise snr torque_noise encoder_bits colour velocity_noise"),
    ("Under control, or replayed", "closed_loop control_frequency replay windows"),
    ("Randomise", "randomise spread draws"),
    ("Bodies", "geometry shapes total_mass margin"),
    ("Reading logs", "columns topic torque gain kp kd"),
    ("Reading the robot", "tip root lock base servo"),
    ("Output", "ros2 urscript json_file overwrite force quiet"),
    ("Running", "seed workers jobs scheduler store threads device_name debug"),
)
"""Where in the help options stand, in this order: the panel and their names; `*` for all others."""
_PLACES = {
    name: (place, title)
    for place, (name, title) in enumerate((n, title) for title, ns in _PANELS for n in ns.split())
}
_WIDEST = 18
"""Of choices that stand beside an option's name; more of them stand in its text."""


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
    def info(self) -> Any:
        """As typer describes it."""
        return get_args(self.parameter.annotation)[1]

    @property
    def kind(self) -> Any:
        """The type of what typer gives."""
        return get_args(self.parameter.annotation)[0]

    @property
    def place(self) -> tuple[int, str]:
        """Where it stands in the help, and in which panel."""
        return _PLACES.get(self.name, _PLACES[_REST])

    @property
    def choices(self) -> tuple[str, ...]:
        """All values that it may have, where there are few."""
        kinds = [self.kind, *get_args(self.kind)]
        return next((get_args(kind) for kind in kinds if get_origin(kind) is Literal), ())

    @property
    def written(self) -> str:
        """As it is written: its name, and what stands for a value."""
        choices = "|".join(self.choices)
        short = choices if 0 < len(choices) <= _WIDEST else None
        word = "N" if int in self.kinds else self.shown.rpartition("-")[2].upper()
        value = self.info.metavar or short or word
        if not self.has_name:
            return str(value)
        if self.kind is not bool:
            return f"{self.shown} {value}"
        both = not isinstance(self.info.default, str)
        return f"{self.shown}/--no-{self.shown.lstrip('-')}" if both else self.shown

    @property
    def about(self) -> str:
        """What it is, its choices where they do not stand beside its name, and its default."""
        default = self.parameter.default
        said = [str(self.info.help or "").replace("`", "")]
        if self.choices and not self.written.endswith("|".join(self.choices)):
            said.append(f"One of {', '.join(self.choices)}.")
        if default is inspect.Parameter.empty:
            said.append("[required]")
        elif default not in (None, "") and default is not False and self.info.show_default:
            value = "yes" if default is True else str(default).replace(",", ", ")
            said.append(f"[default: {value}]")
        return " ".join(said)

    @property
    def has_name(self) -> bool:
        """Whether it is written with its name; an argument is not."""
        return isinstance(self.info, typer.models.OptionInfo)

    @property
    def kinds(self) -> set[Any]:
        """The option's type, and the types that it is made of."""
        parts = get_args(self.kind)
        return {self.kind, *parts, *(inner for part in parts for inner in get_args(part))}

    @property
    def takes_paths(self) -> bool:
        """Whether it takes paths."""
        return Path in self.kinds

    def value(self, given: Any) -> Any:
        """What the command gets for what typer gives.

        Raises:
            TorchidError: a number that is none, or beyond all that an option without a range of
                its own can mean; or a text that cannot be read.
        """
        most = LARGEST_WHOLE if isinstance(given, int) else LARGEST_REAL
        most = getattr(self.info, "max", None) or most
        if isinstance(given, int | float) and not abs(given) <= most:
            raise TorchidError(
                f"{self.shown} is out of range.", got=given, expected=f"at most {most:g} in size"
            )
        parsed = next((one for one in self.said if isinstance(one, Parsed)), None)
        return given if parsed is None or given is None else parsed.read(given)


OPTIONS: dict[str, list[Option]] = {}
"""The options of every command of the program, by its name with its group's: `log show`."""


def command(function: Callable[..., None]) -> Callable[..., None]:
    """The function as typer takes it: all options in its signature, the help in its docstring.

    When it runs, nothing is written over an input, and a parameter that is a context manager, as
    `torchid.app.output.Output` is, is entered before the function and left behind it.
    """
    hints = get_type_hints(function, include_extras=True)
    text, own = _parts(function, "Args")
    groups: dict[str, tuple[type, list[str]]] = {}
    results: list[str] = []
    options: list[Option] = []
    for parameter in inspect.signature(function).parameters.values():
        hint = hints[parameter.name]
        kind, chosen, *said = get_args(hint) if get_origin(hint) is Annotated else (hint, None)
        if not is_dataclass(kind):
            options.append(_option(parameter.name, hint, parameter.default, own))
            continue
        assert isinstance(kind, type)
        made = list(_options(kind, chosen.changed if isinstance(chosen, Fields) else None, own))
        if not said and "save_model" not in hints:  # nothing would be written over
            made = [option for option in made if option.name != "overwrite"]
        results += said
        groups[parameter.name] = kind, [option.name for option in made]
        options += made
    options.append(_option("debug", Debug, False, {}))

    def run(**given: Any) -> None:
        with inputs_kept(inputs_of(options, given)), ExitStack() as entered:
            require_apart(options, given)
            require_results(options, given)
            require_inputs(options, given)
            if given.get("overwrite") is False:
                require_free(given, results)
            values = {option.name: option.value(given[option.name]) for option in options}
            del values["debug"]  # read before all others, and by nobody else
            for name, (kind, names) in groups.items():
                values[name] = kind(**{key: values.pop(key) for key in names})
                if isinstance(values[name], AbstractContextManager):
                    entered.enter_context(values[name])
            try:
                function(**values)
            except KeyboardInterrupt as stop:  # typer would say nothing
                raise typer.Exit(report(stop, str)) from stop

    options.sort(key=lambda option: option.place[0] if option.has_name else -1)
    parameters = [option.parameter for option in options]
    run.__name__, run.__doc__ = function.__name__, text
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.options = options  # type: ignore[attr-defined]
    return run


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
    said: dict[str, str] = {}
    for entry in re.split(r"^    (?=\w)", rest.partition("\n\n")[0], flags=re.MULTILINE)[1:]:
        names, _, words = entry.partition(": ")
        said |= dict.fromkeys(names.split(", "), " ".join(words.split()))
    return text, said
