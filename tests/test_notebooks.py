"""Every notebook runs from top to bottom on small data, leaves the repository as it was, and stands
there with its outputs."""

import os
import re
from pathlib import Path
from typing import Any

import pytest

import torchid

FOLDER = Path(__file__).parents[1] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
SMALL = {
    "TORCHID_NOTEBOOK_SETS": "15",
    "TORCHID_NOTEBOOK_RESAMPLES": "20",
    "OMP_NUM_THREADS": "1",
    "OMP_WAIT_POLICY": "passive",
}


SAID = {
    "01_identify_the_3r": ("30 parameters, 15 independent combinations",),
    "02_feasible_sets_and_wrenches": ("30 parameters; 15 of them base; 15 unseen",),
    "03_diagnose_a_gap": ("seal unbroken: True", " right\n", "not_testable", "this table: True"),
    "04_your_own_robot": (
        "Wrong: torque sign.",
        "joint [2] has cogging",
        "written: identified.urdf",
    ),
    "05_correct_a_simulator": ("65 % of it is kept", "\nexplained\n"),
    "06_your_so101": (
        "explained\n",
        "set_point_profile joint 2 ['acceleration 4",
        "end_stop joint 3 ['stop_high 0.25']",
        "left open: nothing",
    ),
    "07_sessions_add_up": (
        "than on Monday: True",
        "no_gap []",
        "payload of joint",
        "viscous_friction Fv2: was 0.",
    ),
    "08_two_arms": (
        "8 coordinates:",
        "within 5 %: True",
        "link_inertia ['right_elbow_joint']",
        "coulomb_friction ['left_shoulder_joint']",
    ),
}
"""What the words around the cells rest on."""


LARGEST = 2_000_000
"""Bytes of all notebooks."""


@pytest.mark.nightly
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("nbclient")
    from tests.notebooks import executed

    for name, value in SMALL.items():
        monkeypatch.setitem(os.environ, name, value)
    # Results of a notebook go to a temporary folder of its own, which is not left behind either.
    monkeypatch.setitem(os.environ, "TMPDIR", str(tmp_path))
    notebook = executed(path, tmp_path)
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert "from torchid." not in "".join(cell.source for cell in notebook.cells), "inner rooms"
    for words in SAID[path.stem]:
        assert words in text_of(notebook)


def text_of(notebook: Any) -> str:
    """All that its cells printed."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    return "".join(output.get("text", "") for output in outputs)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_stored_with_the_outputs_of_one_run(path: Path) -> None:
    nbformat = pytest.importorskip("nbformat")
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    for cell in code:
        compile(cell.source, path.name, "exec")
        for name in re.findall(r"\btorchid\.(\w+)", cell.source):
            assert hasattr(torchid, name), name
    outputs = [output for cell in code for output in cell.outputs]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert not any(x.output_type == "error" or x.get("name") == "stderr" for x in outputs)
    for words in SAID[path.stem]:
        assert words in text_of(notebook), "run `make notebooks`"


def test_stored_outputs_are_light_and_of_no_machine_or_day() -> None:
    assert sum(path.stat().st_size for path in NOTEBOOKS) < LARGEST
    for path in NOTEBOOKS:
        for line in path.read_text().splitlines():
            if '"image/png"' not in line:
                assert not re.search(r"(?<![\w.])/(home|tmp|root|work|usr|Users|opt)/", line), line
                assert not re.search(r"\b20\d\d-\d\d-\d\d", line), line
