"""A study as one page: Markdown with every table and every figure, the verdict first."""

import math
import platform
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError, version

import torch

import torchid
from torchid.extraction.cma.search import default_population
from torchid.report.study.drawing import Drawing, Section
from torchid.report.study.facts import count, listed, number, with_conditions
from torchid.report.study.sheets import Sheet, markdown
from torchid.report.study.tables import (
    certificate_sheet,
    identification_sheet,
    reason_sheet,
    scenario_sheet,
    search_sheet,
    torque_sheet,
)
from torchid.report.study.verdict import verdict
from torchid.report.study.wrench_tables import (
    class_sheet,
    payload_sheet,
    reason_error_sheet,
    set_wrench_sheet,
)
from torchid.study.result import Study

_PACKAGES = ("torch", "numpy", "scipy", "clarabel", "matplotlib")


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
    for heading, section, sheets in _SECTIONS:
        parts.append(f"## {heading}\n")
        parts += _intro(study, section)
        parts += [markdown(sheet) for make in sheets if (sheet := make(study)) is not None]
        parts += [_figure(d) for d in drawings if d.section == section]
    parts += ["## How it was obtained\n", _origin(study, files)]
    return "\n".join(parts)


_SECTIONS: tuple[tuple[str, Section, tuple[Callable[[Study], Sheet | None], ...]], ...] = (
    ("Identification", "identification", (identification_sheet,)),
    ("Extraction", "extraction", (certificate_sheet, search_sheet)),
    ("Classification", "classification", (scenario_sheet, reason_sheet)),
    ("Validation of the sets", "validation", (torque_sheet,)),
    ("Internal wrenches", "wrenches", (set_wrench_sheet, class_sheet, reason_error_sheet)),
    ("Payload", "payload", (payload_sheet,)),
)


def _figure(d: Drawing) -> str:
    alternative = d.name.replace("_", " ")
    return f"![{alternative}]({d.file})\n\n*{d.caption.replace('*', '')}*\n"


def _intro(study: Study, section: Section) -> list[str]:
    if section != "extraction":
        return []
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
    lines = [
        f"robot {s.robot}, effects {listed(s.effects)}: {study.identification.base.n_rigid} base "
        f"parameters, {len(study.identification.base) - study.identification.base.n_rigid} "
        "coefficients of effects",
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
        f"versions: torchid {torchid.__version__}, Python {platform.python_version()}, "
        + ", ".join(f"{name} {found}" for name in _PACKAGES if (found := _version(name))),
    ]
    if files:
        lines.append("beside this page: " + ", ".join(f"`{name}`" for name in files))
    return "\n".join(f"- {line}" for line in lines) + "\n"


def _version(package: str) -> str:
    if package == "torch":
        return torch.__version__
    try:
        return version(package)
    except PackageNotFoundError:
        return ""
