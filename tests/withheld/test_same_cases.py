"""Cases of a seed stay what they were, bit for bit: sets that were scored can be made again."""

import hashlib
import json
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mujoco")

import mujoco
import pyarrow.parquet as pq

from torchid.json_data import plain
from torchid.withheld.case_set import LOG, ROBOT, write_case

SEED = 101

MADE_WITH = "4.0.0", "2.4"
"""MuJoCo and NumPy whose last bits these are."""

CASES: dict[str, tuple[dict[str, Any], str]] = {
    "torque, drawn": ({"number": 0}, "b9b91030a86c181f"),
    "torque, one": (
        {"number": 1, "kind": "single", "effects": ["coulomb_friction"]},
        "40ecc0058feadba4",
    ),
    "torque, release": ({"number": 2, "mix": "release"}, "dd756363b64fbd9d"),
    "torque, poor": ({"number": 3, "kind": "poor"}, "fb915d12d10d7ccb"),
    "torque, several": ({"number": 4, "kind": "several"}, "62ec3e4e34d1ec70"),
    "servos, drawn": ({"number": 0, "mix": "position"}, "3f65aa76f15507cd"),
    "servos, one": ({"number": 1, "mix": "position", "kind": "single"}, "a4af1438ce15e6d8"),
    "servos, several": ({"number": 2, "mix": "position", "kind": "several"}, "ebd4e477b90bf35b"),
    "servos, a spring": (
        {"number": 3, "mix": "position", "effects": ["backlash"]},
        "c192e4d78e28070a",
    ),
    "servos, a load": (
        {"number": 4, "mix": "position", "effects": ["payload"]},
        "322db7608ccb2870",
    ),
}


@pytest.mark.skipif(
    not mujoco.__version__.startswith(MADE_WITH[0]) or not np.__version__.startswith(MADE_WITH[1]),
    reason="another simulator rounds otherwise",
)
@pytest.mark.usefixtures("types_unchecked")
@pytest.mark.parametrize("name", CASES)
def test_a_case_is_the_one_that_it_was(name, tmp_path):
    given, known = CASES[name]
    place = tmp_path / "case-0001"
    key = write_case(place, SEED, arm="3r", **given)
    log = pq.read_table(place / LOG)
    digest = hashlib.sha256((place / ROBOT).read_bytes())
    for column in log.column_names:
        digest.update(column.encode() + log[column].to_numpy().tobytes())
    digest.update(json.dumps(plain(key), sort_keys=True).encode())
    assert digest.hexdigest()[:16] == known
