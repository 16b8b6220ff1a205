"""Readers beside those of logs and robots, and what callers give: one clear error at once."""

import json
from functools import partial
from pathlib import Path

import pytest
import torch

import torchid
from tests.app.conftest import command as command
from tests.robustness.bad_logs import csv, motion
from torchid.errors import TorchidError
from torchid.report.explain import report_of_file

MERGED = "\n".join(
    [
        "a0: &a0 {k: 1}",
        *(f"a{k}: &a{k} {{<<: [{', '.join([f'*a{k - 1}'] * 9)}]}}" for k in range(1, 9)),
    ]
)
Z = torch.zeros
SERVOS = partial(torchid.ServoArm.of, "3r", kp=260.0, damping=22.0)


@pytest.mark.parametrize(
    ("text", "said"), [("", "is not a robot description"), (MERGED, "merges .* make more than")]
)
def test_models_of_no_robot(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "arm.yaml"
    file.write_text(text)
    for read in (torchid.load_model, torchid.load_robot):
        with pytest.raises(TorchidError, match=said):
            read(file)


@pytest.mark.parametrize(
    "shapes", [((3, 3), (2, 3), (3, 3)), ((4, 5, 3), (3, 5, 3), (5, 3)), ((3, 3), (3, 3), (2, 3))]
)
def test_signals_of_unequal_lengths(shapes) -> None:
    signals = [Z(shape) for shape in shapes]
    model = torchid.load_model("3r")
    servos = torchid.load_model(SERVOS())
    for torque in (model.torque, model.forward_dynamics, partial(servos.torque, t=Z(3))):
        with pytest.raises(TorchidError, match="do not go together"):
            torque(*signals)


@pytest.mark.parametrize("count", [0.5, 1e9, 10**9, 0, "3", None, True])
def test_draws_that_cannot_be_made(count) -> None:
    for model in (torchid.load_model("3r"), torchid.load_model(SERVOS())):
        with pytest.raises(TorchidError, match="so many models cannot be drawn"):
            model.sample(count)


@pytest.mark.parametrize(
    ("key", "value"),
    [("columns", 3), ("rows", [[1]]), ("title", None), ("names", [[]]), ("note", {})],
)
def test_what_was_printed_and_is_changed(tmp_path: Path, key: str, value: object) -> None:
    table = {"title": "a", "columns": ["b"], "names": [], "words": [], "rows": [["c"]], "note": ""}
    file = tmp_path / "result.json"

    def said(table: dict) -> object:
        explanation = {"parts": [table]}
        file.write_text(json.dumps({"schema": "torchid.pair/2", "explanation": explanation}))
        return report_of_file(file)[1]

    assert said(table)
    with pytest.raises(TorchidError, match="is not a result as torchid writes it"):
        said(table | {key: value})


@pytest.mark.parametrize("place", ["nope://", "nope://a/b"])
def test_a_store_of_no_protocol(command, tmp_path: Path, place: str) -> None:
    for unit, seed in (("a", 0), ("b", 1)):
        (tmp_path / unit).mkdir()
        (tmp_path / unit / "x.csv").write_bytes(csv(motion(seed=seed)))
    done = command("fleet", "identify", "3r", tmp_path / "a", tmp_path / "b", "--store", place)
    assert (done.code, f"'{place}' cannot be made: Protocol not known" in done.err) == (1, True)


@pytest.mark.parametrize(
    ("changed", "said"),
    [({"q2": [float("nan")]}, "column q2 has 1 values"), ({"t": [0.0]}, "time does not increase")],
)
def test_both_logs_of_a_pair_are_checked(command, tmp_path: Path, changed, said) -> None:
    table = motion()
    for name, values in changed.items():
        table[name][40:41] = values
    (tmp_path / "a.csv").write_bytes(csv(table))
    (tmp_path / "b.csv").write_bytes(csv(motion()))
    for sides in (("a", "b"), ("b", "a")):
        simulated, real = (tmp_path / f"{side}.csv" for side in sides)
        done = command("pair", "--simulated", simulated, "--real", real)
        assert (done.code, said in done.err) == (1, True)
