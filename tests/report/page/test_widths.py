"""The answer is read without scrolling: on a desk above the fold, on a phone in its width."""

import json
import re
import shutil
import subprocess

import pytest

from tests.gap.diagnoses import FRICTION, OFFSET, VISCOUS, cause, diagnosis
from tests.report.test_gap_page import SHORT, made
from torchid.effects.friction import CoulombFriction
from torchid.gap.cause_records import body_cause
from torchid.report.diagnosis import page
from torchid.report.page.document import render

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), ""
)
FRAME = """<iframe id="page" src="page.html" style="width:{width}px;height:{height}px"></iframe>
<script>
document.getElementById("page").onload = (event) => {{
  const page = event.target.contentDocument, answer = page.querySelector("#answer .bars");
  const cells = [...answer.querySelectorAll("td, th")].map(c => c.getBoundingClientRect().right);
  document.body.innerHTML = JSON.stringify({{
    "wide": page.documentElement.scrollWidth, "right": Math.max(...cells),
    "high": page.documentElement.scrollHeight, "bottom": answer.getBoundingClientRect().bottom,
  }});
}};
</script>"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A page with several causes, a set, and links."""
    other = cause(CoulombFriction(2), 0.3, 0.02, how_sure=0.999, share=0.9)
    found = diagnosis(
        causes=(FRICTION, other, VISCOUS, OFFSET, body_cause((2,), share=0.1)),
        **SHORT,
    )  # fmt: skip
    folder = tmp_path_factory.mktemp("page")
    (folder / "page.html").write_text(render(page(found, made())))
    return folder


@pytest.mark.slow
@pytest.mark.skipif(not CHROMIUM, reason="Chromium is not installed")
@pytest.mark.parametrize(("width", "height"), [(390, 844), (1400, 900)])
def test_the_answer_fits(folder, width, height):
    frame = folder / f"frame_{width}.html"
    frame.write_text(FRAME.format(width=width, height=height))
    asked = [
        CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--allow-file-access-from-files",
        "--virtual-time-budget=3000", "--dump-dom", f"--user-data-dir={folder}/profile",
        "--window-size=1600,1200", frame.as_uri(),
    ]  # fmt: skip
    done = subprocess.run(asked, capture_output=True, text=True, timeout=120, check=True)
    measured = json.loads(re.search(r"\{.*\}", done.stdout).group())
    assert measured["wide"] <= width
    assert measured["right"] <= width
    if width > 1000:
        assert measured["bottom"] <= height
        assert measured["high"] < 3000
