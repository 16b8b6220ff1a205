"""A unit that changes is named, with since when and by how much; the others are not."""

import dataclasses

import msgspec
import pytest

from tests.fleet.simulated import Plan, make, session_name, typical, unit_name
from torchid.errors import TorchidError
from torchid.fleet.identify import fleet_identify
from torchid.fleet.model import FleetModel
from torchid.fleet.settings import FleetSettings
from torchid.fleet.watch import watch
from torchid.log.readers import read_log
from torchid.results.files import load
from torchid.robot.library import load_robot

EFFECTS = ("viscous_friction", "coulomb_friction", "torque_offset")


@pytest.fixture(scope="module")
def fleet(tmp_path_factory):
    robot = load_robot("3r_friction")
    less = -0.4 * typical(robot)["Fv2"]
    plan = Plan(units=4, sessions=7, seconds=10.0, daily=0.02, drift={1: ("Fv2", less, 4)})
    logs = make(robot, plan, tmp_path_factory.mktemp("fleet"))
    return fleet_identify(FleetModel(robot, FleetSettings(effects=EFFECTS)), logs)


@pytest.mark.nightly
def test_the_unit_that_changes_is_named(fleet, tmp_path) -> None:
    found = watch(fleet, every=100)
    assert {a.unit for a in found.alarms} == {unit_name(1)}
    first = found.alarms[0]
    assert (first.parameter, first.since) == ("Fv2", session_name(4))
    assert -52 < first.percent < -28
    assert "fell by" in first.sentence
    found.save(tmp_path / "watch.json")
    assert load(tmp_path / "watch.json").plain() == found.plain()


@pytest.mark.slow
def test_a_temperature_that_went_along_takes_the_blame(fleet) -> None:
    """Warm since the change: what both explain is no one's, and no alarm."""
    late = [session_name(s) for s in range(4, 7)]
    warm = [
        msgspec.structs.replace(a, temperature=38.0 if a.session in late else 24.0)
        for a in fleet.logs
    ]
    found = watch(dataclasses.replace(fleet, logs=tuple(warm)), every=100)
    assert not found.alarms
    assert found.units[1].temperature == (24.0,) * 4 + (38.0,) * 3


@pytest.mark.slow
def test_a_temperature_is_read_from_the_log(fleet, tmp_path) -> None:
    import pyarrow as pa
    import pyarrow.parquet

    from torchid.fleet.reading import temperature_of

    path = fleet.logs[0].log
    from pathlib import Path

    assert temperature_of(Path(path)) is None
    table = pa.parquet.read_table(path)
    heat = pa.array([30.0] * (table.num_rows - 1) + [None])
    pa.parquet.write_table(table.append_column("temperature", heat), tmp_path / "warm.parquet")
    assert temperature_of(tmp_path / "warm.parquet") == 30.0
    assert read_log(tmp_path / "warm.parquet").samples == table.num_rows


@pytest.mark.slow
def test_what_cannot_be_watched(fleet) -> None:
    short = [dataclasses.replace(u, sessions=u.sessions[:2]) for u in fleet.units]
    with pytest.raises(TorchidError, match="sessions enough"):
        watch(dataclasses.replace(fleet, units=tuple(short)))
    with pytest.raises(TorchidError, match="after one session"):
        watch(fleet, every=0.5)
