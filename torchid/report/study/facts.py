"""What a study's numbers say, for its tables, captions and page: nothing here is drawn."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import torch

from torchid.robot.inertia import InertialParameters
from torchid.study.result import ScenarioResult, SetsOnMotion, Study
from torchid.typing import Float, Int, Tensor
from torchid.wrenches.classes import class_of

ROUNDING = 1e-9
"""Share of a signal's root mean square below which a difference is called rounding."""
_SAME = 1e-4
"""Share of a set's parameters by which two runs that ended in the same set may differ."""
_EQUAL = 1e-3
"""Share by which errors of runs that are the same may differ."""


def number(value: float, digits: int = 3) -> str:
    """A number for people: 0.0123, 1.2e-05, 0; a dash if there is none, `none` if infinite."""
    if math.isnan(value):
        return "-"
    return "none" if math.isinf(value) else f"{value:.{digits}g}"


def count(k: int, what: str, many: str = "") -> str:
    """1 set, 2 sets."""
    return f"{k} {what if k == 1 else many or what + 's'}"


def joint_names(study: Study) -> tuple[str, ...]:
    """Headings of one column a joint."""
    return tuple(f"joint {j + 1}" for j in range(study.robot.n))


def by_feasibility(study: Study, feasible: bool) -> list[ScenarioResult]:
    """The scenarios whose best set is feasible, or is not."""
    return [s for s in study.scenarios if s.feasible == feasible]


def ids(scenarios: Iterable[ScenarioResult]) -> list[str]:
    """Names of the best sets."""
    return [s.scenario.id for s in scenarios]


def best_rows(study: Study) -> list[int]:
    """Row of each scenario's best set among all runs of all scenarios, as `study.errors` has
    them."""
    rows, start = [], 0
    for s in study.scenarios:
        rows.append(start + s.extraction.best)
        start += len(s.extraction.sets)
    return rows


def run_classes(study: Study) -> list[str]:
    """Class of the reasons of every run of every scenario, as `study.errors` has them."""
    return [
        class_of(s.feasibility.reasons(k))
        for s in study.scenarios
        for k in range(len(s.extraction.sets))
    ]


def distinct_errors(study: Study, name: str) -> int:
    """How many force errors of the runs of a class (largest joint) are really different."""
    rows = [k for k, found in enumerate(run_classes(study)) if found == name]
    return different(study.errors.force_rms[rows].amax(-1))


def all_degrees(study: Study) -> Float[Tensor, " K"]:
    """Degree of every run of every scenario."""
    return torch.cat([s.feasibility.degree for s in study.scenarios])


def kept(gamma: Float[Tensor, " R"]) -> int:
    """Runs that meet all conditions: those whose penalty is zero."""
    return int((gamma == 0).sum())


def endings(result: ScenarioResult) -> Int[Tensor, " R"]:
    """(R,) which runs ended in the same set: the number of the first of them."""
    x = result.extraction.sets.vector
    near = torch.cdist(x, x) <= _SAME * x.norm(dim=-1, keepdim=True)
    return near.int().argmax(-1)


def different(values: Float[Tensor, " R"]) -> int:
    """How many of some positive values are really different."""
    ordered = values.sort().values
    return min(1, len(values)) + int((ordered[1:] > (1 + _EQUAL) * ordered[:-1]).sum())


def phi_min(study: Study, result: ScenarioResult) -> float:
    """The least loss of any feasible set in a scenario's bounds; nan without a certificate."""
    found = study.certificates.get(result.scenario.bounds)
    return math.nan if found is None else found.phi_min


def with_conditions(study: Study, bounds: str) -> bool:
    """Whether the certificate of a group of bounds counts all conditions: where bounds and
    conditions exclude each other, it is that of the bounds alone."""
    return study.certificates[bounds].with_conditions


def contradictions(study: Study, bounds: str) -> tuple[str, ...]:
    """Conditions that a group of bounds leaves no room for."""
    found = [s.extraction.contradictions for s in study.scenarios if s.scenario.bounds == bounds]
    return tuple(dict.fromkeys(name for names in found for name in names))


def rms(signal: Float[Tensor, "*batch T n"]) -> Float[Tensor, "*batch n"]:
    """Root mean square over the instants."""
    return signal.square().mean(-2).sqrt()


def torque_errors(sets: SetsOnMotion) -> tuple[Float[Tensor, "K n"], Float[Tensor, " n"]]:
    """(K, n) root mean square differences of the sets' torques from the real one [N m; N], and
    (n,) of the real torque itself."""
    return rms(sets.torque[1:] - sets.torque[0]), rms(sets.torque[0])


def validation_torques(study: Study) -> tuple[Tensor, Tensor, Tensor]:
    """(T, n) torques on the validation's motion [N m; N]: of the identified coefficients, of the
    coefficients reconstructed from the true parameters, and of the true parameters."""
    log, found = study.validation, study.identification
    assert log.dq is not None
    assert log.ddq is not None
    assert log.tau is not None
    state = (log.q, log.dq, log.ddq)
    return found.predict(*state), replace(found, values=study.truth).predict(*state), log.tau


def row_of(sets: SetsOnMotion, name: str) -> int:
    """Row of a set by its id, or of `real`."""
    return sets.labels.index(name)


def at_joint(values: Sequence[float], unit: str = "") -> str:
    """The largest of one value a joint, and where: `3.2 N at joint 2`."""
    joint = max(range(len(values)), key=lambda k: values[k])
    return f"{number(values[joint])}{unit and ' '}{unit} at joint {joint + 1}"


def payload_numbers(study: Study) -> tuple[list[float], list[float], list[float], list[float]]:
    """True value, estimate, lower and upper end of the 95 % interval of the ten quantities."""
    body = InertialParameters(study.payload.true)
    true = torch.cat([body.mass.reshape(1), body.com, body.inertia_about_com])
    tool = study.payload.estimate.tool
    parts = (tool.mass, tool.com, tool.inertia_about_com)
    value, low, high = (
        torch.cat([getattr(part, name) for part in parts]).tolist()
        for name in ("value", "low", "high")
    )
    return true.tolist(), value, low, high
