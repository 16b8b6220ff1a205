"""What `make bench` says became slower."""

import json
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture
def ratios() -> ModuleType:
    return import_module("torchid_bench.benchmarks.ratios")


def test_what_fell_by_more_than_a_fifth_is_said(ratios: ModuleType) -> None:
    committed = {"a": 2.0, "b": 2.0}
    assert ratios.slower({"a": 1.7, "b": 9.0, "new": 0.1}, committed) == []
    assert ratios.slower({"a": 1.5, "b": 2.0}, committed) == ["slower: a: 1.50, and 2.00 before"]


def test_ratios_are_of_medians_a_call(ratios: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """A peer that does two things in 6 s, and torchid that does three in 1.5 s; once it is
    disturbed."""
    took = {"peer": [1, 6, 6, 60], "ours": [1, 1.5, 1.5, 1.5]}
    now = 0.0

    def works(name: str) -> None:
        nonlocal now
        now += took[name].pop(0)

    monkeypatch.setattr(ratios.time, "process_time", lambda: now)
    line = ("", lambda: works("peer"), 2, lambda: works("ours"), 3)
    assert ratios.ratio(line, 3) == pytest.approx((3e6, 0.5e6, 6.0))


def test_every_committed_ratio_is_of_a_line(ratios: ModuleType) -> None:
    source = Path(str(ratios.__file__)).read_text()
    for name in json.loads(ratios.COMMITTED.read_text()):
        assert name.rpartition(" / ")[2] in source
        assert name.partition(",")[0] in source
