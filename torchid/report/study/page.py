"""A study as one page: Markdown with every table and every figure, the verdict first."""

import math
from collections.abc import Callable, Sequence

from torchid.extraction.cma.search import default_population
from torchid.report.page.origin import versions
from torchid.report.study import tables
from torchid.report.study.drawing import Drawing, Section
from torchid.report.study.facts import count, number, with_conditions
from torchid.report.study.verdict import verdict
from torchid.report.table import Table
from torchid.report.text import listed
from torchid.study.result import Study

_PACKAGES = ("torchid", "Python", "torch", "numpy", "scipy", "clarabel", "matplotlib")
_SECTIONS: tuple[tuple[str, Section, tuple[Callable[[Study], Table | None], ...]], ...] = (
    ("Identification", "identification", (tables.identification_table,)),
    ("Extraction", "extraction", (tables.certificate_table, tables.search_table)),
    ("Classification", "classification", (tables.scenario_table, tables.reason_table)),
    ("Validation of the sets", "validation", (tables.torque_table,)),
    (
        "Internal wrenches",
        "wrenches",
        (tables.set_wrench_table, tables.class_table, tables.reason_error_table),
    ),
    ("Payload", "payload", (tables.payload_table,)),
)


def page(study: Study, drawings: Sequence[Drawing], files: Sequence[str]) -> str:
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
            f"![{d.words}]({d.file})\n\n*{d.plain_caption}*\n"
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
        elif not with_conditions(study, bounds):
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
