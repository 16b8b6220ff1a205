"""Every command's arguments and options as plain data: names, metavar, type, default.

Read from the commands' signatures, as typer reads them: what typer makes of them is its own affair
and differs between its versions.
"""

import inspect
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import typer

from torchid.app.commands import app

STORED = Path(__file__).parent / "options.json"


def table() -> dict[str, dict[str, Any]]:
    """One entry a command ("" the program itself), one entry in it a parameter."""
    return {name: dict(_parameters(function)) for name, function in sorted(_commands(app))}


def _commands(group: typer.Typer, path: str = "") -> Iterator[tuple[str, Any]]:
    if group.registered_callback is not None and group.registered_callback.callback is not None:
        yield path.strip(), group.registered_callback.callback
    for command in group.registered_commands:
        assert command.callback is not None
        name = command.name or command.callback.__name__.replace("_", "-")
        yield f"{path} {name}".strip(), command.callback
    for below in group.registered_groups:
        assert below.typer_instance is not None
        yield from _commands(below.typer_instance, f"{path} {below.name}")


def _parameters(function: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    hints = get_type_hints(function, include_extras=True)
    for parameter in inspect.signature(function).parameters.values():
        kind, info = _annotation(hints[parameter.name])
        if kind is typer.Context:
            continue
        option = not isinstance(info, typer.models.ArgumentInfo)
        names = _names(parameter.name, kind, info) if option else [parameter.name]
        required = parameter.default is inspect.Parameter.empty
        bounds = [getattr(info, "min", None), getattr(info, "max", None)]
        yield (
            names[0] if option else f"<{names[0]}>",
            {
                "names": names,
                "metavar": getattr(info, "metavar", None),
                "type": _type(kind) + ("" if bounds == [None, None] else f" {bounds}"),
                "default": None if required else _plain(parameter.default),
                "required": required,
            },
        )


def _annotation(hint: Any) -> tuple[Any, Any]:
    """The type and typer's description, if any."""
    if get_origin(hint) is not Annotated:
        return hint, None
    kind, *described = get_args(hint)
    return kind, next((d for d in described if isinstance(d, typer.models.ParameterInfo)), None)


def _names(name: str, kind: Any, info: Any) -> list[str]:
    """As the user writes them; a switch without names of its own can be switched off, too."""
    # In Annotated the first name stands where the default would.
    first = getattr(info, "default", None)
    declared = [first] if isinstance(first, str) else []
    declared += getattr(info, "param_decls", None) or ()
    given = [part for names in declared for part in names.split("/")]
    dashed = name.replace("_", "-")
    return given or [f"--{dashed}", *([f"--no-{dashed}"] if kind is bool else [])]


def _type(kind: Any) -> str:
    """`choice of a, b`; `list of path`; `path`. None, which only says 'not given', left out."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Literal:
        return f"choice of {', '.join(str(p) for p in parts)}"
    if origin in (Union, types.UnionType):
        return " or ".join(_type(p) for p in parts if p is not type(None))
    if origin is not None:
        return f"{origin.__name__} of {' and '.join(_type(p) for p in parts)}"
    return kind.__name__.lower()


def _plain(value: Any) -> Any:
    """Of a default what JSON can hold."""
    return value if value is None or isinstance(value, bool | int | float) else str(value)


def differences(before: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """One sentence for everything that is gone, new or other."""
    said = []
    for command in sorted(before.keys() | now.keys()):
        name = f"torchid {command}".strip()
        if command not in now:
            said.append(f"{name}: the command is gone")
        elif command not in before:
            said.append(f"{name}: the command is new")
        else:
            said += [f"{name} {d}" for d in _between(before[command], now[command])]
    return said


def _between(before: dict[str, Any], now: dict[str, Any]) -> list[str]:
    gone = [f"{option}: gone" for option in before if option not in now]
    new = [f"{option}: new" for option in now if option not in before]
    other = [
        f"{option}: {part} was {value!r}, is {now[option].get(part)!r}"
        for option, parts in before.items()
        if option in now
        for part, value in parts.items()
        if now[option].get(part) != value
    ]
    return gone + new + other
