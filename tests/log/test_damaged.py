"""Files that are not what they claim: one LogError with the file's name, no crash, no memory."""

import os
from pathlib import Path

import pytest

from tests.robustness import bad_logs
from tests.robustness.bench import limited
from torchid.errors import LogError
from torchid.log import apart
from torchid.log.readers import read_log


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return bad_logs.write_all(tmp_path_factory.mktemp("logs"))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("claims0.npz", "more numbers than the file can hold"),
        ("claims5.npz", "more numbers than the file can hold"),
        ("nested.npz", "damaged"),
        ("endless.h5", "more numbers than the file can hold"),
        ("links.h5", "no column"),
        ("bad_name.parquet", "damaged"),
        ("word2.mat", "damaged"),
        ("word4.mat", "damaged"),
        ("cut.mat", "damaged"),
        ("lerobot shape [1e+30]", "no column"),
        ("far.csv", "numbers that nothing measures"),
    ],
)
def test_one_error_with_the_files_name(files, name, said) -> None:
    with pytest.raises(LogError, match=said) as error, limited(more=1 << 29):
        read_log(files[name])
    assert files[name].name in str(error.value)


def test_a_pipe_is_no_log(tmp_path) -> None:
    os.mkfifo(tmp_path / "log.csv")
    with pytest.raises(LogError, match="no file, but a device or a pipe"), limited():
        read_log(tmp_path / "log.csv")


def test_arrays_of_matlab_may_have_any_name(tmp_path) -> None:
    from scipy.io import savemat

    table = bad_logs.motion(30)
    savemat(tmp_path / "log.mat", {**table, "file": table["t"], "note": "text"})
    log = read_log(tmp_path / "log.mat")
    assert log.samples == 30
    assert log.t.tolist() == table["t"].tolist()


@pytest.mark.slow
def test_an_endless_list_of_contents_is_given_up_and_the_next_file_is_read(
    tmp_path, monkeypatch
) -> None:
    slow = Path(__file__).parents[1] / "robustness" / "corpus" / "slow_to_list.h5"
    (tmp_path / "good.h5").write_bytes(bad_logs.hdf5(bad_logs._columns))
    assert read_log(tmp_path / "good.h5").n == 3
    monkeypatch.setattr(apart, "PATIENCE", 1.0)
    with pytest.raises(LogError, match="no answer within 1 s"):
        read_log(slow)
    monkeypatch.undo()
    assert read_log(tmp_path / "good.h5").n == 3


def test_a_reader_that_is_ended_is_one_error(files, tmp_path, monkeypatch) -> None:
    """As by a fault of its library."""
    (tmp_path / "good.h5").write_bytes(bad_logs.hdf5(bad_logs._columns))
    monkeypatch.setattr(apart, "_PROGRAM", tmp_path / "ends.py")
    (tmp_path / "ends.py").write_text("import os, sys\nsys.stdin.readline()\nos.abort()\n")
    apart._READER.end()
    with pytest.raises(LogError, match=r"good\.h5.*damaged") as error:
        read_log(tmp_path / "good.h5")
    assert "its reader ends on it" in str(error.value)
    monkeypatch.undo()
    assert read_log(tmp_path / "good.h5").n == 3
