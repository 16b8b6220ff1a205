"""An earlier log beside the one that is asked, by the public functions: new, or in both."""

import hashlib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from msgspec import UNSET

import torchid
from tests.gap.small_logs import NOISE, ROBOT, Recording, arm, friction, logged, true_motion
from tests.marks import quick_first
from torchid.doctor.first import WrongLogError
from torchid.errors import LogError, RobotError, TorchidError
from torchid.excitation.synthetic import synthetic_log
from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.gap.settings import GapSettings
from torchid.log.model import Log
from torchid.robot.model import Robot
from torchid.simulation.sensors import Sensors, measured_log

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
    new, lacking, *_ = answer.headline.split(". ")
    assert new == f"New since {answer.since}: 0.8 N m s/rad viscous friction on joint 3"
    assert lacking.startswith(f"Lacking already in {answer.since}: ")
    assert "Coulomb friction on joint 2" in lacking
    cells = [row[4] for row in answer.rows()]
    assert any(cell.endswith(", new") for cell in cells)
    assert any(cell.endswith(", lacking already") for cell in cells)


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


# What an earlier log is asked before anything is held against it.


def is_left_out(found: TorqueDiagnosis, alone: TorqueDiagnosis, source: str) -> None:
    """It says so first, and has the causes of the log without an earlier one."""
    assert found.warnings[0].startswith(
        f"Earlier log left out, so that nothing counts as new: {source}"
    )
    assert "since" not in found.plain()
    assert [(c.effect, c.joints, c.parameters) for c in found.answer.causes] == [
        (c.effect, c.joints, c.parameters) for c in alone.answer.causes
    ]


def scaled(log: Log, factor: float) -> Log:
    assert log.tau is not None
    return log.replace(tau=factor * log.tau)


def standing(log: Log) -> Log:
    """An arm that is held at its first pose."""
    q = log.q[:1].expand_as(log.q)
    none = torch.zeros_like(q)
    noise = torch.randn(q.shape, generator=torch.Generator().manual_seed(0)).double()
    tau = torchid.inverse_dynamics(ROBOT, q, none, none) + NOISE * noise
    return log.replace(q=q, dq=None, tau=tau)


def held_constant(log: Log) -> Log:
    """Of a joint whose torque is not measured."""
    assert log.tau is not None
    tau = log.tau.clone()
    tau[:, 1] = 3.0
    return log.replace(tau=tau)


ODD = {
    "permille": lambda log: scaled(log, 20.0),
    "a twentieth": lambda log: scaled(log, 0.05),
    "standing": standing,
    "of another robot": lambda log: log.replace(tau=log.tau.flip(0)),
    "a joint constant": held_constant,
}
NO_MODEL = replace(ROBOT, parameters=None)
AUTO = GapSettings(effects=SEARCHED)


@cache
def friday_alone(robot: str) -> TorqueDiagnosis:
    """Of the 3R as a file has it, or without its parameters."""
    simulator = {"a model": ROBOT, "no model": NO_MODEL}.get(robot, robot)
    now = log_of(arm(LACKED, CAME), FRIDAY)
    found = torchid.diagnose(simulator, now, rows=False, settings=AUTO)
    assert isinstance(found, TorqueDiagnosis)
    return found


@pytest.mark.parametrize(
    ("odd", "robot"), [*((odd, "a model") for odd in ODD), ("permille", "no model")]
)
def test_an_earlier_log_of_another_torque_is_left_out_and_that_is_said_first(odd, robot) -> None:
    before = ODD[odd](log_of(arm(LACKED), MONDAY))
    simulator = ROBOT if robot == "a model" else NO_MODEL
    now = log_of(arm(LACKED, CAME), FRIDAY)
    found, alone = (
        torchid.diagnose(simulator, now, before=before, settings=AUTO),
        friday_alone(robot),
    )
    assert len(alone.answer.causes) == 2
    is_left_out(found, alone, "run0 and 1 more")


def test_a_wrong_earlier_log_is_refused_as_the_one_that_is_asked() -> None:
    monday = log_of(arm(LACKED), MONDAY)
    turned = monday.replace(tau=monday.tau * torch.tensor([1.0, -1.0, 1.0]).double())
    with pytest.raises(WrongLogError, match="torque sign of joint 2"):
        torchid.diagnose(ROBOT, log_of(arm(LACKED), FRIDAY), before=turned, settings=SETTINGS)


def with_rows_scaled(model: Path, folder: Path, factor: float) -> Path:
    """The model, with rows whose torque is so many times its own."""
    path, own = folder / "arm.yaml", model.with_suffix(".rows.npz")
    with np.load(own) as held:
        arrays = dict(held)
    arrays["tau"] = (factor * arrays["tau"]).astype(np.float32)
    other = path.with_suffix(".rows.npz")
    np.savez(other, **arrays)
    old, new = (hashlib.sha256(p.read_bytes()).hexdigest() for p in (own, other))
    path.write_text(model.read_text().replace(old, new))
    return path


@pytest.mark.parametrize("factor", quick_first([100.0, 0.05, 1.3], 2))
def test_rows_that_their_own_model_does_not_explain_are_left_out(
    factor: float, model: Path, tmp_path: Path
) -> None:
    path = with_rows_scaled(model, tmp_path, factor)
    found = torchid.diagnose(str(path), log_of(arm(LACKED, CAME), FRIDAY), settings=AUTO)
    alone = friday_alone(str(model))
    assert [(c.effect, c.joints) for c in alone.answer.causes] == [("viscous_friction", (2,))]
    is_left_out(found, alone, "run0 and 1 more")


def test_rows_of_five_per_cent_more_torque_are_within_what_a_model_errs_by(
    model: Path, tmp_path: Path
) -> None:
    path = with_rows_scaled(model, tmp_path, 1.05)
    found = torchid.diagnose(str(path), log_of(arm(LACKED, CAME), FRIDAY), settings=AUTO)
    assert whens(found)["viscous_friction", (2,)] == "new"


def test_what_the_earlier_log_does_not_show_is_neither_new_nor_in_both() -> None:
    """On Monday joint 2 alone moved."""
    motion = true_motion(MONDAY)
    alone = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
    motion = motion.replace(**{k: x * alone for k, x in motion.signals.items()})
    true = synthetic_log(arm(LACKED), motion)
    before = measured_log(ROBOT, true, [], Sensors(torque_std=NOISE), 0)
    now = log_of(arm(LACKED, CAME), FRIDAY)
    found = torchid.diagnose(ROBOT, now, before=before, settings=SETTINGS)
    expected = {("coulomb_friction", (1,)): "in both", ("viscous_friction", (2,)): UNSET}
    assert whens(found) == expected
