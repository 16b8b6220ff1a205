"""Yaml is read as Python reads it, and what is nested too deeply is refused."""

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from tests.documents import ROOT
from torchid.yaml_data import DEEPEST, parsed_yaml

DATA = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=20,
)


@given(DATA)
def test_anything_written_is_read_back(data) -> None:
    assert parsed_yaml(yaml.safe_dump(data)) == data


@pytest.mark.parametrize("path", sorted((ROOT / "configs").rglob("*.yaml")), ids=lambda p: p.stem)
def test_our_files_are_read_as_python_reads_them(path) -> None:
    assert parsed_yaml(path.read_text()) == yaml.safe_load(path.read_text())


@pytest.mark.parametrize("text", ["[" * 100_000, "a: " + "{a: " * 100_000, "- " * 20_000 + "1"])
def test_what_is_nested_too_deeply_is_refused(text) -> None:
    with pytest.raises(RecursionError):
        parsed_yaml(text)
    parsed_yaml("[" * (DEEPEST - 1) + "]" * (DEEPEST - 1))


@pytest.mark.parametrize("text", ["a: [1", "!!python/object:os.system {}", "a: b: c", "\t- 1"])
def test_what_is_no_yaml_is_an_error(text) -> None:
    with pytest.raises(yaml.YAMLError):
        parsed_yaml(text)
