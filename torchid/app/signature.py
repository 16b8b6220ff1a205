"""Options of a command, read off its signature and docstrings.

A parameter of a command is an option, or, where it is annotated with a dataclass, one option for
each of that dataclass's fields: type and default stand there and nowhere else. What an option means
is said in the docstring, under `Args:` of the command or `Attributes:` of the dataclass.
"""

import inspect
import re
from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import MISSING, fields, is_dataclass
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import typer

Switch = Annotated[bool, "an option --name without its --no-name"]

_LAST = (
    "held_out", "columns", "topic", "gain", "jobs", "tip", "json_file", "out", "report", "seed",
    "quiet", "threads", "device_name",
)  # fmt: skip
"""Options that many commands have stand at the end of the help, always in this order."""


class Fields:
    """Which fields of a dataclass are options: `Annotated[Settings, Fields("method", rows="all")]`.

    Args:
        names: of fields that are options as they stand.
        changed: of fields with an annotation in place of their own, or with another default.
    """

    def __init__(self, *names: str, **changed: Any):
        self.changed = dict.fromkeys(names) | changed


def command(function: Callable[..., None]) -> Callable[..., None]:
    """The function as typer takes it: all options in its signature, the help in its docstring."""
    hints = get_type_hints(function, include_extras=True)
    text, own = _parts(function, "Args")
    groups: dict[str, tuple[type, list[str]]] = {}
    options = []
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

    def run(**given: Any) -> None:
        for name, (kind, names) in groups.items():
            given[name] = kind(**{key: given.pop(key) for key in names})
        function(**given)

    options.sort(key=lambda o: 1 + _LAST.index(o.name) if o.name in _LAST else 0)
    run.__name__, run.__doc__ = function.__name__, text
    run.__annotations__ = {option.name: option.annotation for option in options}
    run.__signature__ = inspect.Signature(options)  # type: ignore[attr-defined]
    return run


def _options(
    kind: type, changed: dict[str, Any] | None, own: dict[str, str]
) -> Iterator[inspect.Parameter]:
    """Options of a dataclass's fields, all of them if not told which."""
    hints = get_type_hints(kind, include_extras=True)
    texts: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        said = _parts(base, "Attributes")[1]
        texts |= {name: text[:1].upper() + text[1:] for name, text in said.items()}
    for field in fields(kind):
        name, hint, default = field.name, hints[field.name], field.default
        if changed is not None and name not in changed:
            continue
        other = (changed or {}).get(name)
        if isinstance(other, type) or get_origin(other) is not None:
            hint = other
        elif other is not None:
            default = other
        yield _option(
            name, hint, inspect.Parameter.empty if default is MISSING else default, texts | own
        )


def _option(name: str, hint: Any, default: Any, texts: dict[str, str]) -> inspect.Parameter:
    kind, *described = get_args(hint) if get_origin(hint) is Annotated else (hint,)
    info = next((copy(d) for d in described if isinstance(d, typer.models.ParameterInfo)), None)
    if info is None:
        names = (f"--{name.replace('_', '-')}",) if hint == Switch else ()
        info = typer.Option(*names)
    info.help = info.help or texts.get(name)
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[kind, info]
    )


def _parts(documented: Any, section: str) -> tuple[str, dict[str, str]]:
    """A docstring before a section, and the section's texts by name, each in one line."""
    text, _, rest = (inspect.getdoc(documented) or "").partition(f"\n\n{section}:\n")
    found: dict[str, str] = {}
    for entry in re.split(r"^    (?=\w)", rest.partition("\n\n")[0], flags=re.MULTILINE)[1:]:
        names, _, words = entry.partition(": ")
        found |= dict.fromkeys(names.split(", "), " ".join(words.split()))
    return text, found
