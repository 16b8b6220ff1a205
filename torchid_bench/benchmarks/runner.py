"""What all benchmarks have in common: a command that is a function's signature, cases whose results
are kept, and lines of Markdown.

    def main(data: Path, *, work: Path, sizes: Sequence[float] = (2.0,), logs: tuple[str, ...] = ()): ...

    if __name__ == "__main__":
        command(main)  # python -m torchid_bench.benchmarks.NAME DATA --work DIR --sizes 1 2 --logs a,b
"""

import argparse
import hashlib
import inspect
import json
import multiprocessing
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, get_args, get_origin

from torchid.errors import TorchidError
from torchid.files import write_text


def command(
    *functions: Callable[..., object], words: Sequence[str] | None = None, **fixed: object
) -> None:
    """Run a function with what the command line gives, on one thread; one of several by its name.

    Arguments are positional where the function's are, and options where these are keywords:
    `Sequence[T]` takes several words, `tuple[T, T]` two, `tuple[T, ...]` one with commas, `Literal` one of
    its words, and a `bool` none. A number that the function returns is the exit code; a TorchidError is printed, exit 1.

    Args:
        functions: one, or several of these names.
        words: of the command line; the process' own where there are none.
        fixed: arguments of the function that the command line does not give.
    """
    import torch

    about = sys.modules[functions[0].__module__].__doc__
    parser = argparse.ArgumentParser(
        description=about, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True) if len(functions) > 1 else None
    for function in functions:
        own = commands.add_parser(function.__name__.replace("_", "-")) if commands else parser
        own.set_defaults(function=function)
        for parameter in inspect.signature(function, eval_str=True).parameters.values():
            if parameter.name not in fixed:
                _add(own, parameter)
    given = vars(parser.parse_args(words))
    torch.set_num_threads(1)
    try:
        code = given.pop("function")(**given, **fixed)
    except TorchidError as error:
        sys.exit(f"error: {error}")
    if code:
        sys.exit(code)


def _add(parser: argparse.ArgumentParser, parameter: inspect.Parameter) -> None:
    """The option of a function's parameter."""
    kind, name, required = parameter.annotation, parameter.name, parameter.default is inspect._empty
    if isinstance(kind, UnionType):
        kind = next(one for one in get_args(kind) if one is not NoneType)
    some = get_args(kind)
    options: dict[str, Any] = {"type": some[0] if some else kind}
    if get_origin(kind) is Literal:
        options = {"choices": some}
    elif get_origin(kind) is tuple and some[-1] is not ...:
        options["nargs"] = len(some)
    elif get_origin(kind) is tuple:
        options = {"type": lambda text: tuple(some[0](x) for x in text.split(","))}
    elif get_origin(kind) is Sequence:
        options["nargs"] = "+" if required else "*"
    elif kind is bool:
        options = {"action": "store_true"}
    if not required:
        options["default"] = parameter.default
    if parameter.kind is parameter.KEYWORD_ONLY:
        parser.add_argument(f"--{name.replace('_', '-')}", required=required, **options)
    else:
        parser.add_argument(name, **options if required else {"nargs": "?"} | options)


def results(
    function: Callable[..., Any],
    cases: Mapping[str, Sequence[Any]],
    folder: Path | None = None,
    *,
    jobs: int = 1,
    fresh: bool = False,
) -> Iterator[tuple[str, Any]]:
    """Names and results of cases, in their order.

    Args:
        function: of a module; makes plain data, or None of a case that there is not.
        cases: its arguments, by a name that other arguments do not have.
        folder: results are kept there as NAME.json as soon as they are there, and are not made again
            in a run that takes up an interrupted one, but for those with an `error`; None: they are
            not kept.
        jobs: processes.
        fresh: whether each case has a process of its own even if there is one job.
    """
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    todo = {n: (function, case, folder and folder / f"{n}.json") for n, case in cases.items()}
    pool = None
    if jobs > 1 or fresh:
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(jobs, context, max_tasks_per_child=1)
    try:
        futures = {name: pool.submit(_kept, *one) for name, one in todo.items()} if pool else {}
        for name, one in todo.items():
            result = futures[name].result() if pool else _kept(*one)
            if result is not None:
                yield name, result
    finally:
        if pool:
            pool.shutdown(cancel_futures=True)


def _kept(function: Callable[..., Any], case: Sequence[Any], file: Path | None) -> Any:
    """A result that is there, or is made and written in one step, so that no half of one is left
    where a run is interrupted."""
    if file is not None and file.exists():
        return json.loads(file.read_text())
    result = function(*case)
    failed = isinstance(result, dict) and result.get("error")
    if file is not None and result is not None and not failed:
        write_text(file, json.dumps(result, indent=1))
    return result


def digest(*arguments: object) -> str:
    """For the name of what is made with them."""
    return hashlib.sha256(repr(arguments).encode()).hexdigest()[:16]


def table(
    head: Sequence[str],
    rows: Iterable[Sequence[object]],
    file: Path | None = None,
    before: str = "",
    page: Path | None = None,
) -> None:
    """Print a table of Markdown, and write it to a file with a text before it, or into a page."""
    from torchid.report.table import pipe_table

    text = f"\n{pipe_table(head, rows)}\n"
    print(text, flush=True)
    if page is not None:
        replace_table(page, text.strip().splitlines())
    if file is not None:
        file.write_text(f"{before}\n{text}")


def replace_table(page: Path, table: list[str]) -> None:
    """Put the table in the place of the page's own, which begins with the same first title."""
    title = " | ".join(table[0].split(" | ")[:2])
    before, _, after = page.read_text().partition(title)
    rest = after.partition("\n\n")[2]
    page.write_text(before + "\n".join(table) + "\n\n" + rest)


def share(hits: int, count: int) -> str:
    """So many of so many, with the 95 % interval (Wilson)."""
    from torchid.statistics.proportion import wilson

    low, high = wilson(hits, count)
    return f"{hits} of {count} ({low:.0%} - {high:.0%})"
