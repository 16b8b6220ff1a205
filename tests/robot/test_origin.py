"""A robot's yaml knows the file that it was made from, and an export edits a copy of that."""

import shutil
from pathlib import Path

import pytest

import torchid
from torchid.errors import RobotError
from torchid.robot.writer import to_mapping
from torchid.robot.yaml_file import from_mapping

MESH = '<visual><geometry><mesh filename="meshes/arm.stl"/></geometry></visual>'


def _urdf(folder: Path) -> Path:
    """An arm with a mesh on its last link, and another name of its base."""
    (done,) = torchid.export_dynamics("3r", "urdf", folder, "arm", nominal="3r").files[:1]
    text = done.read_text().replace('<link name="link_3">', f'<link name="link_3">{MESH}')
    done.write_text(text.replace('"base"', '"base_link"').replace('"base_0"', '"base_link"'))
    return done


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    """The yaml of an arm that was read from a URDF, saved twice as two sessions do."""
    torchid.write_robot(_urdf(tmp_path), tmp_path / "monday.yaml")
    torchid.write_robot(tmp_path / "monday.yaml", tmp_path / "friday.yaml")
    return tmp_path / "friday.yaml"


def _exported(saved: Path, folder: str = "out") -> tuple[str, tuple[str, ...]]:
    done = torchid.export_dynamics(saved, "urdf", saved.parent / folder, nominal=saved)
    return done.files[0].read_text(), done.notes


def test_an_export_keeps_the_meshes_of_the_file(saved: Path) -> None:
    text, notes = _exported(saved)
    assert "arm.stl" in text
    assert notes == ()


def test_a_file_that_moved_with_its_yaml_is_found(saved: Path, tmp_path: Path) -> None:
    place = tmp_path / "elsewhere"
    place.mkdir()
    for name in ("arm.urdf", "friday.yaml"):
        shutil.move(tmp_path / name, place / name)
    assert "arm.stl" in _exported(place / "friday.yaml")[0]


@pytest.mark.parametrize("change", ["gone", "changed"])
def test_a_file_that_is_lost_is_one_note_with_the_way_out(saved: Path, change: str) -> None:
    file = saved.with_name("arm.urdf")
    if change == "gone":
        file.unlink()
    else:
        file.write_text(file.read_text().replace("arm.stl", "another.stl"))
    text, notes = _exported(saved)
    assert "stl" not in text
    (note,) = [n for n in notes if "arm.urdf" in n]
    assert "--robot arm.urdf" in note
    assert ("has changed" if change == "changed" else "not there any more") in note


def test_a_file_of_another_format_is_not_read(saved: Path) -> None:
    done = torchid.export_dynamics(saved, "yaml", saved.parent / "out", nominal=saved)
    assert done.original is None
    assert torchid.load_robot(done.files[0]).file == torchid.load_robot(saved).file


def test_an_mjcf_is_found_too(tmp_path: Path) -> None:
    (file, *_) = torchid.export_dynamics("3r", "mjcf", tmp_path, "arm", nominal="3r").files
    text = file.read_text()
    file.write_text(text.replace("<worldbody>", "<worldbody><!-- by hand -->"))
    torchid.write_robot(file, tmp_path / "arm.yaml")
    saved = tmp_path / "arm.yaml"
    done = torchid.export_dynamics(saved, "mjcf", tmp_path / "out", nominal=saved)
    assert "by hand" in done.files[0].read_text()


def test_the_part_of_the_file_is_read_again(tmp_path: Path) -> None:
    robot = torchid.load_robot(_urdf(tmp_path), tip="link_2")
    torchid.write_robot(robot, tmp_path / "part.yaml")
    text, notes = _exported(tmp_path / "part.yaml")
    assert "arm.stl" in text  # of the link that is not part of it
    assert not any("--robot" in note for note in notes)


def test_a_built_in_robot_has_no_file() -> None:
    assert "file" not in to_mapping(torchid.load_robot("3r"))


@pytest.mark.parametrize("file", ["arm.urdf", {"path": "arm.urdf"}, {"path": 3, "sha256": "a"}])
def test_a_damaged_file_key_is_refused(file: object) -> None:
    data = to_mapping(torchid.load_robot("3r")) | {"file": file}
    with pytest.raises(RobotError, match="file"):
        from_mapping(data, "arm.yaml")
