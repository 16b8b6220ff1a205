"""An earlier log beside the one that is asked, by the public functions: new, or in both."""

from functools import cache
from pathlib import Path

import pytest

import torchid
from tests.gap.small_logs import ROBOT, Recording, arm, friction, logged
from torchid.errors import LogError, RobotError, TorchidError
from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.gap.settings import GapSettings
from torchid.log.model import Log
from torchid.robot.model import Robot

pytestmark = pytest.mark.usefixtures("types_unchecked")

SEARCHED = ("viscous_friction", "coulomb_friction", "torque_offset", "joint_spring")
SETTINGS = GapSettings(effects=SEARCHED, parameters="trusted")
MONDAY, FRIDAY = Recording(runs=(0, 1)), Recording(runs=(7, 8))
LACKED = friction(2, Fc=0.8)
CAME = friction(3, Fv=0.8)


@cache
def log_of(robot: Robot, how: Recording) -> Log:
    return logged(robot, how)


def whens(found: TorqueDiagnosis) -> dict[tuple[str, tuple[int, ...]], object]:
    return {(c.effect, c.joints): c.when for c in found.answer.causes}


@cache
def friday() -> TorqueDiagnosis:
    before, now = log_of(arm(LACKED), MONDAY), log_of(arm(LACKED, CAME), FRIDAY)
    return torchid.diagnose(ROBOT, now, before=before, settings=SETTINGS)


def test_a_cause_is_new_or_was_lacking_already() -> None:
    expected = {("coulomb_friction", (1,)): "in both", ("viscous_friction", (2,)): "new"}
    assert whens(friday()) == expected
    # Both are corrections.
    own = {(e["effect"], e["joint"]) for e in friday().corrected.effects}
    assert own == {("coulomb_friction", 2), ("viscous_friction", 3)}


def test_it_is_told_with_the_log_that_it_is_held_against() -> None:
    answer, said = friday().answer, friday().plain()
    assert answer.since
    assert said["since"] == answer.since
    assert {w["effect"]: w["when"] for w in said["which"]} == {
        "coulomb_friction": "in both", "viscous_friction": "new"
    }  # fmt: skip
    # What is new is said first.
    assert f"new since {answer.since}" in answer.headline
    assert answer.headline.startswith("0.8 N m s/rad viscous friction on joint 3 (new since ")
    cells = [row[4] for row in answer.rows()]
    assert any(cell.endswith(", new") for cell in cells)
    assert any(cell.endswith(", in both") for cell in cells)


def test_without_an_earlier_log_nothing_is_said_of_it() -> None:
    found = torchid.diagnose(ROBOT, log_of(arm(CAME), FRIDAY), settings=SETTINGS)
    assert "since" not in found.plain()
    assert all("when" not in w for w in found.plain()["which"])


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model of Monday's log, and that log beside it."""
    path = tmp_path_factory.mktemp("model") / "arm.yaml"
    torchid.diagnose(ROBOT, log_of(arm(LACKED), MONDAY), settings=SETTINGS).write_corrected(path)
    return path


def test_the_log_beside_a_model_is_read(model: Path) -> None:
    now = log_of(arm(LACKED, CAME), FRIDAY)
    found = torchid.diagnose(str(model), now, settings=GapSettings(effects=SEARCHED))
    assert whens(found) == {("viscous_friction", (2,)): "new"}
    assert isinstance(found, TorqueDiagnosis)
    # Its own model holds its own log.
    assert found.rows is not None
    assert set(found.rows.names) == set(now.names)


def test_it_need_not_be_read(model: Path) -> None:
    now = log_of(arm(LACKED, CAME), FRIDAY)
    found = torchid.diagnose(str(model), now, rows=False, settings=GapSettings(effects=SEARCHED))
    assert "since" not in found.plain()
    assert [(c.effect, c.joints) for c in found.answer.causes] == [("viscous_friction", (2,))]


def test_a_damaged_file_is_refused_and_a_missing_one_said(model: Path, tmp_path: Path) -> None:
    now, copy = log_of(arm(LACKED), FRIDAY), tmp_path / "arm.yaml"
    copy.write_bytes(model.read_bytes())
    beside = copy.with_suffix(".rows.npz")
    beside.write_bytes(b"damaged")
    with pytest.raises(RobotError, match="not the file"):
        torchid.diagnose(str(copy), now)
    beside.unlink()
    found = torchid.diagnose(str(copy), now, settings=GapSettings(effects=SEARCHED))
    assert any(w.startswith("Caution") and "arm.rows.npz" in w for w in found.warnings)


def test_what_is_no_earlier_log_is_refused() -> None:
    log = log_of(arm(LACKED), MONDAY)
    with pytest.raises(LogError, match="in the earlier log"):
        torchid.diagnose(ROBOT, log, before=log)
    commands = log.replace(tau=None, u=log.q)
    with pytest.raises(LogError, match="no torque"):
        torchid.diagnose(ROBOT, log, before=commands)
    with pytest.raises(TorchidError, match="before"):
        torchid.diagnose(ROBOT, commands, before=log)
