"""Effects as they are written on one line: name:key=value,key=value."""

from typing import Any

from torchid.effects.base import PLACES
from torchid.errors import TorchidError


def split_list(text: str) -> tuple[str, ...]:
    """Effects separated by commas, which also separate the keys of one; `none` for none.

    >>> split_list("viscous_friction, joint_spring:joint=2,curvature=0, cogging")
    ('viscous_friction', 'joint_spring:joint=2,curvature=0', 'cogging')
    """
    if text.strip() in ("", "none"):
        return ()
    out: list[str] = []
    for part in (p.strip() for p in text.split(",")):
        if out and ":" in out[-1] and ":" not in part and "=" in part:
            out[-1] += f",{part}"
        else:
            out.append(part)
    return tuple(out)


def name_and_pairs(text: str, what: str) -> tuple[str, dict[str, Any]]:
    """Name of an effect, and its values by key; joints stay as written, from 1.

    Args:
        text: `name` or `name:key=value,key=value`.
        what: what to call it in errors, e.g. `--effect`.

    Raises:
        TorchidError: an item without a value, a key twice, a value that is no number.
    """
    name, _, rest = text.partition(":")
    pairs: dict[str, Any] = {}
    for item in filter(None, (part.strip() for part in rest.split(","))):
        key, equals, value = (part.strip() for part in item.partition("="))
        if not equals or key in pairs:
            raise TorchidError(
                f"{what} {text}: cannot be read at '{item}'.",
                expected="name:key=value,key=value, each key once",
            )
        try:
            number = float(value)
        except ValueError:
            raise TorchidError(f"{what} {text}: {key} is not a number.", got=value) from None
        whole = key in (*PLACES, "seed") and number.is_integer()
        pairs[key] = int(number) if whole else number
    return name.strip(), pairs
