"""Errors that carry the evidence: what was got, what was expected, what is available.

Every error a user can cause is a TorchidError. The command line prints its text and exits with 1;
a library user can read the parts.
"""

from collections.abc import Sequence


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
            parts.append(f"  got: {self.got}")
        if self.expected is not None:
            parts.append(f"  expected: {self.expected}")
        if self.available is not None:
            parts.append(f"  available: {', '.join(str(a) for a in self.available)}")
        if self.hint is not None:
            parts.append(f"  hint: {self.hint}")
        return "\n".join(parts)


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
