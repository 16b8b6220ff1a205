"""Which log is of which unit."""

import pytest

from torchid.errors import TorchidError
from torchid.fleet.manifest import FleetLog, fleet_logs, read_manifest


def test_a_folder_is_a_unit(tmp_path) -> None:
    for name in ("b/monday.csv", "a/tuesday.parquet", "a/monday.parquet", "a/notes.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    found = fleet_logs([tmp_path])
    assert [(log.unit, log.session) for log in found] == [
        ("a", "monday"), ("a", "tuesday"), ("b", "monday"),
    ]  # fmt: skip
    assert fleet_logs(["s3://logs/arm-1/x.parquet"])[0].unit == "arm-1"


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_manifest_names_units_and_sessions(tmp_path, suffix) -> None:
    import pyarrow as pa
    import pyarrow.csv
    import pyarrow.parquet

    table = pa.table({"unit": [7, 7], "log": ["x.csv", "s3://b/y.csv"], "session": ["1a", "1b"]})
    file = tmp_path / f"fleet{suffix}"
    (pa.csv.write_csv if suffix == ".csv" else pa.parquet.write_table)(table, file)
    assert read_manifest(file) == (
        FleetLog("7", "1a", str(tmp_path / "x.csv")),
        FleetLog("7", "1b", "s3://b/y.csv"),
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("log,session\nx.csv,1\n", "no column unit"),
        ("log,unit\nx.csv,a\nx.csv,b\n", "named twice"),
        ("log,unit\nx.csv,a\ny.csv,\n", "no unit in row 2"),
    ],
)
def test_a_manifest_that_is_none(tmp_path, text, said) -> None:
    file = tmp_path / "fleet.csv"
    file.write_text(text)
    with pytest.raises(TorchidError, match=said):
        read_manifest(file)


@pytest.mark.parametrize("names", [("x/a/monday.csv", "y/a/monday.csv"), ("a/1.csv", "a/1.npz")])
def test_two_logs_of_one_unit_and_session_are_not_taken_for_one(tmp_path, names) -> None:
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    with pytest.raises(TorchidError, match="two logs would be of unit 'a'"):
        fleet_logs([tmp_path])


def test_no_logs(tmp_path) -> None:
    with pytest.raises(TorchidError, match="no log in the folder"):
        fleet_logs([tmp_path])
    with pytest.raises(TorchidError, match="no manifest"):
        read_manifest(tmp_path / "none.csv")
