"""All that a command writes has its names at once, at its end: stopped before, nothing is there."""

import json
import os

import pytest

from tests.app.test_check_command import sets_file
from tests.gap.small_logs import ROBOT, Recording, arm, friction, logged, true_motion
from tests.marks import quick_first
from torchid import files
from torchid.gap.diagnose import diagnose
from torchid.gap.settings import GapSettings
from torchid.log.readers import write_log

SEARCHED = "--effects coulomb_friction"
COMMANDS = {
    "robot": "robot 3r --out out",
    "export": "export 3r_friction --to urdf --out out",
    "export here": "export 3r_friction --to mjcf",
    "export of c": "export 3r_friction --to c --out out",
    "check": "check SETS --robot 3r --nearest near.json --out out",
    "simulate": "simulate 3r MOTION --save log.csv --out out",
    "doctor": "log doctor 3r LOG --apply mended.csv --out out --pictures",
    "show": "log show LOG --save seen.csv --plot seen.png --json seen.json",
    "pair": "pair --simulated LOG --real LOG --out out",
    "correct": f"correct 3r LOG --to mjcf --with-effects --out out {SEARCHED}",
    "identify": f"identify 3r LOG --out out --pictures {SEARCHED}",
    "randomise": "export GAP --randomise .9 --draws 16 --out out",
    "actuator": f"correct 3r LOG --to mjlab --with-effects --out out {SEARCHED}",
    "gap": f"gap 3r LOG --out out --pictures --save-model a.yaml {SEARCHED}",
    "fleet": f"fleet identify 3r LOG MOTION --store s --out out {SEARCHED}",
    "excite": "excite 3r --restarts 1 --duration 4 --save t.csv --ros2 r.json --out out",
    "extract": "extract 3r --runs 2 --stages 1 --generations 1 --no-certificate --out out",
}
"""Quick ones first."""
QUICK = 9


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """Inputs, by their names in the command lines."""
    folder = tmp_path_factory.mktemp("given")
    how = Recording((0, 1), duration=4.0)
    log = logged(arm(friction(2, Fc=1.0)), how)
    paths = {
        "LOG": folder / "log.parquet",
        "MOTION": folder / "motion.csv",
        "GAP": folder / "gap.json",
    }
    write_log(log, paths["LOG"])
    write_log(true_motion(how).replace(tau=log.tau), paths["MOTION"])
    diagnose(ROBOT, log, settings=GapSettings(effects=("coulomb_friction",))).save(paths["GAP"])
    return paths | {"SETS": sets_file(folder / "sets.json")}


def visible(folder) -> set[str]:
    found = [os.path.join(path, name) for path, _, names in os.walk(folder) for name in names]
    return {os.path.relpath(name, folder) for name in found if "/.torchid-" not in name}


@pytest.mark.parametrize("name", quick_first(COMMANDS, QUICK))
def test_nothing_has_a_name_before_all_is_written(
    name, command, given, tmp_path, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    before, sets = [], []
    place = files.put_in_place

    def watched(staged: files.Staged) -> None:
        if staged:
            before.append(visible(tmp_path))
            sets.append({os.path.relpath(path, tmp_path) for path in staged})
        place(staged)

    monkeypatch.setattr("torchid.app.output.put_in_place", watched)
    done = command(*(str(given.get(word, word)) for word in COMMANDS[name].split()))
    assert done.code == 0, done.err
    found = {path for path in visible(tmp_path) if not path.startswith("s/")}  # the store
    assert [{path for path in paths if not path.startswith("s/")} for paths in before] == [set()]
    # Besides there may be a sidecar that an earlier run had left.
    assert found == {path for path in sets[0] if (tmp_path / path).exists()}
    for path in [path for path in found if path.endswith(".json")]:
        said = json.loads((tmp_path / path).read_text()).get("hashes", {})
        hashes = {os.path.basename(p): files.file_hash(tmp_path / p) for p in found}
        assert said == {} or said.items() <= hashes.items()
        if COMMANDS[name].startswith(("export", "correct")):
            assert set(said) == {os.path.basename(p) for p in found} - {os.path.basename(path)}
