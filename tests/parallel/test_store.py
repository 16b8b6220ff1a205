"""An answer is there as a whole, or not at all."""

import hashlib

import pytest
import torch

from torchid.errors import LogError, TorchidError
from torchid.parallel.store import Store, content_hash, key_of, local_file


def never():
    raise AssertionError("this was asked before")


@pytest.mark.parametrize("place", ["folder", "memory://answers"])
def test_the_same_question_is_never_answered_twice(place, tmp_path) -> None:
    store = Store(str(tmp_path / place) if place == "folder" else place)
    assert "ab12" not in store
    with pytest.raises(TorchidError, match="does not have ab12"):
        store.kept("ab12")
    answer = ["good", {"noise": float("inf")}, torch.arange(6.0).reshape(2, 3)]
    assert store.answer("ab12", lambda: answer) is answer
    found = Store(store.place).answer("ab12", never)
    assert found[:2] == answer[:2]
    assert torch.equal(found[2], answer[2])
    assert "ab12" in store
    assert "ab13" not in store


def test_what_fails_is_no_answer(tmp_path) -> None:
    store = Store(str(tmp_path))
    with pytest.raises(AssertionError):
        store.answer("ab12", never)
    assert store.answer("ab12", lambda: 1) == 1


@pytest.mark.parametrize("left", [0, 10, 60])
def test_a_damaged_answer_is_none(left, tmp_path) -> None:
    store = Store(str(tmp_path))
    store.answer("ab12", lambda: list(range(1000)))
    (path,) = tmp_path.rglob("output.pkl")
    path.write_bytes(path.read_bytes()[:left])
    assert store.answer("ab12", lambda: 1) == 1
    assert store.answer("ab12", never) == 1


def test_a_store_that_cannot_be_written_says_so(tmp_path, monkeypatch) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(TorchidError, match="cannot be made"):
        Store(str(tmp_path / "file")).answer("ab12", lambda: 1)

    def full(*args: object, **options: object) -> None:
        raise OSError(28, "No space left on device")

    store = Store(str(tmp_path))
    assert "ab12" not in store
    monkeypatch.setattr("joblib._store_backends.numpy_pickle.dump", full)
    with pytest.raises(TorchidError, match="No space left"):
        store.answer("ab12", lambda: 1)
    assert not list(tmp_path.rglob("output.pkl"))


def test_keys_are_of_content() -> None:
    assert key_of({"a": 1, "b": [1.0]}) == key_of({"b": [1.0], "a": 1})
    assert key_of({"a": 1}) != key_of({"a": 2})


def test_a_file_is_known_by_its_bytes_and_a_folder_by_its_files(tmp_path) -> None:
    file, folder = tmp_path / "a.csv", tmp_path / "bag"
    folder.mkdir()
    file.write_text("t\n")
    (folder / "b.csv").write_text("t\n")
    assert content_hash(file) != content_hash(folder)
    before = content_hash(file)
    assert before == hashlib.sha256(b"t\n").hexdigest()
    file.write_text("t\n1\n")
    assert content_hash(file) != before
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
