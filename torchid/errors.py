"""Errors that carry the evidence: what was got, what was expected, what is available.

Every error a user can cause is a TorchidError. The command line prints its text and exits with 1;
a library user can read the parts.
"""

import re
import reprlib
from collections.abc import Mapping, Sequence
from difflib import get_close_matches

LARGEST = 1e21
"""Size of numbers that nothing measured or built has in any unit, not even time in nanoseconds:
beyond it, products of a few of them are none any more."""


_BEGINNING = reprlib.Repr()
_BEGINNING.maxlevel, _BEGINNING.maxlist, _BEGINNING.maxtuple, _BEGINNING.maxdict = 4, 40, 40, 40
_BEGINNING.maxstring, _BEGINNING.maxother = 300, 300
_LONG_WORD, _LONG_LINE = re.compile(r"(\S{150})\S{100,}(\S{50})"), 2000


def visible(text: str) -> str:
    """A text as a terminal may show it, whatever file its words come from: without control
    characters, which terminals obey, spaces and breaks of other kinds, and words and lines of
    thousands of letters.

    >>> visible("joint \\x1b[31mred")
    'joint \ufffd[31mred'
    """
    safe = "".join(c if c in "\n\t" or c.isprintable() else "\ufffd" for c in text)
    lines = (_LONG_WORD.sub(r"\1…\2", line) for line in safe.split("\n"))
    return "\n".join(
        line if len(line) <= _LONG_LINE else f"{line[: _LONG_LINE - 1]}…" for line in lines
    )


def _brief(value: object) -> str:
    """A value as text: of what is long, deep or holds itself the beginning."""
    if isinstance(value, Mapping | list | tuple):
        return _BEGINNING.repr(dict(value) if isinstance(value, Mapping) else value)
    if isinstance(value, int) and abs(value) > LARGEST:
        return f"{value:#x}"[:40]
    return str(value)


class TorchidError(Exception):
    """Bad input from a user.

    Args:
        problem: one sentence that says what is wrong, naming the file, joint or option.
        got: the offending value.
        expected: what would have been right.
        available: the choices that exist.
        hint: what to do next.

    >>> import torchid
    >>> try:
    ...     torchid.load_robot("3R")
    ... except TorchidError as error:
    ...     print(error.problem)
    unknown robot '3R'.
    """

    def __init__(
        self,
        problem: str,
        *,
        got: object = None,
        expected: object = None,
        available: Sequence[object] | None = None,
        hint: str | None = None,
    ):
        self.problem = problem
        self.got = got
        self.expected = expected
        self.available = list(available) if available is not None else None
        self.hint = hint
        super().__init__(self._text())

    def _text(self) -> str:
        parts = [self.problem]
        if self.got is not None:
            parts.append(f"  got: {_brief(self.got)}")
        if self.expected is not None:
            parts.append(f"  expected: {_brief(self.expected)}")
        if self.available is not None:
            choices = [str(a) for a in self.available]
            # 4: choices of which the nearest need not be told
            near = self._nearest(choices) if len(choices) > 4 else []
            parts += [f"  nearest: {', '.join(near)}"] if near else []
            parts.append(f"  available: {', '.join(choices)}")
        if self.hint is not None:
            parts.append(f"  hint: {self.hint}")
        return visible("\n".join(parts))

    def _nearest(self, choices: list[str]) -> list[str]:
        """The choices that what was got, or a name in the problem, may have meant."""
        named = re.search(r"'([^']+)'", self.problem)
        word = (self.got if isinstance(self.got, str) else named[1] if named else "")[:100]
        within = [c for c in choices if len(word) > 3 and word in c][:2]
        near = get_close_matches(word, choices, n=2, cutoff=0.7)
        return list(dict.fromkeys([*within, *near]))


class RobotError(TorchidError):
    """A robot description that cannot be read or is not a serial manipulator."""


class LogError(TorchidError):
    """A log that cannot be read or cannot be used with this robot."""


class IdentificationError(TorchidError):
    """Data that cannot determine what was asked for."""


class MissingExtraError(TorchidError):
    """An optional package is needed and not installed.

    Args:
        package: the import that failed.
        extra: the torchid extra that brings it.
        purpose: what it is needed for.
    """

    def __init__(self, package: str, extra: str, purpose: str):
        super().__init__(
            f"{purpose} needs the package '{package}', which is not installed.",
            hint=f"pip install 'torchid[{extra}]'",
        )
