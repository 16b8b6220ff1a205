"""Held-out errors on logs of real arms, which are not part of the project."""

from dataclasses import dataclass, replace
from functools import lru_cache

import pytest
import torch

from tests.real_logs import FOLDER, NEEDS_LOGS
from torchid.identification.identify import Identification, Settings, identify
from torchid.identification.payload import estimate_payload
from torchid.log.model import Log
from torchid.log.readers import read_log
from torchid.robot.library import load_robot

pytestmark = NEEDS_LOGS


@dataclass(frozen=True)
class Line:
    """One line of figure 3: relative errors [%] to reach, all rows or moving ones."""

    folder: str
    robot: str
    train: tuple[str, ...]
    test: tuple[str, ...]
    cutoff: float
    expected: tuple[float, ...]
    gains: tuple[float, ...] = ()
    held_out_fraction: float = 0.0

    @property
    def moving(self) -> bool:
        return self.folder == "ur10e"

    @property
    def settings(self) -> Settings:
        rows = "moving" if self.moving else "all"
        return Settings(cutoff=self.cutoff, rows=rows, held_out_fraction=self.held_out_fraction)


UR10E = {
    "folder": "ur10e",
    "robot": "robot.urdf",
    "train": ("est_30s_12harm", "exc_40s_12harm"),
    "cutoff": 20.0,
    "gains": (14.87, 13.26, 11.13, 10.62, 11.03, 11.47),
}

LINES = {
    "panda_gaz": Line(
        "panda_gaz", "robot.yaml", ("exciting_traj1",), (), 8.0,
        (6.1, 0.8, 1.1, 0.8, 8.3, 2.3, 13.1), held_out_fraction=0.4,
    ),
    "ur10e_ptp": Line(test=("val_ptp10",), expected=(8.5, 4.2, 3.7, 5.2, 7.7, 6.6), **UR10E),
    "ur10e_exc": Line(test=("exc_20s_8harm",), expected=(7.8, 5.4, 5.2, 5.8, 8.2, 7.0), **UR10E),
    "ur10_unisa": Line(
        "ur10_unisa", "robot.yaml", ("exciting",), (), 2.0,
        (5.9, 6.4, 3.2, 6.5, 7.2, 35.3), held_out_fraction=0.4,
    ),
    "xmate7p": Line(
        "xmate7p", "robot.urdf", ("traj1",), ("traj2",), 8.0,
        (22.2, 2.4, 4.4, 3.2, 11.6, 10.7, 17.5),
    ),
    "emps": Line("emps", "robot.yaml", ("train",), ("test_pulses",), 60.0, (7.3,)),
}  # fmt: skip


def read(line: Line, names: tuple[str, ...]) -> Log:
    log = read_log([FOLDER / line.folder / f"log_{name}.parquet" for name in names])
    return log.with_torque(torch.tensor(line.gains, dtype=torch.float64)) if line.gains else log


@lru_cache
def identified(name: str, settings: Settings) -> Identification:
    line = LINES[name]
    held_out = read(line, line.test) if line.test else None
    robot = load_robot(FOLDER / line.folder / line.robot)
    return identify(robot, read(line, line.train), held_out=held_out, settings=settings)


def held_out_error(name: str, settings: Settings) -> torch.Tensor:
    errors = identified(name, settings).held_out
    assert errors is not None
    return errors.relative_percent_moving if LINES[name].moving else errors.relative_percent


def shown(error: torch.Tensor) -> str:
    return " ".join(f"{e:.2f}" for e in error.tolist())


@pytest.mark.parametrize("name", LINES)
def test_held_out_errors(name):
    line = LINES[name]
    expected = torch.tensor(line.expected, dtype=torch.float64)
    error = held_out_error(name, line.settings)
    assert float(error.mean()) <= float(expected.mean()), shown(error)
    # The figures are printed with one digit.
    assert bool((error <= 1.15 * (expected + 0.05)).all()), shown(error)


@pytest.mark.nightly
@pytest.mark.parametrize("name", LINES)
def test_the_automatic_cutoff_is_not_worse(name):
    line = LINES[name]
    error = held_out_error(name, replace(line.settings, cutoff="auto", error_cutoff=line.cutoff))
    assert float(error.mean()) <= sum(line.expected) / len(line.expected), shown(error)


@pytest.mark.parametrize("name", LINES)
def test_nothing_has_the_wrong_sign(name):
    found = identified(name, LINES[name].settings)
    assert found.wrong_sign == ()
    assert all(b in " ".join(found.warnings) for b in found.bounded)


def test_the_published_drive():
    """Janot, Gautier and Brunot (2019), table 4: M, Fv, Fc, offset of the EMPS."""
    found = identified("emps", replace(LINES["emps"].settings, method="wls"))
    published = torch.tensor([95.109, 203.50, 20.394, -3.165], dtype=torch.float64)
    assert [name.split()[0] for name in found.base.names] == ["m1", "Fv1", "Fc1", "F01"]
    assert found.values.tolist() == pytest.approx(published.tolist(), rel=0.01)


def test_the_pandas_whole_trajectory():
    """Published: 1.41 % of the whole trajectory's torque."""
    settings = replace(LINES["panda_gaz"].settings, held_out_fraction=0.0)
    (prediction,) = identified("panda_gaz", settings).fit_predictions
    residual = prediction.measured - prediction.predicted
    assert float(100 * residual.norm() / prediction.measured.norm()) <= 1.41


def test_standstill_is_said():
    """On the UR10e it holds most of the squared error of all rows."""
    found = identified("ur10e_ptp", LINES["ur10e_ptp"].settings)
    assert any("rows at rest hold" in w and w.startswith("held-out") for w in found.warnings)


@pytest.mark.parametrize("empty", [("unloaded_dec23",), ("est_30s_12harm", "exc_40s_12harm")])
def test_the_ur10e_load_of_2p6_kg_lies_in_its_interval(empty):
    """The same reference motion without and with a known load; and two other motions without."""
    line = LINES["ur10e_ptp"]
    robot = load_robot(FOLDER / line.folder / line.robot)
    settings = Settings(cutoff=7.0, rows="moving")
    without, carrying = (
        identify(robot, read(line, names), settings=settings)
        for names in (empty, ("loaded_2p6kg_jan13",))
    )
    mass = estimate_payload(without, carrying).tool.mass
    assert float(mass.low) <= 2.6 <= float(mass.high)
    assert float(mass.std) < 0.1
