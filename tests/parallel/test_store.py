"""An answer is there as a whole, or not at all."""

import numpy as np
import pytest

from torchid.errors import LogError, TorchidError
from torchid.parallel.store import Store, content_hash, key_of, local_file, stamp


@pytest.mark.parametrize("place", ["folder", "memory://answers"])
def test_what_is_written_is_read(place, tmp_path) -> None:
    store = Store(str(tmp_path / place) if place == "folder" else place)
    assert store.read("ab12") is None
    arrays = {"x": np.arange(6.0).reshape(2, 3), "none": np.zeros((0, 2))}
    store.write("ab12", {"verdict": "good", "noise": [1.0, float("nan")]}, arrays)
    found = store.read("ab12")
    assert found is not None
    assert found.words == {"verdict": "good", "noise": [1.0, None]}
    assert {k: v.tolist() for k, v in found.arrays.items()} == {
        "x": [[0, 1, 2], [3, 4, 5]],
        "none": [],
    }


@pytest.mark.parametrize("left", [0, 10, 200])
def test_a_damaged_answer_is_none(left, tmp_path) -> None:
    store = Store(str(tmp_path))
    store.write("ab12", {}, {"x": np.arange(100.0)})
    path = tmp_path / "ab" / "ab12.npz"
    path.write_bytes(path.read_bytes()[:left])
    assert store.read("ab12") is None


def test_a_store_that_cannot_be_written_says_so(tmp_path) -> None:
    (tmp_path / "ab").touch()
    with pytest.raises(TorchidError, match="cannot be made"):
        Store(str(tmp_path)).write("ab12", {}, {})


def test_keys_are_of_content() -> None:
    assert key_of({"a": 1, "b": [1.0]}) == key_of({"b": [1.0], "a": 1})
    assert key_of({"a": 1}) != key_of({"a": 2})


def test_a_file_is_known_by_its_bytes_and_a_folder_by_its_files(tmp_path) -> None:
    file, folder = tmp_path / "a.csv", tmp_path / "bag"
    folder.mkdir()
    file.write_text("t\n")
    (folder / "b.csv").write_text("t\n")
    assert content_hash(file) != content_hash(folder)
    before, seen = content_hash(file), stamp(file)
    file.write_text("t\n1\n")
    assert content_hash(file) != before
    assert stamp(file) != seen
    with pytest.raises(LogError, match="cannot be read"):
        content_hash(tmp_path / "none")


def test_a_url_is_fetched_under_its_own_name() -> None:
    import fsspec

    with fsspec.open("memory://logs/run.csv", "wb") as file:
        file.write(b"t,q1\n")
    with local_file("memory://logs/run.csv") as path:
        assert path.name == "run.csv"
        assert path.read_bytes() == b"t,q1\n"
    with pytest.raises(LogError, match="cannot be read"), local_file("memory://logs/none.csv"):
        pass
