"""Sets are written whole, read as they were written, and their keys stay what they were."""

import json
import re

import pytest

from tests.torchid_bench.withheld.fakes import arm, draw_case, simulate_case
from torchid import __version__
from torchid.errors import TorchidError
from torchid.log.readers import read_log
from torchid.robot.library import load_robot
from torchid_bench.withheld.case_set import keys_beside, make, read_cases, read_keys, sha256


@pytest.fixture
def made(plant, tmp_path):
    return make(tmp_path / "set", 3, seed=7)


def test_a_set_is_read_as_it_was_written(made):
    found = read_cases(made.folder)
    assert found == made
    assert found.ids == ("case-0001", "case-0002", "case-0003")
    assert (found.seed, found.version) == (7, __version__)
    log = read_log(found.logs("case-0002"))
    columns = simulate_case(draw_case(7, 1)).columns
    assert log.tau[:, 1].tolist() == columns["tau2"].tolist()
    assert len(log.names) == 3
    robot = load_robot(found.robot("case-0002"))
    assert robot.require_parameters("a test").pi.tolist() == arm().parameters.pi.tolist()


def test_keys_are_sealed_and_apart(made):
    path = keys_beside(made.folder)
    assert sha256(path.read_bytes()) == made.keys_sha256
    keys = read_keys(made, path)
    assert [k["id"] for k in keys] == list(made.ids)
    assert [k["kind"] for k in keys] == ["single", "outside", "none"]


def test_nothing_in_the_folder_tells_the_kind(made):
    files = [p for p in made.folder.rglob("*") if p.is_file()]
    assert sorted({p.name for p in files}) == ["cases.json", "log.parquet", "robot.urdf"]
    listed = (made.folder / "cases.json").read_text()
    assert not re.search("single|outside|none|coulomb|drag", listed)


def test_a_changed_byte_of_the_keys_is_refused(made):
    path = keys_beside(made.folder)
    content = path.read_bytes()
    path.write_bytes(content.replace(b"coulomb", b"Coulomb", 1))
    with pytest.raises(TorchidError, match="not the key file that was sealed"):
        read_keys(made, path)
    path.write_bytes(content + b" ")
    with pytest.raises(TorchidError, match="not the key file that was sealed"):
        read_keys(made, path)


def test_a_smaller_set_is_the_beginning_of_a_larger_one(made, plant, tmp_path):
    small = make(tmp_path / "small", 2, seed=7)
    for case in small.ids:
        assert small.logs(case)[0].read_bytes() == made.logs(case)[0].read_bytes()
    other = make(tmp_path / "other", 1, seed=8)
    assert other.logs("case-0001")[0].read_bytes() != made.logs("case-0001")[0].read_bytes()


def test_what_is_there_is_not_overwritten(made, plant, tmp_path):
    before = keys_beside(made.folder).read_bytes()
    with pytest.raises(TorchidError, match="holds a set"):
        make(made.folder, 1, seed=1, keys=tmp_path / "new.json")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").touch()
    with pytest.raises(TorchidError, match="not an empty folder"):
        make(tmp_path / "full", 1, seed=1)
    with pytest.raises(TorchidError, match="never overwritten"):
        make(tmp_path / "new", 1, seed=1, keys=keys_beside(made.folder))
    assert keys_beside(made.folder).read_bytes() == before
    assert not (tmp_path / "new").exists()


def test_cases_of_positions_have_one_mix(tmp_path):
    with pytest.raises(TorchidError, match="unknown mix"):
        make(tmp_path / "set", 1, seed=1, kind="position", mix="release")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("kind", "mix"), [("torque", "background"), ("position", "position_background")]
)
def test_arms_have_a_background_whatever_their_logs_have(plant, tmp_path, kind, mix):
    given = []

    def drawn(seed, number, **what):
        given.append(what)
        return plain(seed, number)

    plain, plant.draw_case = plant.draw_case, drawn
    make(tmp_path / "set", 2, seed=1, kind=kind, background=0.15)
    again = read_cases(tmp_path / "set")
    assert (again.kind, again.background) == (kind, 0.15)
    assert given == [{"mix": mix, "background": 0.15}] * 2
    with pytest.raises(TorchidError, match="a background is of arms"):
        make(tmp_path / "other", 2, seed=1, kind=kind, robots="tree", background=0.15)


def test_keys_cannot_lie_among_the_cases(plant, tmp_path):
    with pytest.raises(TorchidError, match="must not lie in"):
        make(tmp_path / "set", 1, seed=1, keys=tmp_path / "set" / "keys.json")


def test_a_set_is_there_whole_or_not_at_all_and_goes_on_where_it_stopped(plant, tmp_path):
    made = []

    def broken(spec):
        if spec.number == 1 and len(made) < 2:
            made.append("broken")
            raise TorchidError("it diverged.")
        made.append(spec.number)
        return simulate_case(spec)

    plant.simulate_case = broken
    with pytest.raises(TorchidError, match="diverged"):
        make(tmp_path / "set", 2, seed=1)
    assert not (tmp_path / "set").exists()
    assert not keys_beside(tmp_path / "set").exists()
    found = make(tmp_path / "set", 2, seed=1)
    assert made == [0, "broken", 1]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["set", "set.keys.json"]
    assert sorted(p.name for p in found.folder.iterdir()) == [*found.ids, "cases.json"]
    assert [key["id"] for key in read_keys(found, keys_beside(found.folder))] == list(found.ids)


def test_a_damaged_set_is_refused(made):
    path = made.folder / "cases.json"
    data = json.loads(path.read_text())
    for changed, words in (
        ("{", "is not JSON"),
        ("[]", "is not a list of withheld cases"),
        (json.dumps(data | {"schema": "other/1"}), "another schema"),
        (json.dumps({k: v for k, v in data.items() if k != "seed"}), "incomplete"),
        (json.dumps(data | {"cases": []}), "lists no case"),
        (json.dumps(data | {"cases": ["case-0009"]}), "there is no"),
        (json.dumps(data | {"cases": ["../case-0001"]}), "no folder in the set"),
        (json.dumps(data | {"cases": [".."]}), "no folder in the set"),
    ):
        path.write_text(changed)
        with pytest.raises(TorchidError, match=words):
            read_cases(made.folder)
    with pytest.raises(TorchidError, match="there is no folder"):
        read_cases(made.folder / "nowhere")
