"""Commands follow from functions, and results are kept under names of their arguments."""

import runpy
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import pytest

from torchid_bench.benchmarks.runner import command, digest, results

FOLDER = Path(__file__).parents[3] / "torchid_bench" / "benchmarks"
COMMANDS = [
    file for file in sorted([*FOLDER.glob("*.py"), FOLDER / "targets" / "table.py"])
    if '\nif __name__ == "__main__"' in file.read_text()
]  # fmt: skip
OWN = ("torchid", "torchid_bench", "torchid_study", "tests")


@pytest.mark.parametrize("file", COMMANDS, ids=lambda file: file.stem)
def test_every_benchmark_has_a_command(
    file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What it imports is there, and its functions' arguments are options."""
    monkeypatch.setattr("sys.argv", [file.name, "--help"])
    try:
        with pytest.raises(SystemExit) as done:
            runpy.run_path(str(file), run_name="__main__")
    except ModuleNotFoundError as missing:
        if str(missing.name).split(".")[0] in OWN:
            raise
        pytest.skip(f"needs {missing.name}")
    assert done.value.code == 0
    assert "usage:" in capsys.readouterr().out


GIVEN: list[dict[str, Any]] = []


def some(
    data: Path,
    *,
    sizes: Sequence[float] = (2.0,),
    logs: tuple[str, ...] = (),
    model: tuple[Path, Path] | None = None,
    start: Literal["rigid", "friction"] = "rigid",
    score: bool = False,
) -> int:
    GIVEN.append({"data": data, "sizes": sizes, "logs": logs, "model": model, "start": start})
    return int(score)


def test_options_are_of_their_types() -> None:
    GIVEN.clear()
    command(some, words=["x"])
    words = "x --sizes 1 2 --logs a,b --model m.yaml b.csv --start friction"
    command(some, words=words.split())
    plain = {"data": Path("x"), "sizes": (2.0,), "logs": (), "model": None, "start": "rigid"}
    asked = {"sizes": [1.0, 2.0], "logs": ("a", "b"), "start": "friction"}
    model = [Path("m.yaml"), Path("b.csv")]
    assert [plain, {**plain, **asked, "model": model}] == GIVEN
    with pytest.raises(SystemExit, match="1"):
        command(some, words=["x", "--score"])


@pytest.mark.parametrize("words", ["x --model m.yaml", "x --start both", "x --sizes a", ""])
def test_bad_words_end_with_the_usage(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        command(some, words=words.split())
    assert "usage:" in capsys.readouterr().err


def test_results_are_kept_but_for_errors(tmp_path: Path) -> None:
    made: list[str] = []

    def made_of(name: str, error: str) -> dict[str, str]:
        made.append(name)
        return {"name": name, "error": error}

    cases = {"good": ("good", ""), "bad": ("bad", "no memory")}
    first, again = (dict(results(made_of, cases, tmp_path)) for _ in range(2))
    assert first == again == {name: made_of(*case) for name, case in cases.items()}
    assert made[:3] == ["good", "bad", "bad"]
    assert [file.name for file in tmp_path.iterdir()] == ["good.json"]


def test_other_arguments_have_another_digest() -> None:
    assert digest("ur10e", True) == digest("ur10e", True) != digest("ur10e", False)
