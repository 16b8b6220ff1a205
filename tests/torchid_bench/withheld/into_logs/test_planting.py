"""Real logs in halves of time and of motions, and what is planted into one of them, as files."""

from pathlib import Path

import pytest
import torch

from tests.arms import arm
from tests.gap.diagnoses import motion_of
from torchid.effects.registry import KINDS, model_torque
from torchid.log.model import Log
from torchid.log.readers import read_log, write_log
from torchid.robot.writer import write_robot
from torchid_bench.withheld.case_set import LOG
from torchid_bench.withheld.into_logs import planting
from torchid_bench.withheld.into_logs.forms import FORMS
from torchid_bench.withheld.into_logs.planting import (
    NONE,
    SETS,
    SOURCES,
    Bed,
    Source,
    known_classes,
    with_late_velocities,
)
from torchid_bench.withheld.run import run


def log_of(seed: int, duration: float = 8.0) -> Log:
    """A motion of 3r with noise of .05 N m."""
    motion = motion_of(3, duration, 100.0, seed=seed)
    noise = torch.randn(motion.q.shape, generator=torch.Generator().manual_seed(seed))
    tau = model_torque(arm("3r"), [], motion) + 0.05 * noise
    return Log(torch.arange(len(motion.q)).double() / 100, motion.q, tau=tau, dq=motion.dq)


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two logs of an arm, as sources by time and by motions, whose model is the arm's."""
    folder = tmp_path / "data"
    folder.mkdir()
    write_robot(arm("3r"), folder / "arm.yaml")
    for k in (0, 1):
        write_log(log_of(k), folder / f"log{k}.parquet")
    known = {
        "time": Source("arm.yaml", ["log0.parquet"]),
        "motions": Source("arm.yaml", ["log0.parquet"], ["log1.parquet"], left=[0.01] * 3),
    }
    monkeypatch.setattr(planting, "SOURCES", known)

    class Fitted:
        corrected = arm("3r")

    monkeypatch.setattr(planting, "diagnose_torque", lambda *_, **__: Fitted())
    return folder


def test_halves_are_of_time_or_of_motions(data: Path, tmp_path: Path) -> None:
    whole = [read_log(data / f"log{k}.parquet") for k in (0, 1)]
    time, motions = (Bed.of(label, data, tmp_path) for label in ("time", "motions"))
    assert torch.equal(time.asked.q, whole[0].split(0.5)[1].q)
    assert torch.equal(motions.asked.q, whole[1].q)
    first = read_log(motions.folder / "first.parquet")
    assert torch.equal(first.q, whole[0].q)
    assert motions.job(NONE, True).earlier == motions.folder / "first.parquet"
    assert motions.job(NONE, False).earlier is None


def test_what_is_planted_is_in_the_log_and_is_not_planted_again(data: Path, tmp_path: Path) -> None:
    bed = Bed.of("motions", data, tmp_path)
    names = ["torque_offset", "stop", "filter_lag", "power_law_friction"]
    bed.plant(names, [2.0])
    cases = bed.cases(names, [2.0])
    assert cases == [f"{name}-2" for name in names]
    logs = {case: read_log(bed.folder / case / LOG) for case in cases}
    assert bed.asked.tau is not None
    for case in cases[:2]:
        key, tau = bed.key(case), logs[case].tau
        assert tau is not None
        added = tau - bed.asked.tau
        felt = (added.abs() > 1e-9).any(0).nonzero().flatten() + 1
        assert felt.tolist() == key["joints"] == key["felt_by"]
        acts = added.abs() > 0
        assert float(added.square().sum() / acts.sum()) ** 0.5 == pytest.approx(0.02, rel=0.2)
    # Late velocities change no torque.
    late = logs["filter_lag-2"]
    assert late.tau is not None
    assert torch.equal(late.tau, bed.asked.tau)
    assert late.dq is not None
    assert bed.asked.dq is not None
    assert not torch.equal(late.dq, bed.asked.dq)
    times = [(bed.folder / case / LOG).stat().st_mtime_ns for case in cases]
    bed.plant(names, [2.0])
    assert [(bed.folder / case / LOG).stat().st_mtime_ns for case in cases] == times


def test_velocities_are_late_by_so_much() -> None:
    log = log_of(0)
    late = with_late_velocities(log, 0.02)
    assert log.dq is not None
    assert late.dq is not None
    assert late.dq[2:].numpy() == pytest.approx(log.dq[:-2].numpy())


@pytest.mark.slow
def test_cases_are_classified_and_answered_once(data: Path, tmp_path: Path) -> None:
    bed = Bed.of("motions", data, tmp_path)
    bed.plant(["coulomb_friction"], [20.0])
    (case,) = bed.cases(["coulomb_friction"], [20.0])
    bed.classify([case], tmp_path)
    own = known_classes(tmp_path)[f"motions-{case}"]
    assert own["class"] in ("decidable", "ambiguous")
    assert own["planted"] == bed.key(case)["record"]
    write = (tmp_path / "classes.json").stat().st_mtime_ns
    bed.classify([case], tmp_path)
    assert (tmp_path / "classes.json").stat().st_mtime_ns == write
    (answer,) = run([bed.job(case, False)]).values()
    assert answer["which"][0]["effect"] == "coulomb_friction"


@pytest.mark.parametrize("label", SOURCES)
def test_a_source_is_whole(label: str) -> None:
    """A model is kept for all that have stored classes, and it has what is left of the log."""
    source = SOURCES[label]
    kept = Path(planting.__file__).with_name("kept") / f"{label}.yaml.gz"
    stored = [case for case in known_classes() if case.startswith(f"{label}-")]
    assert kept.exists() == bool(stored) == bool(source.left)
    assert not set(source.asked) & set(source.logs)


@pytest.mark.parametrize("name", SETS)
def test_a_set_has_effects_that_there_are(name: str) -> None:
    assert set(SETS[name]["effects"]) <= {*KINDS, *FORMS}
    assert min(SETS[name]["sizes"]) > 0
