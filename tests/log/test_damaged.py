"""Files that are not what they claim: one LogError with the file's name, no crash, no memory."""

import os

import pytest

from tests.robustness import bad_logs
from tests.robustness.bench import limited
from torchid.errors import LogError
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
        ("cut.npz", "npz file"),
        ("holes.npz", "npz"),
        ("cut.parquet", "parquet file"),
        ("binary.csv", "csv"),
        ("cut.h5", "h5"),
        ("garbage_bag.mcap", "mcap"),
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
