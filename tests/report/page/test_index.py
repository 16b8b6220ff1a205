"""An index lists every result below a folder, with links that work from where it lies."""

import json

import pytest

from tests.gap.diagnoses import diagnosis
from tests.report.page.reading import Balanced
from torchid.errors import TorchidError
from torchid.report.page.index import entries, report_of_folder, write_index


@pytest.fixture
def folder(tmp_path):
    """Two results, one of them with a page, and a JSON that is none."""
    for name in ("a run", "b"):
        (tmp_path / "results" / name).mkdir(parents=True)
        diagnosis().save(tmp_path / "results" / name / "gap.json")
    (tmp_path / "results" / "a run" / "gap.html").write_text("<p>page</p>")
    (tmp_path / "results" / "notes.json").write_text(json.dumps({"mine": 1}))
    return tmp_path / "results"


def test_links_lead_from_the_page_to_the_files(folder, tmp_path):
    page = write_index(folder, tmp_path / "index.html")
    text = page.read_text()
    reader = Balanced()
    reader.feed(text)
    assert diagnosis().answer.headline.split(":")[0] in text
    links = [part.split('"')[0] for part in text.split('href="')[1:]]
    assert set(links) == {"results/a%20run/gap.html", "results/a%20run/gap.json",
                          "results/b/gap.json"}  # fmt: skip
    assert "notes.json" not in text
    assert "<script" not in text


def test_the_terminal_lists_the_same(folder):
    assert [e.headline for e in entries(folder)] == [diagnosis().answer.headline] * 2
    shown = report_of_folder(folder, entries(folder))
    assert shown.verdict.startswith("2 results below")
    assert len(shown.parts[0].rows) == 2


def test_nothing_to_list(tmp_path):
    with pytest.raises(TorchidError, match="holds no result"):
        entries(tmp_path)
    with pytest.raises(TorchidError, match="no such folder"):
        entries(tmp_path / "none")
