"""Cases of a seed stay what they were, to five digits: sets that were scored can be made again."""

import hashlib
import json
import re
from typing import Any

import mujoco
import numpy as np
import pyarrow.parquet as pq
import pytest

from tests.marks import some
from torchid.json_data import plain
from torchid_bench.withheld.case_set import LOG, ROBOT, write_case

SEED = 101

NUMBER = re.compile(r"-?\d+\.\d+(?:e-?\d+)?")

MADE_WITH = "4.0.0", "2.4"
"""MuJoCo and NumPy that these were made with."""

CASES: dict[str, tuple[dict[str, Any], str]] = {
    "torque, drawn": ({"number": 0}, "a2cea1fba2211883"),
    "torque, one": (
        {"number": 1, "kind": "single", "effects": ["coulomb_friction"]},
        "6576e40ba72d4dd2",
    ),
    "torque, release": ({"number": 2, "mix": "release"}, "cc1ec822d95b75fb"),
    "torque, poor": ({"number": 3, "kind": "poor"}, "991d2ee79e3dc014"),
    "torque, several": ({"number": 4, "kind": "several"}, "72f501ec1d54955c"),
    "servos, drawn": ({"number": 0, "mix": "position"}, "81a8fdbe5ddfb34f"),
    "servos, one": ({"number": 1, "mix": "position", "kind": "single"}, "4d37de35c993bb87"),
    "servos, several": ({"number": 2, "mix": "position", "kind": "several"}, "8385f101dfcee24a"),
    "servos, a spring": (
        {"number": 3, "mix": "position", "effects": ["backlash"]},
        "afbd37b5ebd2327e",
    ),
    "servos, a load": (
        {"number": 4, "mix": "position", "effects": ["payload"]},
        "1523a427476b5c66",
    ),
}


@pytest.mark.slow
@pytest.mark.skipif(
    not mujoco.__version__.startswith(MADE_WITH[0]) or not np.__version__.startswith(MADE_WITH[1]),
    reason="another simulator rounds otherwise",
)
@pytest.mark.usefixtures("types_unchecked")
@pytest.mark.parametrize(
    "name",
    some(sorted(CASES, key=lambda name: not name.endswith("drawn")), 1, 1),
)
def test_a_case_is_the_one_that_it_was(name, tmp_path):
    given, known = CASES[name]
    place = tmp_path / "case-0001"
    key = write_case(place, SEED, arm="3r", **given)
    log = pq.read_table(place / LOG)
    sizes = {
        column: float(np.linalg.norm(log[column].to_numpy().astype(float)))
        for column in log.column_names
    }
    text = json.dumps(rounded({"key": plain(key), "log": sizes}), sort_keys=True)
    robot = NUMBER.sub(lambda x: f"{round(float(x[0]), 9):.5g}", (place / ROBOT).read_text())
    digest = hashlib.sha256((robot + text).encode())
    assert digest.hexdigest()[:16] == known


def rounded(value: Any) -> Any:
    """Five digits of each number: the last bits differ between processors."""
    if isinstance(value, dict):
        return {name: rounded(one) for name, one in value.items()}
    if isinstance(value, list):
        return [rounded(one) for one in value]
    return float(f"{value:.5g}") if isinstance(value, float) else value
