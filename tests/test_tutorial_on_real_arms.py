"""The tutorial's lines, word by word, on real logs: an arm of servos and one with currents."""

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.documents import ROOT, blocks
from tests.real_logs import FOLDER, NEEDS_LOGS
from tests.shell import Shell, shell

pytestmark = [pytest.mark.slow, *NEEDS_LOGS]
TUTORIAL = ROOT / "docs/tutorial.md"
SERVO_RUNS = ("multisine", "reaching_points", "step_response", "prbs_excitation")
GAIN = " --gain 14.87,13.26,11.13,10.62,11.03,11.47"


@pytest.fixture(scope="module")
def so101(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shell]:
    folder = tmp_path_factory.mktemp("so101")
    source = FOLDER / "so101"
    shutil.copy(source / "so101_new_calib.urdf", folder / "so101.urdf")
    for k, name in enumerate(SERVO_RUNS, start=1):
        shutil.copy(source / f"{name}.parquet", folder / f"run{k}.parquet")
    with shell(folder) as place:
        yield place


def _block(page: Path, beginning: str) -> str:
    (found,) = [b for b in blocks(page, "") if b.lstrip().startswith(beginning)]
    return found


@pytest.mark.nightly
def test_an_arm_of_servos(so101: Shell) -> None:
    lines = _block(TUTORIAL, "torchid gap so101.urdf").strip().splitlines()
    assert len(lines) == 3
    for line in lines:
        so101.run(line)
    for name in ("so101.yaml", "simulated/run4.parquet"):
        assert (so101.folder / name).stat().st_size > 0, name
    assert list((so101.folder / "simulator").glob("*.xml"))


@pytest.mark.nightly
def test_a_motion_that_tells_no_unit_is_exported(so101: Shell) -> None:
    """The first run alone says nothing of the jaw's unit, which the saved servos know."""
    so101.run("torchid export so101.yaml --log run1.parquet --to mjcf --out alone")
    assert list((so101.folder / "alone").glob("*.xml"))


def test_an_arm_with_currents(tmp_path: Path) -> None:
    """Its URDF keeps the meshes of the file that was diagnosed, with nothing said of it again."""
    source = FOLDER / "ur10e"
    shutil.copy(source / "robot.urdf", tmp_path / "my_arm.urdf")
    for k, name in enumerate(("est_30s_12harm", "val_ptp10"), start=1):
        shutil.copy(source / f"log_{name}.parquet", tmp_path / f"run{k}.parquet")
    logs = "run1.parquet run2.parquet"
    with shell(tmp_path) as place:
        place.run("torchid robot my_arm.urdf; torchid log show run1.parquet")
        place.run(f"torchid log doctor my_arm.urdf {logs}{GAIN}")
        place.run(f"torchid identify my_arm.urdf {logs}{GAIN} --out result")
        place.run(
            f"torchid gap my_arm.urdf {logs}{GAIN} --effects viscous_friction,coulomb_friction "
            "--out gap --save-model corrected.yaml"
        )
        for line in re.findall(
            r"^(torchid export corrected.yaml --to urdf) ", TUTORIAL.read_text(), re.M
        ):
            place.run(f"{line} --out exported")
    (written,) = (tmp_path / "exported").glob("*.urdf")
    text, given = written.read_text(), (tmp_path / "my_arm.urdf").read_text()
    assert text.count("<mesh") == given.count("<mesh") > 0
    for name in re.findall(r'<link name="([^"]+)"', given):
        assert f'<link name="{name}"' in text, name
