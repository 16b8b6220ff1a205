"""Searches that were killed and resumed end in the same bits; other files are refused."""

import os
import random
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.extraction.setups import asking, problem_of
from torchid.errors import TorchidError
from torchid.extraction.cma.search import start
from torchid.extraction.extract import (
    Extraction,
    Progress,
    SearchSettings,
    extract,
    fingerprint,
    load,
    save,
)
from torchid.extraction.problem import Problem

STAGES = 6
SETTINGS = SearchSettings(runs=3, stages=STAGES, generations=8, seed=4)


class _KilledError(Exception):
    """In place of a kill."""


def killed_at(stage: int, path: Path, settings: SearchSettings = SETTINGS, resume: bool = False):  # type: ignore[no-untyped-def]
    """A search that dies right after a stage, with its checkpoint left behind."""

    def report(done: int, _: int) -> None:
        if done == stage:
            raise _KilledError

    with pytest.raises(_KilledError):
        extract(problem_of("3r"), settings, checkpoint=path, resume=resume, report=report)


def assert_same(a: Extraction, b: Extraction) -> None:
    for name in ("phi", "gamma", "history_phi", "history_gamma"):
        assert torch.equal(getattr(a, name), getattr(b, name)), name
    assert torch.equal(a.sets.vector, b.sets.vector)
    assert a.sets.ids == b.sets.ids


@pytest.fixture(scope="module")
def whole() -> Extraction:
    return extract(problem_of("3r"), SETTINGS)


# ---- resuming -------------------------------------------------------------------------------


@pytest.mark.parametrize("stage", [1, 3, STAGES])
def test_resumed_is_the_same_to_the_bit(stage: int, tmp_path: Path, whole: Extraction) -> None:
    path = tmp_path / "search.npz"
    killed_at(stage, path)
    seen: list[int] = []
    found = extract(
        problem_of("3r"), SETTINGS, checkpoint=path, resume=True,
        report=lambda done, _: seen.append(done),
    )  # fmt: skip
    assert_same(found, whole)
    assert seen == list(range(stage + 1, STAGES + 1))
    assert list(tmp_path.iterdir()) == []  # neither the checkpoint nor a temporary file is left


def test_killed_three_times(tmp_path: Path, whole: Extraction) -> None:
    path = tmp_path / "search.npz"
    killed_at(2, path)
    killed_at(3, path, resume=True)
    killed_at(5, path, resume=True)
    assert_same(extract(problem_of("3r"), SETTINGS, checkpoint=path, resume=True), whole)


@pytest.mark.nightly
@pytest.mark.parametrize("changes", [{"penalty": "partial"}, {"schedule": "geometric"}])
def test_of_every_kind_of_search(changes: dict[str, object], tmp_path: Path) -> None:
    settings = replace(SETTINGS, stages=3, **changes)
    path = tmp_path / "search.npz"
    killed_at(2, path, settings)
    found = extract(problem_of("3r"), settings, checkpoint=path, resume=True)
    assert_same(found, extract(problem_of("3r"), settings))


@pytest.mark.nightly
def test_other_workers_may_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torchid.extraction.extract.BLOCK", 1000)
    settings = replace(SETTINGS, runs=6)
    path = tmp_path / "search.npz"
    killed_at(2, path, settings)
    with ThreadPoolExecutor(2) as threads:
        found = extract(problem_of("3r"), settings, checkpoint=path, resume=True, workers=threads)
    assert_same(found, extract(problem_of("3r"), settings))


def test_without_resume_it_begins_anew(tmp_path: Path, whole: Extraction) -> None:
    path = tmp_path / "search.npz"
    killed_at(2, path, replace(SETTINGS, seed=9))
    seen: list[int] = []
    found = extract(
        problem_of("3r"), SETTINGS, checkpoint=path, report=lambda done, _: seen.append(done)
    )
    assert seen[0] == 1
    assert_same(found, whole)


def test_nothing_to_resume(tmp_path: Path, whole: Extraction) -> None:
    path = tmp_path / "search.npz"
    assert_same(extract(problem_of("3r"), SETTINGS, checkpoint=path, resume=True), whole)
    assert_same(extract(problem_of("3r"), SETTINGS, resume=True), whole)


# ---- a real kill ----------------------------------------------------------------------------

_SEARCH = """
import sys, time
from pathlib import Path
import torch
torch.set_num_threads(1)
torch.set_default_dtype(torch.float64)
from tests.extraction.setups import problem_of
from tests.extraction.test_checkpoint import SETTINGS
from torchid.extraction.extract import extract

path, marks = Path(sys.argv[1]), Path(sys.argv[2])

def report(done, of):
    with marks.open("a") as file:
        file.write(f"{done}\\n")
    time.sleep(0.3)

found = extract(problem_of("3r"), SETTINGS, checkpoint=path, resume=True, report=report)
torch.save([found.phi, found.gamma, found.history_phi, found.history_gamma, found.sets.vector],
           sys.argv[3])
"""


def begun(folder: Path) -> subprocess.Popen[bytes]:
    names = ("search.npz", "marks.txt", "found.pt")
    return subprocess.Popen(
        [sys.executable, "-c", _SEARCH, *(str(folder / name) for name in names)],
        env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": os.getcwd()},
    )


def stages_done(folder: Path) -> list[int]:
    marks = folder / "marks.txt"
    return [int(line) for line in marks.read_text().split()] if marks.exists() else []


def kill_after(folder: Path, new_stages: int, delay: float) -> None:
    """SIGKILL after so many new stages, at a random moment of the next."""
    before = len(stages_done(folder))
    process = begun(folder)
    deadline = time.monotonic() + 120
    while len(stages_done(folder)) < before + new_stages:
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.01)
    time.sleep(delay)
    process.send_signal(signal.SIGKILL)
    assert process.wait(30) == -signal.SIGKILL


@pytest.mark.nightly
def test_sigkill_three_times(tmp_path: Path, whole: Extraction) -> None:
    chance = random.Random(int.from_bytes(os.urandom(4), "little"))
    for _ in range(3):
        kill_after(tmp_path, 1, chance.uniform(0.0, 0.35))
        assert not (tmp_path / "found.pt").exists()
    assert begun(tmp_path).wait(180) == 0
    seen = stages_done(tmp_path)
    assert seen[-1] == STAGES
    assert len(seen) <= STAGES + 3  # at most one stage is done again for each kill
    found = torch.load(tmp_path / "found.pt")
    expected = [
        whole.phi, whole.gamma, whole.history_phi, whole.history_gamma, whole.sets.vector,
    ]  # fmt: skip
    assert all(torch.equal(a, b) for a, b in zip(found, expected, strict=True))
    assert not (tmp_path / "search.npz").exists()


# ---- the file -------------------------------------------------------------------------------


def some_progress(p: Problem) -> Progress:
    g = torch.Generator().manual_seed(1)
    means = torch.rand(3, p.size, generator=g, dtype=torch.float64)
    return Progress(
        2,
        start(means, 0.3),
        torch.rand(3, 2, dtype=torch.float64),
        torch.rand(3, 2, dtype=torch.float64),
    )


def saved(folder: Path, settings: SearchSettings = SETTINGS) -> tuple[Path, Progress]:
    p = problem_of("3r")
    path, now = folder / "search.npz", some_progress(p)
    save(path, now, p, settings)
    return path, now


def test_file_is_lossless(tmp_path: Path) -> None:
    path, now = saved(tmp_path)
    again = load(path, problem_of("3r"), SETTINGS)
    assert again is not None
    assert again.stage == 2
    assert torch.equal(again.phi, now.phi)
    assert torch.equal(again.gamma, now.gamma)
    for name, array in now.state.to_arrays().items():
        assert np.array_equal(again.state.to_arrays()[name], array), name
    with np.load(path, allow_pickle=False) as file:  # no pickle in it, and nothing that is no data
        assert all(file[name].dtype.kind in "fiUb" for name in file.files)
    assert load(tmp_path / "none.npz", problem_of("3r"), SETTINGS) is None


OTHER_SETTINGS = [
    {"runs": 4}, {"stages": 7}, {"generations": 9}, {"population": 12}, {"penalty": "partial"},
    {"schedule": "geometric"}, {"seed": 5},
]  # fmt: skip


@pytest.mark.parametrize("changes", OTHER_SETTINGS)
def test_other_settings_are_refused(changes: dict[str, object], tmp_path: Path) -> None:
    path, _ = saved(tmp_path)
    other = replace(SETTINGS, **changes)
    with pytest.raises(TorchidError, match="another extraction"):
        load(path, problem_of("3r"), other)
    with pytest.raises(TorchidError, match="another extraction"):
        extract(problem_of("3r"), other, checkpoint=path, resume=True)
    assert path.exists()  # what took hours to search is not removed


def test_other_problems_are_refused(tmp_path: Path) -> None:
    path, _ = saved(tmp_path)
    p = problem_of("3r")
    target = replace(p.target, offset=p.target.offset + 1e-12)
    narrow = p.conditions.com_box.clone()
    narrow[0, 0, 1] += 1e-9
    others = [
        problem_of("3r", "loose"),
        problem_of("3r", shapes=True),
        problem_of("3r_friction"),
        problem_of("kuka_lwr4"),
        replace(p, target=target),
        replace(p, target=replace(p.target, weight=2 * p.target.weight)),
        asking(p, total_mass=torch.tensor([5.0, 6.0], dtype=torch.float64)),
        asking(p, com_box=narrow),
    ]
    for other in others:
        with pytest.raises(TorchidError, match="another extraction"):
            load(path, other, SETTINGS)
    assert len({fingerprint(x, SETTINGS) for x in [p, *others]}) == len(others) + 1


def npz(path: Path, **arrays: np.ndarray) -> None:
    with path.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "case",
    ["empty", "text", "half", "flipped", "array", "other npz", "no state", "pickle", "folder",
     "no stage", "stage of two"],
)  # fmt: skip
def test_files_that_are_no_checkpoints_are_refused(case: str, tmp_path: Path) -> None:
    path, _ = saved(tmp_path)
    whole = path.read_bytes()
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    path.unlink()
    if case == "empty":
        path.write_bytes(b"")
    elif case == "text":
        path.write_text("stage: 3\n")
    elif case == "half":
        path.write_bytes(whole[: len(whole) // 2])
    elif case == "flipped":
        middle = len(whole) // 2
        path.write_bytes(whole[:middle] + bytes([whole[middle] ^ 255]) + whole[middle + 1 :])
    elif case == "array":
        with path.open("wb") as stream:
            np.save(stream, np.ones(3))
    elif case == "other npz":
        npz(path, q=np.ones((4, 3)))
    elif case == "no state":
        npz(path, **{k: v for k, v in arrays.items() if k != "state_mean"})
    elif case == "pickle":
        npz(path, stage=np.array([{"a": 1}], dtype=object))
    elif case == "no stage":
        npz(path, **{k: v for k, v in arrays.items() if k != "stage"})
    elif case == "stage of two":
        npz(path, **arrays | {"stage": np.array([1, 2])})
    else:
        path.mkdir()
    with pytest.raises(TorchidError) as caught:
        extract(problem_of("3r"), SETTINGS, checkpoint=path, resume=True)
    assert str(path) in str(caught.value)


def test_a_write_that_fails_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half a file is never seen: a kill or an error while writing costs one stage at most."""
    path, now = saved(tmp_path)
    before = path.read_bytes()

    def fails(stream, **arrays):  # type: ignore[no-untyped-def]
        stream.write(b"half of it")
        raise _KilledError

    monkeypatch.setattr(np, "savez", fails)
    with pytest.raises(_KilledError):
        save(path, now, problem_of("3r"), SETTINGS)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_is_gone_is_made_again(tmp_path: Path) -> None:
    """Another search of it may have ended, and taken it away."""
    place = tmp_path / "none" / "search.npz"
    killed_at(1, place)
    assert place.exists()


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "none").write_text("a file")
    with pytest.raises(TorchidError, match="cannot be written"):
        extract(problem_of("3r"), SETTINGS, checkpoint=tmp_path / "none" / "search.npz")
