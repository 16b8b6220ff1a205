"""What settles a question that no motion of the bare arm does."""

from collections.abc import Iterable

from torchid.effects.inertia import WEIGHED
from torchid.effects.registry import KINDS

_FITTED = "take it from the maker's data, or trust the inertial parameters and diagnose again"


def beyond(names: Iterable[str]) -> str:
    """What else would tell these effects, in one sentence; refitted base parameters (`all_base`)
    are bodies too."""
    advice: dict[str, list[str]] = {}
    for name in dict.fromkeys(names):
        kind = KINDS.get(name)
        own = kind.beyond if kind is not None else WEIGHED if name == "all_base" else None
        advice.setdefault(own or _FITTED, []).append(name)
    return "; ".join(f"{', '.join(own)}: {text}" for text, own in advice.items())
