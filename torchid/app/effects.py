"""`torchid effects`: the library of effects, as a list or as a page."""

from dataclasses import replace
from typing import Annotated

import typer

from torchid.app import options as opt
from torchid.app.output import open_output


def effects_command(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="One effect; all if left out.")
    ] = None,
    json_file: opt.Json = None,
    out: opt.Out = None,
    quiet: opt.Quiet = False,
) -> None:
    """List the effects that can make an arm differ from its simulator, or explain one of them.

    With --out, write the catalogue of all: effects.md, and its pictures in img.

    Example: `torchid effects stribeck_friction`
    """
    output = open_output(json_file, out, quiet)
    from rich.markdown import Markdown

    from torchid.effects.registry import KINDS, effect_kind
    from torchid.report.catalogue import effect_record, effect_text, effects_table, write_catalogue

    kinds = list(KINDS.values()) if name is None else [effect_kind(name)]
    output.say(effects_table() if name is None else Markdown(effect_text(kinds[0])))
    record = {"schema": "torchid.effects/1", "effects": [effect_record(kind) for kind in kinds]}
    replace(output, folder=None).write_json(record, "effects.json")
    if output.folder is not None:
        output.say(f"written: {write_catalogue(output.folder)}")
