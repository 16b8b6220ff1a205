"""Files before they are kept, and the verdict on them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from torchid.effects.registry import Valued
from torchid.errors import TorchidError
from torchid.export.checks import Comparison


@dataclass(frozen=True, eq=False)
class Draft:
    """What an export writes.

    Attributes:
        files: content by name, the main file first; None for one that must not be there.
        in_file, beside, left_out: effects that the format knows, that go into the sidecar, and that
            go nowhere.
        notes: sentences for the user.
    """

    files: Mapping[str, bytes | None]
    in_file: tuple[Valued, ...] = ()
    beside: tuple[Valued, ...] = ()
    left_out: tuple[Valued, ...] = ()
    notes: tuple[str, ...] = ()


def kept(comparisons: Sequence[Comparison]) -> tuple[Comparison, ...]:
    """The comparisons, or a TorchidError where one fails."""
    for one in comparisons:
        if not one.ok:
            raise TorchidError(
                "what was written does not reproduce the result, so nothing was kept.",
                got=f"{one.reader}: {one.compared} differs by {one.difference:.3g}"
                + (f" ({one.note})" if one.note else ""),
                expected=f"at most {one.limit:g} of each joint's largest torque",
            )
    return tuple(comparisons)
