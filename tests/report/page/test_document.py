"""Writing a page, and a browser's look at it."""

import html
import re
import shutil
import subprocess
import sys
from functools import partial

import pytest

from tests.gap.diagnoses import diagnosis
from tests.report.page.reading import parsed
from tests.report.test_gap_page import SHORT, made
from torchid.errors import MissingExtraError, TorchidError
from torchid.report.diagnosis import page as gap_page
from torchid.report.page import document as rendering
from torchid.report.page.document import input_files, render, require_page, write_page

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")


@pytest.fixture(scope="module")
def page():
    return gap_page(diagnosis(**SHORT), made())


def test_without_jinja2(page, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "jinja2", None)
    for attempt in (require_page, partial(write_page, page)):
        with pytest.raises(MissingExtraError, match=r"pip install 'torchid\[report\]'"):
            attempt(tmp_path / "page.html")
    assert not list(tmp_path.iterdir())


def test_written_whole_or_not_at_all(page, monkeypatch, tmp_path):
    path = tmp_path / "page.html"
    path.write_text("old")

    def fail(picture):
        raise TorchidError("cannot be drawn")

    monkeypatch.setattr(rendering, "inline_svg", fail)
    with pytest.raises(TorchidError):
        write_page(page, path)
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["page.html"]


def test_hashes(tmp_path):
    folder = tmp_path / "data"
    (folder / "sub").mkdir(parents=True)
    (folder / "a.csv").write_bytes(b"")
    (folder / "sub" / "b.csv").write_bytes(b"abc")
    found = input_files([("log", "data", folder), ("robot", "r", folder / "a.csv")])
    empty = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
    abc = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert [(f.role, f.name, f.size, f.sha256) for f in found] == [
        ("log", "data/a.csv", 0, empty),
        ("log", "data/sub/b.csv", 3, abc),
        ("robot", "r", 0, empty),
    ]
    with pytest.raises(TorchidError, match="cannot be read"):
        input_files([("log", "x", tmp_path / "missing")])


@pytest.mark.slow
def test_every_theme_colour_is_given_for_light_and_dark(page):
    text = render(page)
    (style,) = parsed(text).iter("style")
    light, dark = re.findall(r":root \{(.*?)\}", style.text, re.S)
    used = set(re.findall(r"var\(--([a-z]+)", text)) - {"width"}
    named = [set(re.findall(r"--([a-z]+):", part)) for part in (light, dark)]
    assert used <= named[0]
    assert named[0] - named[1] == {"serif", "sans", "mono"}


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no chromium")
@pytest.mark.parametrize("width", [390, 1280])
def test_no_sideways_scroll(page, tmp_path, width):
    """The browser itself says how wide the page is in a frame of a phone's and a desk's width, by
    a script, which the page itself forbids."""
    frame = html.escape(re.sub(r"<meta http-equiv[^>]*>", "", render(page)))
    (tmp_path / "page.html").write_text(
        f'<iframe srcdoc="{frame}" style="width:{width}px;height:900px;border:0"></iframe>'
        "<script>onload = () => { const d = document.querySelector('iframe').contentDocument;"
        "document.body.dataset.widths = d.documentElement.scrollWidth + ' ' +"
        "d.documentElement.clientWidth }</script>"
    )
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-quic",
               "--disable-background-networking", "--disable-component-update", "--disable-sync",
               "--hide-scrollbars", "--window-size=1400,1000"]  # fmt: skip
    done = subprocess.run(
        [CHROMIUM, *options, f"--user-data-dir={tmp_path}/user", "--dump-dom",
         (tmp_path / "page.html").as_uri()],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    found = re.search(r'data-widths="(\d+) (\d+)"', done.stdout)
    assert found, done.stderr[-500:]
    assert int(found[1]) <= int(found[2]) == width
