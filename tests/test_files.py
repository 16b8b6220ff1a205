import os
import stat
from contextlib import suppress
from pathlib import Path

import pytest

from torchid.errors import TorchidError
from torchid.files import (
    Staged,
    atomic_write,
    discard,
    probe,
    put_in_place,
    staged,
    write_text,
)


def test_writes_text_and_bytes(tmp_path: Path) -> None:
    with atomic_write(tmp_path / "a.json") as file:
        file.write("é\n")
    with atomic_write(tmp_path / "b.npz", "wb") as file:
        file.write(b"\x00\n")
    assert (tmp_path / "a.json").read_bytes() == "é\n".encode()
    assert (tmp_path / "b.npz").read_bytes() == b"\x00\n"
    assert sorted(os.listdir(tmp_path)) == ["a.json", "b.npz"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_failure_keeps_the_old_file_and_leaves_nothing(
    tmp_path: Path, error: type[BaseException]
) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")

    def write() -> None:
        with atomic_write(path) as file:
            file.write("half of the new")
            raise error

    with pytest.raises(error):
        write()
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_missing_folder(tmp_path: Path) -> None:
    with (
        pytest.raises(TorchidError, match=r"no folder .*nowhere") as info,
        atomic_write(tmp_path / "nowhere" / "a.txt"),
    ):
        pytest.fail("must not get here")
    assert "mkdir" in str(info.value)


def test_folder_and_file_in_the_way(tmp_path: Path) -> None:
    with pytest.raises(TorchidError, match="is a folder"), atomic_write(tmp_path):
        pass
    (tmp_path / "file").write_text("")
    with pytest.raises(TorchidError, match="no folder"), atomic_write(tmp_path / "file" / "a"):
        pass


def test_name_too_long(tmp_path: Path) -> None:
    with (
        pytest.raises(TorchidError, match="cannot be written"),
        atomic_write(tmp_path / ("x" * 300)),
    ):
        pass
    assert os.listdir(tmp_path) == []


def test_full_disk_is_a_clear_error(tmp_path: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("needs /dev/full")
    with pytest.raises(TorchidError, match="No space left"), atomic_write("/dev/full") as file:
        file.write("x" * 100_000)


def test_an_error_about_another_file_is_not_ours(tmp_path: Path) -> None:
    other = tmp_path / "elsewhere" / "x"
    with pytest.raises(FileNotFoundError), atomic_write(tmp_path / "a.txt"):
        other.read_text()
    assert os.listdir(tmp_path) == []


def test_devices_are_written_not_replaced() -> None:
    with atomic_write(os.devnull) as file:
        file.write("gone")
    assert not Path(os.devnull).is_file()


def test_links_are_followed_and_permissions_kept(tmp_path: Path) -> None:
    target, link = tmp_path / "real.txt", tmp_path / "link.txt"
    target.write_text("old")
    target.chmod(0o640)
    link.symlink_to(target)
    with atomic_write(link) as file:
        file.write("new")
    assert link.is_symlink()
    assert target.read_text() == "new"
    assert stat.S_IMODE(target.stat().st_mode) == 0o640


def test_mode_is_checked(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="mode"), atomic_write(tmp_path / "a", "a"):
        pass


def test_two_processes_probe_one_folder(tmp_path: Path, monkeypatch) -> None:
    """Each by a name of its own, which the other does not remove."""
    names = []
    touch = Path.touch

    def seen(path: Path, *more: object) -> None:
        names.append(path.name)
        touch(path)

    monkeypatch.setattr(Path, "touch", seen)
    for _ in range(2):
        probe(tmp_path)
    assert len(set(names)) == 2
    assert not os.listdir(tmp_path)


SET = ("gap.json", "which.png", "model.yaml", "sub.json")


def write_set(folder: Path, text: str) -> Staged:
    files: Staged = {}
    with staged(files):
        for name in SET:
            write_text(folder / name, text)
    return files


def held(folder: Path) -> dict[str, str]:
    return {p.name: p.read_text() for p in folder.iterdir() if not p.name.startswith(".torchid-")}


def test_a_set_has_its_names_at_once_or_not_at_all(tmp_path: Path) -> None:
    files = write_set(tmp_path, "old")
    assert held(tmp_path) == {}
    discard(files)
    assert not os.listdir(tmp_path)
    put_in_place(write_set(tmp_path, "old"))
    assert held(tmp_path) == dict.fromkeys(SET, "old")
    write_text(tmp_path / "stale.png", "old")
    put_in_place(write_set(tmp_path, "new") | {tmp_path / "stale.png": None})
    assert held(tmp_path) == dict.fromkeys(SET, "new")


@pytest.mark.parametrize("after", range(9))
@pytest.mark.parametrize("earlier", [False, True])
def test_whoever_finds_the_json_has_the_whole_set(
    tmp_path: Path, monkeypatch, earlier: bool, after: int
) -> None:
    """Stopped behind so many changes of the folder, as by SIGKILL."""
    if earlier:
        put_in_place(write_set(tmp_path, "old"))
    files = write_set(tmp_path, "new")
    left = iter(range(after))

    def stops(function):
        def counted(*given: object, **more: object) -> None:
            if next(left, None) is None:
                raise SystemExit
            function(*given, **more)

        return counted

    monkeypatch.setattr(os, "replace", stops(os.replace))
    monkeypatch.setattr(Path, "unlink", stops(Path.unlink))
    with suppress(SystemExit):
        put_in_place(files)
    found = held(tmp_path)
    for name in ("gap.json", "sub.json"):
        if found.get(name) == "new":
            assert (found["which.png"], found["model.yaml"]) == ("new", "new")
    if "gap.json" in found:
        others = {found[name] for name in SET if name != "sub.json"}
        assert len(others) == 1, found
    assert after < 6 or found == dict.fromkeys(SET, "new")
