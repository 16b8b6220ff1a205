"""Links lead somewhere, pictures exist and are used, and every command on a page is one."""

import doctest
import re
from pathlib import Path

import pytest
import typer

from tests.documents import PAGES, ROOT, anchors, blocks, commands, links, named_files
from torchid.app.commands import app

_COMMANDS = [
    pytest.param(arguments, id=f"{page.name}-{k}")
    for page in PAGES
    for k, arguments in enumerate(commands(page))
]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in links(page):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, anchor = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        assert file.exists(), f"{page.name} links to {target}, which does not exist"
        assert ROOT in file.parents, f"{page.name} links out of the project: {target}"
        if anchor:
            assert anchor in anchors(file), f"{page.name}: {target} has no such heading"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_files_that_are_named_exist(page: Path) -> None:
    missing = [name for name in named_files(page) if not (ROOT / name).exists()]
    assert not missing, f"{page.name} names {', '.join(missing)}"


def test_pages_need_no_other_host() -> None:
    pictures = [(p.name, t) for p in PAGES for t in links(p) if t.endswith((".png", ".svg"))]
    assert pictures
    assert not [(name, target) for name, target in pictures if "//" in target]


def test_every_page_and_picture_is_linked() -> None:
    linked = {(page.parent / t.partition("#")[0]).resolve() for page in PAGES for t in links(page)}
    wanted = [p for p in PAGES if p.parent == ROOT / "docs"] + list((ROOT / "docs/img").iterdir())
    assert not [str(p.relative_to(ROOT)) for p in wanted if p.resolve() not in linked]


@pytest.mark.parametrize("arguments", _COMMANDS)
def test_command_parses(arguments: list[str]) -> None:
    """The command and its options exist, and the values are of their types."""
    command, context = typer.main.get_command(app), None
    while True:
        name = arguments[0] if context else "torchid"
        rest = arguments[1:] if context else arguments
        context = command.make_context(name, list(rest), parent=context)
        if not hasattr(command, "get_command"):
            return
        arguments = list(rest)
        command = command.get_command(context, arguments[0])
        assert command is not None, f"no command {arguments[0]}"


def test_a_wrong_option_would_be_noticed() -> None:
    with pytest.raises(Exception, match="No such option"):
        test_command_parses(["identify", "arm.urdf", "run1.csv", "--no-such-option"])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_python_compiles_and_its_imports_exist(page: Path) -> None:
    for code in blocks(page, "python"):
        compile(code, page.name, "exec")
        for line in code.splitlines():
            if line.startswith(("import ", "from ")):
                exec(line, {})


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", [p for p in PAGES if blocks(p, "pycon")], ids=lambda page: page.name
)
@pytest.mark.usefixtures("types_unchecked")
def test_examples_run(page: Path) -> None:
    """All examples of a page one after the other, as a reader types them."""
    text = "\n".join(blocks(page, "pycon"))
    test = doctest.DocTestParser().get_doctest(text, {}, page.name, str(page), 0)
    assert len(test.examples) > 1
    assert not doctest.DocTestRunner().run(test).failed
