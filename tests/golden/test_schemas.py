"""No key of any document is lost, and none changes its type: other programs read them."""

import json
from pathlib import Path
from typing import Any

import pytest

import torchid
from tests.golden.documents import DOCUMENTS, LONG, SLOW, Bench
from tests.golden.shapes import losses, shape
from tests.torchid_bench.withheld.fakes import plant
from torchid.app.output import Output

__all__ = ["plant"]

STORED = Path(__file__).parent / "schemas"
AGAIN = "meant so? python -m tests.golden.write schemas"


NO_RESULTS = ("effects", "excite", "log_show", "robot", "simulate")
"""Documents of commands that say what there is, or what they wrote."""


@pytest.fixture(autouse=True)
def files_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every command has written its JSON before it says anything: printing can fail."""

    def say(self: Output, *objects: object) -> None:
        self.finish()  # with which the true one begins, too
        assert self.json_file is None or self.json_file.exists(), objects

    monkeypatch.setattr(Output, "say", say)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    return Bench(tmp_path_factory.mktemp("golden"))


def _marked(name: str) -> Any:
    mark = pytest.mark.nightly if name in LONG else pytest.mark.slow
    return pytest.param(name, marks=mark) if name in (*SLOW, *LONG) else name


@pytest.mark.parametrize("name", list(map(_marked, DOCUMENTS)))
def test_documents_have_what_they_had(name, bench, plant, types_unchecked, tmp_path) -> None:
    document = DOCUMENTS[name](bench)
    if name not in NO_RESULTS:
        are_read_back(document, tmp_path)
    if name.startswith("gap_"):
        assert document["status"] == name.removeprefix("gap_")
    stored = json.loads((STORED / f"{name}.json").read_text())
    found = losses(stored, shape(document))
    assert not found, "\n".join([*found, AGAIN])


def are_read_back(document: dict[str, Any], folder: Path) -> None:
    """A result is read as it was written, and shows itself."""
    (folder / "given.json").write_text(json.dumps(document))
    found = torchid.load(folder / "given.json")
    assert found.schema == document["schema"]
    found.save(folder / "again.json")
    # Of the files beside a command's own JSON another file says nothing.
    own = {k: v for k, v in document.items() if k != "hashes"}
    assert json.loads((folder / "again.json").read_text()) == own
    assert len(repr(found).splitlines()) == 1
    assert len(found.to_frame()) == len(found.table)
    assert found._repr_html_().startswith("<p>")


def test_every_document_has_a_golden_file() -> None:
    assert {path.stem for path in STORED.glob("*.json")} == set(DOCUMENTS)


BEFORE = {
    "status": "explained",
    "which": [{"effect": "a", "std": {"Fc": 1.0}}, {"effect": "b", "std": {}}],
    "closed": 0.5,
    "model": {"mass": [1.0]},
}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"closed": None}, ["closed: was number, is also null"]),
        ({"status": 3}, ["status: was string, is also number"]),
        ({"model": {}}, ["model.mass: gone", "model.mass[]: gone"]),
        ({"model": {"mass": []}}, []),
        ({"which": []}, []),
        ({"which": [{"effect": "a"}]}, ["which[].std: gone", "which[].std.*: gone"]),
        ({"which": [{"effect": "a", "std": {"Fv": 2}}]}, []),
        ({"which": [{"effect": "a", "std": {"Fv": "2"}}]},
         ["which[].std.*: was number, is also string"]),
        ({"more": 1}, []),
    ],
)  # fmt: skip
def test_a_loss_is_said_and_a_gain_is_not(change, said) -> None:
    assert losses(shape(BEFORE), shape(BEFORE | change)) == said
