"""A whole study for people: its figures, and a folder with figures, page and sets."""

from dataclasses import replace
from pathlib import Path

from torchid.errors import TorchidError
from torchid.feasibility.sets import joined, to_record
from torchid.files import atomic_write
from torchid.json_data import write_json
from torchid.report.study.drawing import Drawing, save
from torchid.report.study.motion_figures import motion_drawings, torque_drawings
from torchid.report.study.page import page
from torchid.report.study.search_figures import search_drawings
from torchid.report.study.wrench_figures import payload_drawings, wrench_drawings
from torchid.study.result import Study


def drawings(study: Study) -> list[Drawing]:
    """Figures with captions, none of them drawn yet (figures 5.1 to 5.19, and more)."""
    return [
        *motion_drawings(study),
        *torque_drawings(study),
        *search_drawings(study),
        *wrench_drawings(study),
        *payload_drawings(study),
    ]


def write_study(study: Study, folder: Path) -> list[Path]:
    """Write everything: figures (PNG), the page study.md, sets.json with the best sets under their
    ids and all_sets.json with those of all runs, under ids like p_25/run_3.

    Args:
        study: what to write.
        folder: made if it does not exist.

    Returns:
        The files, the page first.

    Raises:
        TorchidError: the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TorchidError(
            f"the folder '{folder}' cannot be made: {error.strerror or error}."
        ) from error
    figures = drawings(study)
    every = [
        replace(s.extraction.sets, ids=tuple(f"{s.scenario.id}/{k}" for k in s.extraction.sets.ids))
        for s in study.scenarios
    ]
    sets = {"sets.json": [s.best for s in study.scenarios], "all_sets.json": every}
    written = [save(d.draw(), folder / d.file) for d in figures]
    for name, parts in sets.items():
        write_json(to_record(joined(parts), study.robot), folder / name)
    # The page comes last: where it is, all that it shows is there too.
    with atomic_write(folder / "study.md") as stream:
        stream.write(page(study, figures, list(sets)))
    return [folder / "study.md", *(folder / name for name in sets), *written]
