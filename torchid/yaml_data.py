"""Yaml texts as plain data: by libyaml, where it is there, ten times as fast as by Python."""

from typing import Any

import yaml

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

DEEPEST = 100
"""Lists and mappings inside of each other: libyaml takes some ten thousand, and then ends the
process."""


def parsed_yaml(text: str) -> Any:
    """The content of a yaml text.

    Raises:
        RecursionError: nested more than `DEEPEST` times.
        yaml.YAMLError: no yaml.
    """
    depth = 0
    for event in yaml.parse(text, Loader=_LOADER):
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST:
            raise RecursionError("nested too deeply")
    return yaml.load(text, Loader=_LOADER)
