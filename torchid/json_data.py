"""Results as JSON: made plain, written whole or not at all, read back with one clear error."""

import json
import math
from collections.abc import Iterable, Mapping
from operator import attrgetter
from pathlib import Path
from typing import Any

from torchid.errors import TorchidError
from torchid.files import atomic_write


def plain(value: Any) -> Any:
    """Tensors and tuples as lists, what is not finite as None, keys as text."""
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, str) or value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, Iterable):
        return [plain(item) for item in value]
    number = float(value)
    return number if math.isfinite(number) else None


def picked(value: object, names: str) -> dict[str, Any]:
    """Attributes of a result as plain data, in the order of a schema.

    Args:
        value: the result.
        names: of the attributes, separated by blanks; `key=attribute` where the schema calls one
            otherwise, with a dot for an attribute of an attribute.
    """
    pairs = (name.partition("=")[::2] for name in names.split())
    return {key: plain(attrgetter(attribute or key)(value)) for key, attribute in pairs}


def write_json(data: Mapping[str, Any], path: Path) -> bytes:
    """Write JSON atomically; returns the bytes that are in the file."""
    content = (json.dumps(data, indent=1, allow_nan=False) + "\n").encode()
    with atomic_write(path, "wb") as file:
        file.write(content)
    return content


def read_json(path: Path, what: str) -> dict[str, Any]:
    """A JSON object from a file.

    Args:
        path: of the file.
        what: it should be, for the errors.

    Raises:
        TorchidError: no such file, or no JSON object in it.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise TorchidError(
            f"'{path}' cannot be read: {error.strerror or error}.", expected=what
        ) from error
    try:
        data = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise TorchidError(f"'{path}' is not JSON.", got=str(error), expected=what) from error
    if not isinstance(data, dict):
        raise TorchidError(
            f"'{path}' is not {what}.", got=type(data).__name__, expected="a JSON object"
        )
    return data
