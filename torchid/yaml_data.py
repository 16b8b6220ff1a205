"""Yaml texts as plain data: by libyaml, where it is there, ten times as fast as by Python."""

from typing import Any

import yaml

DEEPEST = 100
"""Lists and mappings inside of each other: libyaml takes some ten thousand, and then ends the
process."""


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        """Merge what a mapping merges, which yaml does a level at a time."""
        own = len(node.value)
        super().flatten_mapping(node)
        # Keys that merges (<<) may make of a mapping: each of a chain of them multiplies their
        # number
        most_merged = 10_000
        if len(node.value) > max(own, most_merged):
            raise yaml.YAMLError(f"merges (<<) make more than {most_merged} keys")


def parsed_yaml(text: str) -> Any:
    """The content of a yaml text.

    Raises:
        RecursionError: nested more than `DEEPEST` times.
        yaml.YAMLError: no yaml.
    """
    depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST:
            raise RecursionError("nested too deeply")
    return yaml.load(text, Loader=_Loader)
