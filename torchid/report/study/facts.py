"""What a study's numbers say, for its tables, captions and page: nothing here is drawn."""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace

import torch

from torchid.extraction.convex.certificate import Certificate
from torchid.feasibility.margins import feasibility
from torchid.feasibility.sets import nominal_set
from torchid.study.result import ScenarioResult, SetsOnMotion, Study
from torchid.typing import Float, Int, Tensor
from torchid.wrenches.classes import class_of

ROUNDING = 1e-9
"""Share of a signal's root mean square below which a difference is called rounding."""
_SAME = 1e-4
"""Share of a set's parameters by which two runs that ended in the same set may differ."""
_EQUAL = 1e-3
"""Share by which errors of runs that are the same may differ."""
_ACTIVE = 5e-2
"""Share of phi_min that releasing a condition saves, for the condition to be named."""


def number(value: float, digits: int = 3) -> str:
    """A number for people: 0.0123, 1.2e-05, 0; a dash if there is none, `none` if infinite."""
    if math.isnan(value):
        return "-"
    return "none" if math.isinf(value) else f"{value:.{digits}g}"


def listed(items: Iterable[str], nothing: str = "none") -> str:
    """a, b and c."""
    names = list(items)
    if len(names) < 2:
        return names[0] if names else nothing
    return f"{', '.join(names[:-1])} and {names[-1]}"


def count(k: int, what: str, many: str = "") -> str:
    """1 set, 2 sets."""
    return f"{k} {what if k == 1 else many or what + 's'}"


def joint_names(study: Study) -> tuple[str, ...]:
    """Headings of one column a joint."""
    return tuple(f"joint {j + 1}" for j in range(study.robot.n))


def torque_unit(study: Study) -> str:
    """Unit of the joints' torques: N m, N, or both where the joints differ."""
    kinds = {str(kind) for kind in study.robot.joint_types}
    return {frozenset("R"): "N m", frozenset("P"): "N"}.get(frozenset(kinds), "N m; N")


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


def class_errors(study: Study, name: str) -> Float[Tensor, " R"]:
    """Force errors of the runs of a class, largest joint [N]."""
    rows = [k for k, found in enumerate(run_classes(study)) if found == name]
    return study.errors.force_rms[rows].amax(-1)


def all_degrees(study: Study) -> Float[Tensor, " K"]:
    """Degree of every run of every scenario."""
    return torch.cat([s.feasibility.degree for s in study.scenarios])


def reason_counts(result: ScenarioResult) -> dict[str, int]:
    """In how many of a scenario's runs each reason occurs, most frequent first."""
    runs = range(len(result.extraction.sets))
    found = Counter(reason for k in runs for reason in result.feasibility.reasons(k))
    return dict(sorted(found.items(), key=lambda item: (-item[1], item[0])))


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


def truth_reasons(study: Study) -> tuple[str, ...]:
    """Why the simulated arm's own parameters are infeasible; empty if they are not."""
    asked = study.scenarios[0].extraction.problem.conditions
    return feasibility(nominal_set(study.robot), asked).reasons(0)


def proof(study: Study, result: ScenarioResult) -> Certificate | None:
    """The certificate of a scenario's bounds, if there is one."""
    return study.certificates.get(result.scenario.bounds)


def phi_min(study: Study, result: ScenarioResult) -> float:
    """The least loss of any feasible set in a scenario's bounds; nan without a certificate."""
    found = proof(study, result)
    return math.nan if found is None else found.phi_min


def with_conditions(study: Study, bounds: str) -> bool:
    """Whether the certificate of a group of bounds counts all conditions: where bounds and
    conditions exclude each other, it is that of the bounds alone."""
    return study.certificates[bounds].with_conditions


def contradictions(study: Study, bounds: str) -> tuple[str, ...]:
    """Conditions that a group of bounds leaves no room for."""
    found = [s.extraction.contradictions for s in study.scenarios if s.scenario.bounds == bounds]
    return tuple(dict.fromkeys(name for names in found for name in names))


def active(certificate: Certificate) -> dict[str, float]:
    """phi_min without each condition that raises it by more than a little, largest effect first."""
    below = (1 - _ACTIVE) * certificate.phi_min
    found = {name: phi for name, phi in certificate.released.items() if phi < below}
    return dict(sorted(found.items(), key=lambda item: item[1]))


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
