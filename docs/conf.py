"""The documentation as a site: `make docs-site` writes it to build/site, with nothing but pip.

The source folder is the project's root, so that the links between README, docs/ and the other pages
are the same here as where the files are read as they are.
"""

import re
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

import torchid

project = "torchid"
release = version = torchid.__version__
html_title = f"torchid {version}"
root_doc = "README"
include_patterns = ["README.md", "CHANGELOG.md", "CONTRIBUTING.md", "docs/*.md", "docs/api/*.rst"]

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
myst_heading_anchors = 6
smartquotes = False
# Names of axes in the tensors' annotations are no references.
suppress_warnings = ["ref.python"]

html_theme = "furo"
html_copy_source = False
# Docstrings write code between single backticks, as Markdown does.
default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_default_options = {"members": True, "exclude-members": "__init__, __new__"}
python_use_unqualified_type_names = True
napoleon_use_ivar = True
napoleon_attr_annotations = False  # a class's signature shows them
napoleon_use_rtype = False
napoleon_custom_sections = [("Class attributes", "Attributes")]
napoleon_numpy_docstring = False

NAVIGATION = {
    "Tutorial": ("tutorial",),
    "How to": ("your-log", "coming-from", "lerobot", "your-quadruped", "log-doctor", "python",
               "export", "pair", "report", "compare", "fleet", "next-experiment"),
    "Reference": ("robots", "effects", "glossary", "equations", "results", "zoo", "controls",
                  "public-truths", "gap-results", "position-results", "speed", "withheld", "trust",
                  "api/*", "../CHANGELOG"),
    "Explanation": ("concepts", "knowledge", "equal-torque", "design", "../CONTRIBUTING"),
}  # fmt: skip
"""Captions, and the pages below each."""


NUMBERS = "Float[Tensor, '*#batch n'] | ndarray | Sequence[Any]"
"""torchid.typing.Numbers, as a signature spells it out."""
_CODE = re.compile(r"(`[^`]*`)")


def plain_text(
    app: Sphinx, what: str, name: str, thing: object, options: Any, lines: list[str]
) -> None:
    """Products, absolute values and primes of the docstrings are no markup; examples stay."""
    for k, line in enumerate(lines):
        if not line.lstrip().startswith((">>>", "...")):
            parts = _CODE.split(line)
            parts[::2] = [re.sub(r"([*|])", r"\\\1", part) for part in parts[::2]]
            lines[k] = "".join(parts)


def short_types(*event: Any) -> tuple[str | None, str | None]:
    """Signatures say `Numbers` for what may be a tensor, an array or lists."""
    given, back = event[-2:]
    return given and given.replace(NUMBERS, "Numbers"), back


def add_navigation(app: Sphinx, page: str, source: list[str]) -> None:
    """The README is the first page; where it is read as a file it needs no table of contents."""
    if page != root_doc:
        return
    for caption, pages in NAVIGATION.items():
        names = "\n".join(f"docs/{p}".replace("docs/../", "") for p in pages)
        source[0] += f"\n```{{toctree}}\n:hidden:\n:glob:\n:caption: {caption}\n\n{names}\n```\n"


def add_index(app: Sphinx, error: Exception | None) -> None:
    """Servers and people open index.html first."""
    if error is None:
        text = f'<meta http-equiv="refresh" content="0; url={root_doc}.html">\n'
        (Path(app.outdir) / "index.html").write_text(text)


def setup(app: Sphinx) -> dict[str, Any]:
    """Sphinx calls this."""
    app.connect("autodoc-process-docstring", plain_text, priority=400)  # before napoleon
    app.connect("autodoc-process-signature", short_types)
    app.connect("source-read", add_navigation)
    app.connect("build-finished", add_index)
    return {"parallel_read_safe": True}
