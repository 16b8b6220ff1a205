"""Every notebook runs from top to bottom on small data and leaves the repository as it was."""

import os
import shutil
from pathlib import Path

import pytest
from _pytest.mark import ParameterSet

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))
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


IN_CI = ("03",)
"""A gap of torque, which identifies first; the others are nightly."""


def _marked(path: Path) -> ParameterSet:
    mark = pytest.mark.slow if path.stem.startswith(IN_CI) else pytest.mark.nightly
    return pytest.param(path, marks=mark)


@pytest.mark.parametrize("path", list(map(_marked, NOTEBOOKS)), ids=lambda path: path.stem)
def test_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    for name, value in SMALL.items():
        monkeypatch.setitem(os.environ, name, value)
    # Results of a notebook go to a temporary folder of its own, which is not left behind either.
    monkeypatch.setitem(os.environ, "TMPDIR", str(tmp_path))
    copy = Path(shutil.copy(path, tmp_path))
    notebook = nbformat.read(copy, as_version=4)
    # The kernel works in a folder of its own, so what a notebook writes stays out of here.
    client = nbclient.NotebookClient(
        notebook, timeout=600, kernel_name="python3", resources={"metadata": {"path": tmp_path}}
    )
    client.execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    text = "".join(output.get("text", "") for output in outputs)
    assert "from torchid." not in "".join(cell.source for cell in notebook.cells), "inner rooms"
    for words in SAID[path.stem]:
        assert words in text


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_committed_without_outputs(path: Path) -> None:
    """Outputs would be old numbers beside new code, and large."""
    nbformat = pytest.importorskip("nbformat")
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert code
    assert not any(cell.outputs or cell.execution_count for cell in code)
