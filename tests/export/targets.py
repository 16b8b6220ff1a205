"""Environments of the packages that exports are for: TORCHID_TARGET_MJLAB=/path/to/python."""

import pytest

from torchid_bench.benchmarks.targets import play


def python_of(target: str) -> str:
    """The target's interpreter; skips a test where there is none."""
    python = play.python_of(target)
    if python is None:
        pytest.skip(f"no environment of {target}: TORCHID_TARGET_{target.upper()} names its python")
    return python
