"""What the zoo calls right, honest, missed, wrong, refused and a crash; its truths; its runner."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.real_logs import FOLDER, NO_LOGS
from torchid.effects.names import NAMES
from torchid.effects.servo import SERVO_KINDS
from torchid.yaml_data import parsed_yaml
from torchid_bench.benchmarks import zoo
from torchid_bench.benchmarks.runner import results

DOCTOR = Path(zoo.ROOT, "torchid", "doctor")
QUANTITIES = {"kp", "base_parameter", "relative_error", "relative_error_moving"}
ROWS = zoo.rows_of()
PUBLIC = zoo.rows_of(zoo.PUBLIC)


def entry(**more: Any) -> dict[str, Any]:
    """A row of the yaml."""
    plain = {"folder": "arm", "known": "?", "commands": ["torchid gap a.urdf b.csv"], "log": "good"}
    return plain | more


def cause(
    effect: str, joints: tuple[int, ...] = (), sure: float = 1.0, **more: Any
) -> dict[str, Any]:
    """A cause of an answer's JSON; sizes as name=(value, std)."""
    instead = more.pop("instead", ())
    return {
        "effect": effect, "file": {}, "probabilities": {}, "located": joints,
        "how_sure": sure, "ambiguous_with": instead,
        "parameters": {n: v for n, (v, _) in more.items()},
        "std": {n: s for n, (_, s) in more.items()},
    }  # fmt: skip


def answer(*causes: dict[str, Any], suspects: tuple[Any, ...] = (), **more: Any) -> dict[str, Any]:
    """A diagnosis' JSON, as far as the zoo reads it."""
    status = more.pop("status", "explained")
    own = {"causes": causes, "suspects": suspects, "small": (), "status": status}
    return {"answer": own, "where": {"joints": ()}} | more


def step(document: dict[str, Any] | None = None, exit: int | None = 0, **more: str) -> Any:
    said = zoo.claims(document) if document else ()
    return zoo.Step("torchid gap a.urdf b.csv", exit, 1.0, claims=said, **more)


def servos(*gains: float | None) -> dict[str, Any]:
    """A diagnosis of positions with these gains, known to 1; None of a ratio."""
    joints = [
        {"joint": k + 1, "kp": kp, "kp_ci95": [None, None] if kp is None else [kp - 2, kp + 2],
         "ratio_only": kp is None, "never_moves": False}
        for k, kp in enumerate(gains)
    ]  # fmt: skip
    return answer() | {"where": {"joints": joints}}


SPRING = [{"is": ["joint_spring"], "joints": [2]}]
FRICTION = [
    {"is": ["coulomb_friction"], "joints": [1, 2], "of": "Fc", "values": [10, 20], "within": 0.1}
]
MASS = [{"is": ["payload"], "of": "m", "value": 2.0, "within": 0.1}]
FC1, FC2 = (cause("coulomb_friction", (j,), Fc=(10.0 * j, 0.1)) for j in (1, 2))
FC2_OPEN, FC2_ROUGH, FC2_OTHER = (
    cause("coulomb_friction", (2,), sure, Fc=(25.0, std))
    for sure, std in ((0.6, 1.0), (1.0, 2.0), (1.0, 1.0))
)
LOAD, LOAD_OR_LINK = cause("payload"), cause("payload", instead=("link_inertia",))
NO_LOAD = {"absent": [{"names": ["payload"]}]}
NO_FRICTION = {"absent": [{"names": ["coulomb_friction"], "joints": [2]}]}
ALL_ELSE = {"absent": [{"names": "all"}], "truths": SPRING}
NOT_TESTABLE = {"effect": "joint_spring", "joints": (2,)}
GAINS = [{"is": ["kp"], "joints": [1, 2, 3], "of": "kp", "equal": 0.1}]


@pytest.mark.parametrize(
    ("verdict", "own", "document"),
    [
        ("right", {"truths": SPRING}, answer(cause("joint_spring", (2,)))),
        ("right", {"truths": SPRING}, answer(cause("joint_spring"))),  # of the whole arm
        ("honest", {"truths": SPRING}, answer(cause("joint_spring", (2,), 0.7))),
        ("honest", {"truths": SPRING}, answer(suspects=(cause("joint_spring", (2,), 0.4),))),
        ("honest", {"truths": SPRING}, answer(cause("payload", instead=("joint_spring",)))),
        ("honest", {"truths": SPRING}, answer(not_testable=(NOT_TESTABLE,))),
        ("honest", {"truths": SPRING}, answer(status="detected_unexplained")),
        ("missed", {"truths": SPRING}, answer(FC1, status="detected_unexplained")),
        ("missed", {"truths": SPRING}, answer(status="no_gap")),
        ("missed", {"truths": SPRING}, answer(cause("joint_spring", (3,)))),
        ("missed", {"truths": SPRING}, answer()),
        ("right", {"truths": FRICTION}, answer(FC1, FC2)),
        ("missed", {"truths": FRICTION}, answer(FC1)),
        ("honest", {"truths": FRICTION}, answer(FC1, FC2_ROUGH)),
        ("wrong", {"truths": FRICTION}, answer(FC1, FC2_OTHER)),
        ("honest", {"truths": FRICTION}, answer(FC1, FC2_OPEN)),
        ("right", {"truths": MASS}, answer(cause("payload", m=(2.1, 0.01)))),
        ("honest", {"truths": MASS}, answer(cause("payload", m=(2.0, 3.0)))),  # not determined
        ("wrong", {"truths": MASS}, answer(cause("payload", m=(-2.0, 0.01)))),
        ("right", NO_LOAD, answer(FC1)),
        ("right", NO_LOAD, answer(cause("payload", sure=0.8))),
        ("wrong", NO_LOAD, answer(LOAD)),
        ("right", NO_LOAD, answer(LOAD_OR_LINK)),
        ("wrong", NO_FRICTION, answer(FC2)),
        ("right", NO_FRICTION, answer(FC1)),
        ("wrong", {"absent": [{"names": "all"}]}, answer(FC1)),
        ("right", ALL_ELSE, answer(cause("joint_spring", (2,)))),
        ("wrong", ALL_ELSE, answer(cause("joint_spring", (2,)), FC1)),
        ("wrong", {"silent": [1]}, answer(FC1)),
        ("right", {"silent": [1]}, answer(FC2)),
        ("honest", {"truths": GAINS}, servos(None, None, None)),
        ("honest", {"truths": GAINS}, servos(100.0, None, None)),
        ("right", {"truths": GAINS}, servos(100.0, 105.0, 101.0)),
        ("wrong", {"truths": GAINS}, servos(58.0, 154.0, 78.0)),
    ],
)  # fmt: skip
def test_an_answer_is_judged_by_what_is_known(
    verdict: str, own: dict[str, Any], document: dict[str, Any]
) -> None:
    row = zoo.row_of("row", entry(**own))
    assert zoo.judged(row, [step(document)])[0] == verdict


@pytest.mark.parametrize(
    ("verdict", "log", "ended"),
    [
        ("crash", "good", step(exit=70)),
        ("crash", "good", step(exit=-9)),
        ("crash", "good", step(exit=None)),
        ("crash", "good", step(exit=1, trouble="Traceback (most recent call last)")),
        ("refused", "good", step(exit=1, trouble="Error: torque is late")),
        ("right", ["late", "lag"], step(exit=1, trouble="Error: torque is late")),
        ("missed", ["late", "lag"], step(exit=1, trouble="Error: degrees")),
        ("missed", ["late", "lag"], step(answer())),
        ("right", ["late", "lag"], step(answer(), complaints="Doubt: a Lag of 2 ms")),
    ],
)
def test_an_end_is_judged_by_the_log(verdict: str, log: Any, ended: Any) -> None:
    assert zoo.judged(zoo.row_of("row", entry(log=log)), [ended])[0] == verdict


def test_commands_before_the_last_only_have_to_run() -> None:
    """Names in a model's first fit are no claims on the log that is asked about."""
    row = zoo.row_of("row", entry(absent=[{"names": "all"}]))
    assert zoo.judged(row, [step(answer(FC1)), step(answer())])[0] == "right"
    assert zoo.judged(row, [step(exit=1), step(answer())])[0] == "refused"


def test_errors_may_be_no_larger_than_a_baselines() -> None:
    truths = [{"is": ["relative_error"], "joints": [1, 2], "at_most": [4.0, 8.0], "within": 0.1}]
    row = zoo.row_of("row", entry(truths=truths))
    errors = {"relative_error_percent": [4.3, 8.0], "relative_error_percent_moving": [9.0, 9.0]}
    fit = {"parameters": [], "effects": [], "bounded": [], "fit": errors}
    assert zoo.judged(row, [step(fit)])[0] == "right"
    fit["held_out"] = errors | {"relative_error_percent": [4.5, 8.0]}
    assert zoo.judged(row, [step(fit)])[0] == "missed"


@pytest.mark.parametrize(
    ("verdict", "mass", "determined"),
    [("right", 2.1, True), ("wrong", 9.0, True), ("wrong", -0.9, True), ("honest", 9.0, False)],
)
def test_a_payload_is_open_where_no_motion_tells_it(
    verdict: str, mass: float, determined: bool
) -> None:
    """A load below zero is said for sure, too."""
    row = zoo.row_of("row", entry(truths=MASS))
    own = {"names": ["m"], "value": [mass], "covariance": [[0.01]], "determined": [determined]}
    document = {"frames": {}, "parameters": own, "seen": mass > 0}
    assert zoo.judged(row, [step(document)])[0] == verdict


def test_the_doctor_claims_what_is_wrong_alone() -> None:
    row = zoo.row_of("row", entry(absent=[{"names": ["gravity"]}]))
    for verdict, wanted in (("wrong", "wrong"), ("doubtful", "right"), ("fine", "right")):
        check = {"name": "gravity", "verdict": verdict, "joints": [1], "evidence": ""}
        assert zoo.judged(row, [step({"checks": [check]})])[0] == wanted


def test_every_folder_has_a_row_with_a_truth() -> None:
    told = {row.folder for row in ROWS.values() if row.truths or row.absent}
    assert len(told) == 14
    if not FOLDER.is_dir():
        pytest.skip(NO_LOGS)
    assert told >= {p.parent.name for p in FOLDER.glob("*/SOURCE.md")}


@pytest.mark.parametrize("row", [*ROWS.values(), *PUBLIC.values()], ids=[*ROWS, *PUBLIC])
def test_truths_are_of_names_that_exist(row: Any) -> None:
    checks = {*parsed_yaml((DOCTOR / "checks.yaml").read_text())}
    for module in DOCTOR.glob("*.py"):
        checks.update(re.findall(r'\b(?:Check|judged)\(\s*"([a-z ]+)"', module.read_text()))
    known = {*NAMES, *SERVO_KINDS, *checks} | QUANTITIES
    names = {n for t in row.truths for n in t.names} | {n for a in row.absent for n in a.names}
    assert names <= known
    assert row.truths or row.absent or row.log
    assert all(t.value or t.kind in ("named", "equal") for t in row.truths)
    assert all(command.startswith("torchid ") for command in row.commands)


def test_public_truths_have_a_source_with_its_licence() -> None:
    assert all(re.search(r"^https://\S+.*(licence|MIT|Apache)", r.source) for r in PUBLIC.values())
    assert not any(row.source for row in ROWS.values())


@pytest.mark.parametrize(
    "broken", [{"truth": []}, {"truths": [{"joints": [1]}]}, {"absent": [{"joints": [1]}]}],
    ids=["an unknown key", "a truth without a name", "absent without names"],
)  # fmt: skip
def test_an_entry_of_another_schema_is_noticed(broken: dict[str, Any]) -> None:
    with pytest.raises((KeyError, ValueError)):
        zoo.row_of("row", entry(**broken))


def test_a_row_runs_and_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in for torchid answers: rows are kept whole, pages are made of them, and what was
    asked otherwise counts no more."""
    data, work = tmp_path / "data", tmp_path / "work"
    (data / "arm").mkdir(parents=True)
    (data / "arm" / "b.csv").write_text("t,q1\n")
    (tmp_path / "torchid.py").write_text(
        "import sys, json\nopen('b.csv').close()\n"
        f"json.dump({answer(FC1)!r}, open(sys.argv[-1], 'w'))\nprint('Friction.')\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(zoo, "_headline", lambda *_: "Friction.")
    row = zoo.row_of("row", entry(truths=[{"is": ["coulomb_friction"], "joints": [1]}]))
    monkeypatch.setattr(zoo, "ANSWERS", tmp_path / "answers")
    list(results(zoo.measured, {zoo.key(row): (row, data, work, 60.0)}, work))
    assert json.loads((tmp_path / "answers" / "zoo_row_0.json").read_text())["answer"]
    steps = zoo.kept_steps(row, work)
    assert [s.exit for s in steps] == [0]
    assert steps[0].seconds > 0
    text = zoo.page_of({"row": (row, steps)}, ["row", "later"])
    assert (
        "Friction. | coulomb_friction 1 | 1 of 1 right; right: coulomb_friction 1 | **right**"
        in text
    )
    assert "1 rows: 1 right" in text
    assert "Not measured yet: later." in text
    row = replace(row, source="https://arm at 1; MIT", published="7 %")
    text = zoo.page_of({"row": (row, steps)}, ["row"], public=True)
    assert "right: coulomb_friction 1 | 7 % | **right** |" in text
    assert "- https://arm at 1; MIT\n" in text
    assert (
        zoo.kept_steps(zoo.row_of("row", entry(commands=["torchid gap a.urdf c.csv"])), work) == ()
    )
    monkeypatch.setattr(zoo, "code", lambda: "other")
    assert zoo.kept_steps(row, work) == ()


def test_a_command_that_takes_too_long_is_a_crash(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "torchid.py").write_text("import time\ntime.sleep(60)\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert zoo.run_command("torchid gap", tmp_path, "answer.json", limit=0.1).exit is None


def test_without_logs_it_says_so_and_ends_well(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert zoo.main(data=tmp_path / "absent") == 0
    assert capsys.readouterr().out.startswith("The zoo is skipped: no folder of real logs at")


def test_rows_whose_folder_is_absent_are_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert zoo.main(data=tmp_path, work=tmp_path / "w") == 0
    assert capsys.readouterr().out == f"Not there, so left out: {', '.join(ROWS)}.\n"
