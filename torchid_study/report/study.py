"""A whole study: its tables and its page."""

import math
from collections import Counter
from dataclasses import replace
from functools import partial

import torch

from torchid.report.cautions import caution_section
from torchid.report.identification import payload_tables
from torchid.report.page.document import Origin, Page
from torchid.report.panels import Figure, Picture
from torchid.report.table import Report, Section, Table, cells, table_of
from torchid.results.words import count, listed
from torchid.robot.inertia import InertialParameters
from torchid_study.report.wrenches import class_tables, force_by_degree
from torchid_study.result import Study, StudyIdentification, StudyPayload, StudyRecord
from torchid_study.wrenches.classes import class_of

_MOST_NAMED = 4
"""Reasons in the verdict."""


def report_of_study(study: Study) -> Report:
    """All that is printed of a study, and its page."""
    every = tables(study)
    return Report(
        parts=[table for part in every.values() for table in part],
        warnings=study.record.warnings,
        last=f"{study.title}. {verdict(study.record)}\n",
        page=partial(study_page, study),
    )


def tables(study: Study) -> dict[str, list[Table]]:
    """Every table, by the title of its section."""
    record = study.record
    sets, certificates = record.sets, record.certificate
    classification = table_of(
        "best set of each scenario (tables 5.2 to 5.5)",
        sets,
        "id bounds penalty phi gamma feasible reasons degree",
        "phi: loss; gamma: penalty; degree: negative outside, 0 on the boundary.",
    )
    least = table_of(
        "what no search can beat: least loss of any feasible set",
        certificates.values(),
        note="reached: loss of a strictly feasible set that was found; no room for: conditions "
        "that the bounds meet on a face of theirs at most.",
        beside={"bounds": list(certificates)},
    )
    title = "runs of each scenario: median (quartiles)"
    runs = table_of(title, [s.runs for s in sets], beside={"set": [s.id for s in sets]})
    title = "best sets against the real one on motions that took no part, by joint"
    wrenches = table_of(title, sets, "id torque_rms force_norm_difference_rms")
    return {
        "Classification": [classification],
        "Extraction": [least, runs],
        "Internal wrenches": [wrenches, *class_tables(study.comparison)],
        "Payload": [payload_table(record.payload)],
        "Identification": [identification_table(record.identification)],
    }


def payload_table(payload: StudyPayload) -> Table:
    """The payload, identified and true."""
    table, body = payload_tables(payload)[0], InertialParameters(payload.true)
    true = cells(torch.cat([body.mass.reshape(1), body.com, body.inertia_about_com]), ".4g")
    rows = [[*row, value] for row, value in zip(table.rows, true, strict=True)]
    return replace(table, columns=[*table.columns, "true"], rows=rows)


def identification_table(model: StudyIdentification) -> Table:
    """Coefficients, identified and true."""
    estimated, true = (cells(x, ".6g") for x in (model.values, model.true))
    rows = list(zip(model.names, estimated, true, strict=True))
    title = "identified coefficients (tables A.1 to A.4)"
    return Table(title, ("coefficient", "estimated", "real"), rows, "p")


def study_page(study: Study, origin: Origin) -> Page:
    """The page of a study: its tables, and force errors by degree."""
    record = study.record
    picture = Picture(
        "force_by_degree",
        "Force error of every run (root mean square over the motion, largest joint) against its "
        "degree, by the kind of its reasons.",
        "Figure: force error by degree.",
        partial(degree_figure, study),
    )
    feasible = sum(one.runs.feasible for one in record.sets)
    return Page(
        f"{study.title} (section {record.section})",
        verdict(record),
        (
            ("Best sets feasible", f"{sum(s.feasible for s in record.sets)} of {len(record.sets)}"),
            ("Runs feasible", f"{feasible} of {len(study.every)}"),
            ("Largest error of a coefficient", f"{record.identification.largest_error:.2g}"),
        ),
        origin,
        sections=[
            *(
                Section(
                    title,
                    [*part, *([picture] if title == "Internal wrenches" else [])],
                    folded=title != "Classification",
                )
                for title, part in tables(study).items()
            ),
            caution_section(record.warnings),
        ],
    )


def degree_figure(study: Study) -> Figure:
    """Force errors of all runs against their degrees, by class."""
    reasons = [own for one in study.record.sets for own in one.runs.reasons]
    degree = torch.cat([one.runs.degree for one in study.record.sets]).tolist()
    error = study.errors.force_rms.amax(-1).tolist()
    shown = zip(map(class_of, reasons), degree, error, strict=True)
    return force_by_degree(study.record.robot, shown)


def verdict(study: StudyRecord) -> str:
    """One sentence: whether the sets with the identified torque are feasible, and why not."""
    good, bad = ([s for s in study.sets if s.feasible == kind] for kind in (True, False))
    total = count(len(study.sets), "best set")
    # What the best sets that are not feasible violate, the most frequent first.
    often = [name for name, _ in Counter(r for s in bad for r in s.reasons).most_common()]
    failing = f"violate {listed(often, nothing='their conditions', most=_MOST_NAMED)}"
    if not bad:
        said = f"Feasible: all {total}"
    elif not good:
        said = f"Not feasible: none of the {total}, which {failing}"
    else:
        ids = listed([s.id for s in good])
        said = f"Feasible in part: {len(good)} of {total} ({ids}), while the others {failing}"
    proven = [
        f"within the bounds {listed(bounds)} {text}"
        for text, bounds in proofs(study).items()
        if text
    ]
    return "; ".join([said, *proven]) + "."


def proofs(study: StudyRecord) -> dict[str, list[str]]:
    """What the certificates prove, and of which bounds; under an empty text those of which it is
    open whether a set has exactly the identified coefficients."""
    out: dict[str, list[str]] = {}
    for bounds, c in study.certificate.items():
        text = ""
        if math.isinf(c.phi_min):
            text = "there is no physical set at all"
        elif c.exact and c.with_conditions and not math.isnan(c.phi_min):
            text = "feasible sets with exactly the identified coefficients exist"
        elif c.phi_min > 0:
            whose = "feasible" if c.with_conditions else "physical"
            forced = f", forced by {listed(c.forcing)}" if c.forcing else ""
            text = f"no {whose} set has exactly the identified coefficients{forced}"
        out.setdefault(text, []).append(bounds)
    return out
