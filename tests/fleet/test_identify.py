"""A simulated fleet: the same bits for any number of workers, odd units by name, and every fault a
row."""

import itertools
import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from tests.fleet.simulated import Plan, make, typical, unit_name
from torchid.errors import IdentificationError, TorchidError
from torchid.export.randomise import randomise
from torchid.fleet import model as models
from torchid.fleet import tasks
from torchid.fleet.identify import INDEX, fleet_identify, reduce_fleet
from torchid.fleet.known import known_model
from torchid.fleet.manifest import FleetLog, fleet_logs
from torchid.fleet.model import FleetModel
from torchid.fleet.settings import FleetSettings
from torchid.identification.knowledge import between_sessions
from torchid.parallel.store import Store
from torchid.parallel.workers import RefusedError
from torchid.results.files import load
from torchid.robot.library import load_robot

EFFECTS = ("viscous_friction", "coulomb_friction", "torque_offset")


@pytest.fixture(scope="module")
def model() -> FleetModel:
    return FleetModel(load_robot("3r_friction"), FleetSettings(effects=EFFECTS))


@pytest.fixture(scope="module")
def folder(model, tmp_path_factory) -> Path:
    """Eight units of two days; one has twice the viscous friction on joint 2."""
    place = tmp_path_factory.mktemp("fleet")
    more = typical(model.robot)["Fv2"]
    make(model.robot, Plan(units=8, odd={3: ("Fv2", more)}), place)
    return place


@pytest.fixture(scope="module")
def logs(folder) -> tuple[FleetLog, ...]:
    return fleet_logs([folder])


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> Store:
    return Store(str(tmp_path_factory.mktemp("store")))


@pytest.fixture(scope="module")
def found(model, logs, store):
    return fleet_identify(model, logs, store=store)


def test_the_odd_unit_is_named_with_its_evidence(found) -> None:
    assert found.odd == (unit_name(3),)
    first = found.oddities[0]
    assert (first.unit, first.parameter) == (unit_name(3), "Fv2")
    assert "standard deviations above" in first.sentence


def test_spreads_are_those_that_were_drawn(found, model) -> None:
    record = found.record
    for name in ("Fv1", "Fc1", "Fc2", "Fc3"):
        p = next(p for p in record.parameters if p.name == name)
        true = typical(model.robot)[name]
        low, high = p.between_ci95
        assert low <= 0.1 * true <= high, name
        assert p.ci95[0] - 0.05 * true <= true <= p.ci95[1] + 0.05 * true


def test_the_type_is_a_model_that_says_how_sure_it_is(found, model) -> None:
    """As wide as its units differ; and how much friction changes from day to day is measured."""
    robot = known_model(found)
    assert robot.knowledge is not None
    true = typical(model.robot)
    for name, effect in (("Fc1", "coulomb_friction"), ("Fv3", "viscous_friction")):
        key = f"{effect} {name}"
        assert robot.knowledge.std(key) == pytest.approx(0.1 * true[name], rel=0.9)
        daily = robot.knowledge.between[key]
        assert daily < 0.1 * true[name]
        assert between_sessions(robot)[key] == pytest.approx(daily**2)
    # A unit is known better than the type, and by its own values.
    one = known_model(found, unit_name(3))
    assert one.knowledge is not None
    own = {e["effect"]: e for e in one.effects if e["joint"] == 2}
    assert own["viscous_friction"]["Fv"] == pytest.approx(2 * true["Fv2"], rel=0.3)
    key = "coulomb_friction Fc1"
    assert one.knowledge.std(key) < robot.knowledge.std(key)
    with pytest.raises(TorchidError, match="no such unit"):
        known_model(found, "nobody")


@pytest.mark.nightly
def test_the_bits_do_not_depend_on_the_workers(found, model, logs, tmp_path) -> None:
    backwards = tuple(reversed(logs))
    other = fleet_identify(model, backwards, store=Store(str(tmp_path)), workers=2)
    assert json.dumps(other.plain()) == json.dumps(found.plain())


def test_a_result_is_saved_and_read_back(found, tmp_path) -> None:
    found.save(tmp_path / "fleet.json")
    back = load(tmp_path / "fleet.json")
    assert back.plain() == found.plain()
    assert len(back.table) == len(found.base)


def test_a_simulator_is_randomised_as_widely_as_units_differ(found) -> None:
    wide = randomise(known_model(found), draws=128)
    between = {p.name: p.between for p in found.record.parameters}
    widths = {(r.field, r.name): (r.high - r.low) / (2 * 1.96) for r in wide.ranges}
    for j, name in enumerate(wide.joint_names, start=1):
        assert widths["friction", name] > 0.8 * between[f"Fc{j}"] > 0


@pytest.mark.slow
def test_what_is_unchanged_is_not_computed_again(found, model, logs, store, monkeypatch) -> None:
    monkeypatch.setattr(tasks, "_reduced", None)  # would raise
    monkeypatch.setattr(tasks, "estimate", None)
    again = fleet_identify(model, logs, store=store)
    assert all(a.stored for a in again.logs)
    assert again.plain() == found.plain()


@pytest.mark.slow
def test_parts_of_a_batch_system_make_the_whole(found, model, logs, tmp_path, monkeypatch) -> None:
    place = Store(str(tmp_path))
    parts = [reduce_fleet(model, logs, place, part=(i, 3)) for i in (1, 2, 3)]
    answered = [FleetLog(a.unit, a.session, a.log) for part in parts for a in part]
    assert sorted(answered, key=repr) == sorted(logs, key=repr)
    monkeypatch.setattr(tasks, "_reduced", None)
    assert fleet_identify(model, logs, store=place).plain() == found.plain()
    with pytest.raises(TorchidError, match="no such part"):
        reduce_fleet(model, logs, place, part=(4, 3))


def test_a_store_has_a_table_that_pandas_reads(found, store, logs) -> None:
    pandas = pytest.importorskip("pandas")
    table = pandas.read_parquet(Path(store.place) / INDEX)
    assert list(table["log"]) == [log.path for log in logs]
    assert set(table["verdict"]) == {"good"}


def test_damaged_logs_are_rows_and_stop_nothing(model, logs, store, found, tmp_path) -> None:
    bad = {
        "empty.parquet": b"",
        "torn.parquet": Path(logs[0].path).read_bytes()[:5000],
        "words.csv": b"t,q1,q2,q3,tau1,tau2,tau3\nno,numbers,in,this,file,at,all\n",
    }
    for name, content in bad.items():
        (tmp_path / name).write_bytes(content)
    shutil.copy(logs[0].path, tmp_path / "copy.parquet")
    more = [FleetLog("arm-bad", name, str(tmp_path / name)) for name in (*bad, "copy.parquet")]
    more.append(FleetLog("arm-bad", "none", str(tmp_path / "none.parquet")))
    whole = fleet_identify(model, [*logs, *more], store=store)
    rows = {a.session: a for a in whole.logs if a.unit == "arm-bad"}
    assert {a.verdict for a in rows.values()} == {"refused"}
    assert "0 bytes" in rows["empty.parquet"].evidence[0]
    assert "same content as" in rows["copy.parquet"].evidence[0]
    assert (
        "does not exist" in rows["none"].evidence[0] or "cannot be read" in rows["none"].evidence[0]
    )
    torch.testing.assert_close(whole.pooled.mean, found.pooled.mean, rtol=1e-12, atol=1e-12)


def test_no_usable_log_is_an_error_with_the_reason(model, tmp_path) -> None:
    (tmp_path / "a.parquet").touch()
    with pytest.raises(IdentificationError, match="0 bytes"):
        fleet_identify(model, fleet_logs([tmp_path / "a.parquet"]))


def test_a_log_that_changes_while_it_is_read_is_not_used(
    model, logs, tmp_path, monkeypatch
) -> None:
    path = tmp_path / "growing.parquet"
    shutil.copy(logs[0].path, path)
    reduced, seen = tasks._reduced, []

    def written_to(*args):
        seen.append(1)
        out = reduced(*args)
        if len(seen) < 3:
            shutil.copy(logs[len(seen)].path, path)
        return out

    monkeypatch.setattr(tasks, "_reduced", written_to)
    place = Store(str(tmp_path / "store"))
    (answer,) = reduce_fleet(model, [FleetLog("a", "b", str(path))], place)
    assert len(seen) == 3  # whole at the third try
    assert answer.verdict == "good"
    seen.clear()
    looks = map(str, itertools.count())
    monkeypatch.setattr(tasks, "content_hash", lambda path: next(looks))
    place = Store(str(tmp_path / "other"))
    (answer,) = reduce_fleet(model, [FleetLog("a", "b", str(path))], place)
    assert answer.verdict == "failed"
    assert "changed while it was read" in answer.evidence[0]
    assert not list((tmp_path / "other").rglob("output.pkl"))


def test_a_worker_of_another_version_is_refused(model, logs, store, monkeypatch) -> None:
    monkeypatch.setattr(models, "this_version", lambda: ("9.9", "other"))
    with pytest.raises(RefusedError, match="another torchid than the command"):
        reduce_fleet(model, logs[:1], store)


def test_a_full_disk_is_no_fault_of_the_log(model, logs, tmp_path, monkeypatch) -> None:
    def full(*args, **kwargs):
        raise TorchidError("'x' cannot be written: No space left on device")

    monkeypatch.setattr(Store, "answer", full)
    (answer,) = reduce_fleet(model, logs[:1], Store(str(tmp_path)))
    assert (answer.verdict, answer.sha256) == ("failed", "")
    assert "No space left" in answer.evidence[0]


def test_another_setting_is_another_question(model) -> None:
    other = FleetModel(model.robot, replace(model.settings, cutoff=8.0))
    same = FleetModel(model.robot, replace(model.settings, level=0.1))
    assert other.key != model.key
    assert same.key == model.key  # the level comes after all that is stored


def test_effects_that_need_a_search_are_refused() -> None:
    model = FleetModel(load_robot("3r"), FleetSettings(effects=("stribeck_friction",)))
    with pytest.raises(TorchidError, match="known before a search"):
        _ = model.layout
