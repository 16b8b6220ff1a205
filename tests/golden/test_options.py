"""No command and no option is lost, renamed or given another default unnoticed."""

import copy
import json

import pytest

from tests.golden.options import STORED, differences, table

AGAIN = "meant so? python -m tests.golden.write options"


def stored() -> dict:
    return json.loads(STORED.read_text())


def test_options_are_those_stored() -> None:
    found = differences(stored(), json.loads(json.dumps(table())))
    assert not found, "\n".join([*found, AGAIN])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: t["gap"].pop("--effects"),
         "torchid gap --effects: gone"),
        (lambda t: t["gap"].update({"--more": {}}), "torchid gap --more: new"),
        (lambda t: t["identify"]["--method"].update(default="ols"), "was 'huber', is 'ols'"),
        (lambda t: t.pop("withheld run"), "torchid withheld run: the command is gone"),
    ],
)  # fmt: skip
def test_a_change_is_said(change, said) -> None:
    now = copy.deepcopy(stored())
    change(now)
    (found,) = differences(stored(), now)
    assert said in found
