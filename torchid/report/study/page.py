"""A whole study for people: its figures, the Markdown page with every table and every figure, a
folder with all of it, and the HTML page."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

from torchid.errors import TorchidError
from torchid.extraction.cma.search import default_population
from torchid.feasibility.sets import joined, sets_record
from torchid.files import atomic_write
from torchid.report.page.document import Origin, Page, versions
from torchid.report.panels import Picture, save_small
from torchid.report.study import facts, tables
from torchid.report.study.facts import by_feasibility, ids, number, verdict
from torchid.report.study.motion_figures import motion_drawings, torque_drawings
from torchid.report.study.search_figures import search_drawings
from torchid.report.study.wrench_figures import payload_drawings, wrench_drawings
from torchid.report.table import Shown, Table, count, listed
from torchid.study.result import Study


def shown(study: Study) -> Shown:
    """All that is printed of a study, and its page."""
    return Shown(
        parts=tables.all_tables(study),
        warnings=study.warnings,
        last=f"{facts.headline(study)}\n",
        page=partial(study_page, study),
    )


def drawings(study: Study) -> list[Picture]:
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
    written = [save_small(d.draw(), folder / d.file) for d in figures]
    for name, parts in sets.items():
        sets_record(joined(parts), study.robot).save(folder / name)
    # The page comes last: where it is, all that it shows is there too.
    with atomic_write(folder / "study.md") as stream:
        stream.write(page(study, figures, list(sets)))
    return [folder / "study.md", *(folder / name for name in sets), *written]


_PACKAGES = ("torchid", "Python", "torch", "numpy", "scipy", "clarabel", "matplotlib")
_SECTIONS: tuple[tuple[str, str, tuple[Callable[[Study], Table | None], ...]], ...] = (
    ("Identification", "identification", (tables.identification_table,)),
    ("Extraction", "extraction", (tables.certificate_table, tables.search_table)),
    ("Classification", "classification", (tables.scenario_table, tables.reason_table)),
    ("Validation of the sets", "validation", (tables.torque_table,)),
    ("Internal wrenches", "wrenches",
     (tables.set_wrench_table, tables.class_table, tables.reason_error_table)),
    ("Payload", "payload", (tables.payload_table,)),
)  # fmt: skip


def page(study: Study, drawings: Sequence[Picture], files: Sequence[str]) -> str:
    """The whole page.

    Args:
        study: what to show.
        drawings: its figures, which lie beside the page.
        files: names of the other files beside it.
    """
    parts = [
        f"# {study.settings.title} (section {study.settings.section})\n",
        "\n".join(f"- {sentence}" for sentence in verdict(study)) + "\n",
    ]
    for heading, section, makers in _SECTIONS:
        parts.append(f"## {heading}\n")
        if section == "extraction":
            parts += _certificates(study)
        parts += [table.markdown() for make in makers if (table := make(study)) is not None]
        parts += [
            f"![{d.name.replace('_', ' ')}]({d.file})\n\n*{d.caption}*\n"
            for d in drawings
            if d.section == section
        ]
    parts += ["## How it was obtained\n", _origin(study, files)]
    return "\n".join(parts)


def _certificates(study: Study) -> list[str]:
    """What the tables of the extraction do not say of the least loss."""
    said = []
    for bounds, c in study.certificates.items():
        if math.isnan(c.phi_min):
            said.append(f"Within the bounds `{bounds}` the solver failed: phi_min is not known.")
        elif not c.feasible:
            said.append(f"Within the bounds `{bounds}` there is no physical set at all.")
        elif not c.with_conditions:
            said.append(f"For the bounds `{bounds}`, phi_min counts the bounds and physics alone.")
    if not study.certificates:
        said.append(
            "There is no certificate, so how small the loss of a feasible set can be is not known."
        )
    return [" ".join(said) + "\n"] if said else []


def _origin(study: Study, files: Sequence[str]) -> str:
    """Seeds, sizes, times, versions."""
    s = study.settings
    search, problem = s.search, study.scenarios[0].extraction.problem
    population = search.population or default_population(problem.size)
    low, high = s.total_mass
    effects, base = listed(s.effects, nothing="none"), study.identification.base
    lines = [
        f"robot {s.robot}, effects {effects}: {base.n_rigid} base parameters, "
        f"{len(base) - base.n_rigid} coefficients of effects",
        f"{count(s.excitation.count, 'exciting trajectory', 'exciting trajectories')} "
        f"({s.excitation.source}), {study.log.samples} instants; seeds: excitation "
        f"{s.excitation.seed}, validation {s.validation.seed}, sets' motion {s.sets_motion.seed}, "
        f"reference motion {s.wrench_motion.seed}",
        f"search: {search.runs} runs, {search.stages} stages of {search.generations} generations "
        f"of {population} points in {problem.size} variables, engine {search.engine}, schedule "
        f"{search.schedule}, {'with' if search.polish else 'without'} polish, seed {search.seed}",
        f"conditions: boxes of the centres of mass of the bounds `{s.geometry}`, total mass "
        f"{number(low)} to {number(high)} kg, physical consistency",
        "time: " + ", ".join(f"{part} {seconds:.1f} s" for part, seconds in study.seconds.items()),
        "versions: "
        + ", ".join(f"{name} {found}" for name, found in versions() if name in _PACKAGES),
    ]
    if files:
        lines.append("beside this page: " + ", ".join(f"`{name}`" for name in files))
    return "\n".join(f"- {line}" for line in lines) + "\n"


_ORDER = (
    "classification", "extraction", "wrenches", "validation", "payload", "identification",
)  # fmt: skip
"""Of the pictures: what the verdict is about comes first."""
_MOST_NAMED = 4


def study_page(study: Study, origin: Origin) -> Page:
    """The page of a study."""
    error, real = facts.torque_errors(study.sets_motion)
    good = len(by_feasibility(study, True))
    feasible, runs = facts.feasible_runs(study)
    return Page(
        f"{study.settings.title} (section {study.settings.section})",
        page_verdict(study),
        (
            ("Best sets feasible", f"{good} of {len(study.scenarios)}"),
            ("Runs feasible", f"{feasible} of {runs}"),
            ("Largest error of a coefficient", number(facts.coefficient_error(study), 2)),
            ("Largest torque error of a set", f"{number(100 * float((error / real).max()), 2)} %"),
        ),
        origin,
        pictures=sorted(drawings(study), key=lambda d: _ORDER.index(d.section)),
        findings=[s for s in verdict(study) if not s.startswith("Noticed:")],
        tables=[*tables.all_tables(study), tables.reason_error_table(study)],
        notes=study.warnings,
    )


def seeds_and_settings(study: Study) -> dict[str, dict[str, Any]]:
    """For the page's origin."""
    s = study.settings
    motions = {
        "excitation": s.excitation, "validation": s.validation, "sets' motion": s.sets_motion,
        "reference motion": s.wrench_motion,
    }  # fmt: skip
    parts: dict[str, Any] = {"search": s.search} | motions
    seeds = {f"seed of the {name}": part.seed for name, part in parts.items()}
    told: dict[str, Any] = {
        "effects": s.effects,
        "geometry": s.geometry,
        "total mass [kg]": s.total_mass,
    }
    for name, part in parts.items():
        told[name] = {key: value for key, value in asdict(part).items() if key != "seed"}
    return {"seeds": seeds, "settings": told | {"seconds": dict(study.seconds)}}


def page_verdict(study: Study) -> str:
    """One sentence: whether the sets with the identified torque are feasible, and why not."""
    good, bad = by_feasibility(study, True), by_feasibility(study, False)
    total = count(len(study.scenarios), "best set")
    # What the best sets that are not feasible violate, the most frequent first.
    often = [name for name, _ in Counter(r for s in bad for r in s.reasons).most_common()]
    failing = f"violate {listed(often, nothing='their conditions', most=_MOST_NAMED)}"
    if not bad:
        said = f"Feasible: all {total}"
    elif not good:
        said = f"Not feasible: none of the {total}, which {failing}"
    else:
        said = (
            f"Feasible in part: {len(good)} of {total} ({listed(ids(good))}), while the others "
            f"{failing}"
        )
    # What is proven to be possible, groups of bounds of which the same holds together.
    same: dict[str, list[str]] = {}
    for bounds, c in study.certificates.items():
        text = ""
        if math.isinf(c.phi_min):
            text = "there is no physical set at all"
        elif c.exact and c.with_conditions and not math.isnan(c.phi_min):
            text = "feasible sets with exactly the identified coefficients exist"
        elif c.phi_min > 0:
            whose = "feasible" if c.with_conditions else "physical"
            forced = f", forced by {listed(c.forcing)}" if c.forcing else ""
            text = f"no {whose} set has exactly the identified coefficients{forced}"
        if text:
            same.setdefault(text, []).append(bounds)
    proofs = [f"within the bounds {listed(bounds)} {text}" for text, bounds in same.items()]
    return "; ".join([said, *proofs]) + "."
