"""A study as plain data: the schema torchid.study/1."""

from typing import Any

from torchid.extraction.record import certificate_record
from torchid.identification.payload import record as payload_record
from torchid.json_data import picked, plain
from torchid.study.result import ScenarioResult, Study

SCHEMA = "torchid.study/1"
_SCENARIO = (
    "id=scenario.id bounds=scenario.bounds loss=scenario.penalty phi gamma feasible reasons degree "
    "torque_rms"
)


def record(study: Study) -> dict[str, Any]:
    """The result as JSON-ready data."""
    result = study.identification
    errors = result.held_out
    return {
        "schema": SCHEMA,
        **picked(study, "study=settings.name robot=robot.name section=settings.section"),
        "identification": {
            **picked(result, "names=base.names values"),
            "true": study.truth.tolist(),
            "largest_error": float((result.values - study.truth).abs().max()),
            "rows": int(study.log.samples * study.robot.n),
            "validation_error_percent": [] if errors is None else plain(errors.relative_percent),
        },
        "sets": [_scenario(study, s) for s in study.scenarios],
        "certificate": {
            group: certificate_record(proof) for group, proof in study.certificates.items()
        },
        "wrenches": {
            "classes": [
                {
                    **picked(c, "class=name sets force_error_median=median"),
                    "quartiles": [c.lower_quartile, c.upper_quartile],
                }
                for c in study.comparison.classes
            ],
            "unit": "N, largest joint's rms against the true set, all runs of all scenarios",
        },
        "payload": {"true": study.payload.true.tolist(), **payload_record(study.payload.estimate)},
        "search": picked(
            study.settings.search, "runs stages generations schedule engine polish seed"
        ),
        **picked(study, "seconds warnings"),
    }


def _scenario(study: Study, result: ScenarioResult) -> dict[str, Any]:
    found = result.extraction
    at = study.wrench_motion.labels.index(result.scenario.id)
    force = study.wrench_motion.force
    difference = (force[at] - force[0]).square().mean(0).sqrt()
    return {
        **picked(result, _SCENARIO),
        "force_norm_difference_rms": difference.tolist(),
        "runs": {
            **picked(
                found, "phi gamma phi_before_polish=searched_phi gamma_before_polish=searched_gamma"
            ),
            "feasible": int(result.feasibility.feasible.sum()),
            "gamma_zero": int((found.gamma == 0).sum()),
            "reasons": [list(result.feasibility.reasons(k)) for k in range(len(found.phi))],
            "degree": plain(result.feasibility.degree),
        },
        "contradictions": list(found.contradictions),
    }
