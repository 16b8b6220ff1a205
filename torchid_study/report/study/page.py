"""A whole study for people: its figures, the Markdown page with every table and every figure, a
folder with all of it, and the HTML page."""

import math
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch

from torchid.extraction.cma.search import default_population
from torchid.feasibility.sets import joined, sets_record
from torchid.files import make_folder, write_text
from torchid.report.cautions import caution_section
from torchid.report.page.document import Origin, Page, origin
from torchid.report.panels import save_small
from torchid.report.table import Report, Section, Table, joint_numbers
from torchid.results.words import count, listed
from torchid_study.report.equal_torque import class_table
from torchid_study.report.study import facts
from torchid_study.report.study.facts import by_feasibility, ids, number, verdict
from torchid_study.report.study.figures import drawings
from torchid_study.result import Study


def report_of_study(study: Study) -> Report:
    """All that is printed of a study, and its page."""
    return Report(
        parts=all_tables(study),
        warnings=study.warnings,
        last=f"{study.settings.title}. {page_verdict(study)}\n",
        page=partial(study_page, study),
    )


def identification_table(study: Study) -> Table:
    """Tables A.1 to A.4: coefficient, estimated, real, error."""
    model = study.identification
    values = zip(model.base.names, model.base.units, model.values, study.truth, strict=True)
    rows = [
        (name, unit, f"{float(value):.6g}", f"{float(true):.6g}", number(float(value - true)))
        for name, unit, value, true in values
    ]
    title = f"identified coefficients of {study.robot.name} (tables A.1 to A.4)"
    return Table(title, ("coefficient", "unit", "estimated", "real", "error"), rows, "pp")


def scenario_table(study: Study) -> Table:
    """Tables 5.2 to 5.5 and A.7 to A.10: the best set of each scenario."""
    rows = [
        (
            s.scenario.id, s.scenario.bounds, s.scenario.penalty, number(s.phi, 4),
            number(facts.phi_min(study, s), 4), number(s.gamma), "yes" if s.feasible else "no",
            ", ".join(s.reasons) or "-", number(s.degree, 2), number(s.torque_relative, 2),
        )
        for s in study.scenarios
    ]  # fmt: skip
    # For some bounds phi_min does not count the conditions.
    alone = [b for b, c in study.certificates.items() if not c.with_conditions]
    note = f" For the bounds {listed(alone)}, phi_min is that of the bounds and physics alone."
    return Table(
        "best set of each scenario (tables 5.2 to 5.5)",
        ("set", "bounds", "loss", "phi", "phi_min", "gamma", "feasible", "why not", "degree",
         "torque"),
        rows, "lllrrrlp",
        note="phi: loss; phi_min: proven least loss of any feasible set within the bounds; gamma: "
        "penalty; degree: negative outside, 0 on the boundary; torque: root mean square error on a "
        f"new motion over that of the torque, largest joint.{note if alone else ''}",
    )  # fmt: skip


def search_table(study: Study) -> Table:
    """How the runs of each scenario ended."""
    rows = []
    for s in study.scenarios:
        e = s.extraction
        losses = (e.history_phi[:, -1].median(), e.phi.min(), e.phi.median(), e.phi.max())
        every = Counter(r for k in range(len(e.sets)) for r in s.feasibility.reasons(k))
        # 6: names at most
        often = [f"{name} {k}" for name, k in every.most_common(6)]
        rows.append(
            (
                s.scenario.id, str(len(e.sets)), *(number(float(x)) for x in losses),
                str(int((e.gamma == 0).sum())), str(int(s.feasibility.feasible.sum())),
                str(len(facts.endings(s).unique())), ", ".join(often) or "-", f"{e.seconds:.1f}",
            )
        )  # fmt: skip
    return Table(
        "runs of each scenario: loss phi",
        ("set", "runs", "median after the last stage", "best", "median", "worst", "gamma = 0",
         "feasible", "different", "why not, most frequent", "time [s]"),
        rows, "lrrrrrrrrp",
        note="each run ends in the set of nearly the least loss that is nearest to where its last "
        "stage left it; gamma = 0: runs without any penalty; different: runs that ended in the "
        "same set count once.",
    )  # fmt: skip


def certificate_table(study: Study) -> Table:
    """phi_min of each group of bounds, and what stands in the way."""
    rows = []
    for bounds, c in study.certificates.items():
        # phi_min without each condition that raises it by more than a little, largest effect first.
        released = sorted(c.released.items(), key=lambda item: item[1])
        # 5e-2: share of phi_min that releasing a condition saves, for the condition to be named
        active = [f"{name} ({number(v, 4)})" for name, v in released if v < (1 - 5e-2) * c.phi_min]
        conditions = "all" if c.with_conditions else "bounds and physics only"
        no_room = facts.contradictions(study, bounds) or c.conflict
        stands = (", ".join(x) or "-" for x in (c.forcing, active, no_room, c.relaxed_active))
        losses = (number(c.phi_min, 4), number(c.phi_strict, 4))
        rows.append((bounds, *losses, conditions, *stands, f"{c.seconds:.1f}"))
    return Table(
        "what no search can beat: least loss of any feasible set",
        ("bounds", "phi_min", "reached", "conditions", "forced by", "phi_min without",
         "no room for", "relaxed", "time [s]"),
        rows, "lrrlpppp",
        note="reached: loss of a strictly feasible set that was found; forced by: conditions "
        "without which phi_min is nearly zero; phi_min without: one condition released, where that "
        "saves 5 % or more; no room for: conditions that the bounds meet on a face of theirs at "
        "most; relaxed: bounds that count in phi_min by a relaxation only.",
    )  # fmt: skip


def set_wrench_table(study: Study) -> Table:
    """Errors of the internal forces of the best sets per joint, moments beside the largest."""
    e = study.errors
    sets = [("real wrench", "-", e.reference_force_rms, e.reference_moment_rms)]
    for s, row in zip(study.scenarios, facts.best_rows(study), strict=True):
        said = "yes" if s.feasible else "no"
        sets.append((s.scenario.id, said, e.force_rms[row], e.moment_rms[row]))
    rows = [
        (name, said, *map(number, force.tolist()), number(float(moment.max())))
        for name, said, force, moment in sets
    ]
    return Table(
        "internal wrenches of the best sets: root mean square of the force error per joint [N], "
        "largest moment error [N m]",
        ("set", "feasible", *joint_numbers(study.robot.n), "moment"),
        rows, "ll",
        note="The error is the norm of the difference of the vectors, which is never smaller than "
        "the difference of the norms that the figures show.",
    )  # fmt: skip


def run_table(study: Study) -> Table:
    """Force errors of all runs by class, against feasible ones, then by each reason."""
    comparison = study.comparison
    every, infeasible = comparison.correlation, comparison.correlation_infeasible
    ranked = {
        count(every.sets, "set"): every,
        f"the {infeasible.sets} infeasible ones": infeasible,
    }
    rho = [f"{c.rho} over {what}" for what, c in ranked.items() if c.rho.value == c.rho.value]
    said = f"Rank correlation of degree and error: {listed(rho)}. " if rho else ""
    return class_table(
        comparison,
        "force error of all runs by the kind of their reasons, largest joint [N]",
        f"{said}A ratio of 1 and a delta of 0 are no difference; in brackets 95 % bootstrap "
        "intervals that take every run for its own unit: they are too narrow where many runs have "
        "the same error.",
    )


def payload_table(study: Study) -> Table:
    """True and estimated payload in the tool frame, with intervals."""
    rows = []
    for name, unit, true, value, low, high in facts.payload_quantities(study):
        cells = ["not known" if math.isnan(value) else number(value, 4), "-", "-"]
        if math.isfinite(low):
            held = "yes" if low <= true <= high else "no"
            cells[1:] = [f"{number(low, 4)} .. {number(high, 4)}", held]
        rows.append((name, unit, number(true, 4), *cells))
    columns = ("quantity", "unit", "true", "estimated", "95 % interval", "true inside")
    title = "payload in the tool frame, inertia about its centre of mass"
    return Table(title, columns, rows, "pprrrp")


def all_tables(study: Study) -> list[Table]:
    """Every table, in the pages' order."""
    return [table for _, _, makers in _SECTIONS for make in makers if (table := make(study))]


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
    make_folder(folder)
    every = [
        replace(s.extraction.sets, ids=tuple(f"{s.scenario.id}/{k}" for k in s.extraction.sets.ids))
        for s in study.scenarios
    ]
    sets = {"sets.json": [s.best for s in study.scenarios], "all_sets.json": every}
    about = origin(arguments=(), started=time.monotonic(), files=(), **seeds_and_settings(study))
    page = study_page(study, about)
    written = [save_small(picture.draw(), folder / picture.file) for picture in page.pictures]
    for name, parts in sets.items():
        sets_record(joined(parts), study.robot).save(folder / name)
    # The page comes last: where it is, all that it shows is there too.
    write_text(folder / "study.md", page.markdown())
    return [folder / "study.md", *(folder / name for name in sets), *written]


_SECTIONS: tuple[tuple[str, str, tuple[Callable[[Study], Table], ...]], ...] = (
    ("Classification", "classification", (scenario_table,)),
    ("Extraction", "extraction", (certificate_table, search_table)),
    ("Internal wrenches", "wrenches", (set_wrench_table, run_table)),
    ("Validation of the sets", "validation", ()),
    ("Payload", "payload", (payload_table,)),
    ("Identification", "identification", (identification_table,)),
)  # fmt: skip
"""Titles, the section of their pictures, and tables: what the verdict is about comes first."""
_MOST_NAMED = 4


def study_page(study: Study, origin: Origin) -> Page:
    """The page of a study: the same as HTML and as Markdown."""
    error, real = facts.torque_errors(study.sets_motion)
    pictures = drawings(study)
    good = len(by_feasibility(study, True))
    runs = torch.cat([s.feasibility.feasible for s in study.scenarios])
    sentences = [s for s in verdict(study) if not s.startswith("Noticed:")]
    return Page(
        f"{study.settings.title} (section {study.settings.section})",
        page_verdict(study),
        (
            ("Best sets feasible", f"{good} of {len(study.scenarios)}"),
            ("Runs feasible", f"{int(runs.sum())} of {len(runs)}"),
            ("Largest error of a coefficient", number(facts.coefficient_error(study), 2)),
            ("Largest torque error of a set", f"{number(100 * float((error / real).max()), 2)} %"),
        ),
        origin,
        sections=[
            Section("Findings", [sentences], folded=False),
            *(
                Section(
                    title,
                    [*(m(study) for m in makers), *(p for p in pictures if p.section == section)],
                    folded=section != "classification",
                )
                for title, section, makers in _SECTIONS
            ),
            caution_section(study.warnings),
        ],
    )  # fmt: skip


def seeds_and_settings(study: Study) -> dict[str, dict[str, Any]]:
    """For the page's origin."""
    s = study.settings
    motions = {
        "excitation": s.excitation, "validation": s.validation, "sets' motion": s.sets_motion,
        "reference motion": s.wrench_motion,
    }  # fmt: skip
    parts: dict[str, Any] = {"search": s.search} | motions
    seeds = {f"seed of the {name}": part.seed for name, part in parts.items()}
    settings: dict[str, Any] = {
        "effects": s.effects,
        "geometry": s.geometry,
        "total mass [kg]": s.total_mass,
    }
    for name, part in parts.items():
        settings[name] = {key: value for key, value in asdict(part).items() if key != "seed"}
    size = study.scenarios[0].extraction.problem.size
    settings["search"] |= {
        "variables": size,
        "population": s.search.population or default_population(size),
    }
    return {"seeds": seeds, "settings": settings | {"seconds": dict(study.seconds)}}


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
    proven = [
        f"within the bounds {listed(bounds)} {text}"
        for text, bounds in facts.proofs(study).items()
        if text
    ]
    return "; ".join([said, *proven]) + "."
