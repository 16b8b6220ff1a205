"""Results are read back, and from then on are worth as much as what was computed; that of every
command is read back where its document is compared (tests/golden)."""

import json
from dataclasses import dataclass
from pathlib import Path

import pytest

import torchid
from tests.arms import arm
from tests.fleet.records import identification
from torchid.errors import MissingExtraError, TorchidError
from torchid.gap.record import GapRecord
from torchid.report.explain import report_of_file
from torchid.results.files import RECORDS, require_result


def test_every_schema_has_a_record() -> None:
    from importlib import import_module

    for kind, place in RECORDS.items():
        module, _, name = place.partition(":")
        record = getattr(import_module(module), name)
        assert kind.partition(" ")[0] == record.__struct_config__.tag


@pytest.mark.slow
def test_the_cell_of_a_notebook(tmp_path: Path) -> None:
    robot = torchid.load_robot("3r")
    motion = torchid.excite(robot, duration=12.0, restarts=1, iterations=0).log()
    friction = {"effect": "coulomb_friction", "joint": 2, "Fc": 0.6}
    log = torchid.simulate(robot, motion, effects=[friction], seed=3)
    effects = ("coulomb_friction", "viscous_friction", "joint_spring")
    settings = torchid.GapSettings(effects=effects)

    d = torchid.diagnose(robot, log, settings=settings)
    assert "coulomb_friction" in repr(d)
    assert "Coulomb friction on joint 2" in d._repr_html_()
    frame = d.effects.to_frame()
    assert frame["effect"].tolist() == ["coulomb_friction"]
    assert frame["joints"].tolist() == [[2]]  # as people count
    figure = d.plot("where")
    assert len(figure.axes) >= 2
    d.save(tmp_path / "gap.json")
    again = torchid.load(tmp_path / "gap.json")
    assert isinstance(again, GapRecord)
    assert again.plain() == d.plain()
    # What is read back is drawn alike.
    texts = [[t.get_text() for axes in f.axes for t in axes.texts] for f in (figure, again.plot())]
    assert texts[0] == texts[1]
    assert len(again.plot("where").axes) == len(figure.axes)
    with pytest.raises(TorchidError, match="no such figure") as caught:
        again.plot("torque")
    assert "where" in caught.value.available
    assert d.plot("torque", joint=1).axes
    with pytest.raises(TorchidError, match="takes no joint"):
        d.plot("where", joint=1)


@pytest.mark.slow
def test_the_next_motion_of_an_identification(tmp_path: Path) -> None:
    robot = arm("3r_friction")
    path = identification(tmp_path / "a.json", 0, robot=robot)
    data = json.loads(path.read_text())
    data["rows"] = {"seconds": 10.0, "per_second": 20.0, "whitening": [[10.0, 0, 0], [0, 10, 0],
                                                                      [0, 0, 10]]}  # fmt: skip
    path.write_text(json.dumps(data))
    found = torchid.load(path)
    design = found.next_motion(duration=6.0, restarts=1)
    assert design.shrinks(design.after) <= design.shrinks(design.with_plain)
    assert found.plot().axes


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "not JSON"),
        ("[1]", "Expected `object`"),
        ("{}", "`schema`"),
        ('{"schema": 3}', r"\$\.schema"),
        ('{"schema": "torchid.gap/2"}', "not a result"),
        ('{"schema": "torchid.wrenches/1"}', "not a result"),
        ('{"schema": "torchid.gap/2", "robot": "x", "status": "fine"}', r"\$\.status"),
        ("[" * 100000, "Expected `object`"),
        ('{"schema": "torchid.gap/2", "x": ' + "[" * 100000, "not JSON"),
        ('{"schema": "torchid.gap/2", "robot": ' + "9" * 5000 + "}", r"(?s)not .*"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "x.json"
    path.write_text(text)
    with pytest.raises(TorchidError, match=said) as caught:
        torchid.load(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("read", [torchid.load, report_of_file, require_result])
@pytest.mark.parametrize(
    ("schema", "known"), [("torchid.gap/1", "torchid.gap/2"), ("torchid.pair/1", "torchid.pair/2")]
)
def test_files_of_another_version_are_refused(tmp_path: Path, read, schema, known) -> None:
    """Whatever they hold: the error has what was got, what is read, and what to do."""
    path = tmp_path / "x.json"
    path.write_text(json.dumps({"schema": schema, "robot": "x", "explanation": {"parts": ["a"]}}))
    with pytest.raises(TorchidError) as caught:
        read(path)
    error = caught.value
    assert (error.got, error.available) == (f"schema {schema}, of another version", [known])
    assert "run the command that wrote it again" in str(error)


def test_bytes_that_are_no_text_and_no_file(tmp_path: Path) -> None:
    (tmp_path / "x.json").write_bytes(b"\x80\xff\x00")
    with pytest.raises(TorchidError, match="not JSON"):
        torchid.load(tmp_path / "x.json")
    with pytest.raises(TorchidError, match="cannot be read"):
        torchid.load(tmp_path)


def test_frames_need_pandas(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingExtraError, match="frames"):
        torchid.check(arm("3r")).to_frame()


@dataclass(frozen=True)
class Made:
    """A result in memory, and the kinds of its figures."""

    make: object
    kinds: tuple[str, ...]


def _identified() -> object:
    robot = torchid.load_robot("3r")
    motion = torchid.excite(robot, duration=8.0, restarts=1, iterations=0).log()
    log = torchid.simulate(robot, motion, seed=0)
    return torchid.identify(robot, log, settings=torchid.Settings(effects=(), cutoff=10.0))


def _atlas() -> object:
    result = _identified()
    problem, _ = torchid.problem_of(torchid.load_robot("3r"), result, bounds="normal")
    return torchid.atlas(problem, only=["m3", "m2"])


MADE = {
    "check": Made(lambda: torchid.check(arm("3r")), ()),
    "sets": Made(lambda: torchid.check(arm("3r_friction")).sets, ()),
    "identification": Made(_identified, ("parameters", "torque")),
    "atlas": Made(_atlas, ("ranges",)),
    "examination": Made(
        lambda: torchid.examine(
            torchid.load_robot("3r"),
            torchid.simulate(
                torchid.load_robot("3r"),
                torchid.excite(
                    torchid.load_robot("3r"), duration=8.0, restarts=1, iterations=0
                ).log(),
            ),
        ),
        ("torque",),
    ),
}


@pytest.mark.parametrize("name", MADE)
def test_results_in_memory_can_what_their_files_can(name: str, tmp_path: Path) -> None:
    made = MADE[name]
    result = made.make()
    assert len(repr(result).splitlines()) == 1
    assert len(repr(result)) < 200
    result.save(tmp_path / "result.json")
    assert torchid.load(tmp_path / "result.json").plain() == result.plain()
    assert len(result.to_frame()) == len(result.record.table)
    for kind in made.kinds:
        assert result.plot(kind).axes
    with pytest.raises(TorchidError, match="no such figure") as caught:
        result.plot("nothing")
    assert caught.value.available == list(made.kinds)
