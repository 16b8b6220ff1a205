"""Seeds of nightly tests: others each night, the same again with that night's TORCHID_SEED."""

import os

NIGHT = int(os.environ.get("TORCHID_SEED", "0"))
"""Of the day, as `make nightly` sets it: 20261126; 0 by day."""


def seeds_of_the_night(count: int) -> range:
    """Seeds that no other night draws."""
    first = 1000 * (NIGHT % 100_000)
    return range(first, first + count)
