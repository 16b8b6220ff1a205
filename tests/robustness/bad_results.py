"""Results of torchid that something else has written or changed."""

import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests.golden.documents import Bench
from tests.robustness.bad_logs import DEEP, ESCAPE, HUGE, LONG

VALUES = (None, "x", [], 1e308, [[[]]], HUGE)


def good(folder: Path) -> tuple[Path, Path]:
    """A file of sets and an identification."""
    bench = Bench(folder)
    found = bench.sets, bench.identified()
    (folder / "document.json").unlink()
    return found


def _changed(document: dict[str, Any], depth: int = 1) -> Iterator[tuple[str, Any]]:
    """The document without each of its entries, and with other values there."""
    for path in _places(document, depth):
        for k, value in enumerate((..., *VALUES)):
            other = copy.deepcopy(document)
            here: Any = other
            for part in path[:-1]:
                here = here[part]
            if value is ...:
                del here[path[-1]]
            else:
                here[path[-1]] = value
            yield f"{'.'.join(map(str, path))} {k}", other


def _places(value: Any, depth: int) -> Iterator[tuple[Any, ...]]:
    inside: Any = value.items() if isinstance(value, dict) else enumerate(value[:1])
    for key, entry in inside:
        yield (key,)
        if depth and isinstance(entry, dict | list):
            yield from ((key, *rest) for rest in _places(entry, depth - 1))


def _files() -> Iterator[tuple[str, bytes]]:
    yield "empty", b""
    yield "words", b"just words"
    yield "binary", bytes(range(256))
    yield "list", b"[]"
    yield "null", b"null"
    yield "deep", b"[" * DEEP
    yield "deep_map", b'{"a":' * DEEP
    yield "no_schema", b"{}"
    schemas = ([], {}, 1, None, "x", "torchid.gap/2", "torchid.gap/1", LONG, ESCAPE)
    for k, schema in enumerate(schemas):
        yield f"schema{k}", json.dumps({"schema": schema, "sets": []}).encode()
    yield "digits", b'{"schema": ' + b"9" * 20_000 + b"}"
    yield "nan", b'{"schema": NaN}'
    yield "surrogate", b'{"schema": "\\ud800"}'
    yield "utf-16", '{"schema": "x"}'.encode("utf-16")


def write_all(folder: Path, *whole: Path) -> dict[str, Path]:
    """All bad results, by a name of each; those whose name begins with `no_` are none at all."""
    found = {}
    for name, content in _files():
        found[name] = folder / f"no_{name}.json"
        found[name].write_bytes(content)
    for k, path in enumerate(whole):
        document = json.loads(path.read_text())
        for number, (name, other) in enumerate(_changed(document)):
            found[f"{document['schema']} {name}"] = folder / f"{k}_{number}.json"
            found[f"{document['schema']} {name}"].write_text(json.dumps(other))
    return found
