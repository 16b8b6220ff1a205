"""Cases of a seed stay what they were, to five digits: sets that were scored can be made again."""

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
"""MuJoCo and NumPy that these were made with."""

CASES: dict[str, tuple[dict[str, Any], str]] = {
    "torque, drawn": ({"number": 0}, "6fa770885a47a5b8"),
    "torque, one": (
        {"number": 1, "kind": "single", "effects": ["coulomb_friction"]},
        "e2b8f6db3b914ac2",
    ),
    "torque, release": ({"number": 2, "mix": "release"}, "cee68f8b0453f9f8"),
    "torque, poor": ({"number": 3, "kind": "poor"}, "ed3a4424cad36669"),
    "torque, several": ({"number": 4, "kind": "several"}, "804013e9d610cdb5"),
    "servos, drawn": ({"number": 0, "mix": "position"}, "247353195db6e402"),
    "servos, one": ({"number": 1, "mix": "position", "kind": "single"}, "67223947f2157532"),
    "servos, several": ({"number": 2, "mix": "position", "kind": "several"}, "2d647b73811dcfc7"),
    "servos, a spring": (
        {"number": 3, "mix": "position", "effects": ["backlash"]},
        "2549276ccf1fe2c4",
    ),
    "servos, a load": (
        {"number": 4, "mix": "position", "effects": ["payload"]},
        "4f4a2b5876a5f300",
    ),
}


@pytest.mark.skipif(
    not mujoco.__version__.startswith(MADE_WITH[0]) or not np.__version__.startswith(MADE_WITH[1]),
    reason="another simulator rounds otherwise",
)
@pytest.mark.usefixtures("types_unchecked")
@pytest.mark.parametrize(
    "name",
    [n if n.endswith("drawn") else pytest.param(n, marks=pytest.mark.slow) for n in CASES],
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
    digest = hashlib.sha256((place / ROBOT).read_bytes() + text.encode())
    assert digest.hexdigest()[:16] == known


def rounded(value: Any) -> Any:
    """Five digits of each number: the last bits differ between processors."""
    if isinstance(value, dict):
        return {name: rounded(one) for name, one in value.items()}
    if isinstance(value, list):
        return [rounded(one) for one in value]
    return float(f"{value:.5g}") if isinstance(value, float) else value
