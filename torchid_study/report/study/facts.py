"""What a study's numbers say, for its tables, captions and pages, and what came out of it in
sentences: nothing here is drawn."""

import math
from collections.abc import Iterable
from dataclasses import replace

import torch

from torchid.feasibility.margins import feasibility
from torchid.feasibility.sets import nominal_set
from torchid.results.words import count, listed
from torchid.robot.inertia import InertialParameters
from torchid.typing import Float, Int, Tensor
from torchid_study.result import ScenarioResult, SetsOnMotion, Study
from torchid_study.wrenches.classes import class_of
from torchid_study.wrenches.compare import LEAST_CLUSTERS, EffectSize


def number(value: float, digits: int = 3) -> str:
    """A number for people: 0.0123, 1.2e-05, 0; a dash if there is none, `none` if infinite."""
    if math.isnan(value):
        return "-"
    return "none" if math.isinf(value) else f"{value:.{digits}g}"


def coefficient_error(study: Study) -> float:
    """The largest error of an identified coefficient."""
    return float((study.identification.values - study.truth).abs().max())


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


def endings(result: ScenarioResult) -> Int[Tensor, " R"]:
    """(R,) which runs ended in the same set: the number of the first of them."""
    x = result.extraction.sets.vector
    # 1e-4: share of a set's parameters by which two runs that ended in the same set may differ
    near = torch.cdist(x, x) <= 1e-4 * x.norm(dim=-1, keepdim=True)
    return near.int().argmax(-1)


def count_different(values: Float[Tensor, " R"]) -> int:
    """How many of some positive values are really different."""
    ordered = values.sort().values
    # 1e-3: share by which errors of runs that are the same may differ
    return min(1, len(values)) + int((ordered[1:] > (1 + 1e-3) * ordered[:-1]).sum())


def phi_min(study: Study, result: ScenarioResult) -> float:
    """The least loss of any feasible set in a scenario's bounds; nan without a certificate."""
    certificate = study.certificates.get(result.scenario.bounds)
    return math.nan if certificate is None else certificate.phi_min


def contradictions(study: Study, bounds: str) -> tuple[str, ...]:
    """Conditions that a group of bounds leaves no room for."""
    each = [s.extraction.contradictions for s in study.scenarios if s.scenario.bounds == bounds]
    return tuple(dict.fromkeys(name for names in each for name in names))


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
    log, model = study.validation, study.identification
    assert log.dq is not None
    assert log.ddq is not None
    assert log.tau is not None
    state = (log.q, log.dq, log.ddq)
    return model.predict(*state), replace(model, values=study.truth).predict(*state), log.tau


def payload_quantities(study: Study) -> list[tuple[str, str, float, float, float, float]]:
    """Name and unit, true value, estimate and ends of its 95 % interval of the ten quantities of
    the payload, in the tool frame."""
    body = InertialParameters(study.payload.true)
    true = torch.cat([body.mass.reshape(1), body.com, body.inertia_about_com]).tolist()
    estimated = zip(study.payload.estimate.tool.quantities, true, strict=True)
    return [(x.name, x.unit, t, x.value, *x.ci95) for x, t in estimated]


def verdict(study: Study) -> list[str]:
    """One sentence or two for each part of the study."""
    identified, _, true = validation_torques(study)
    share = float((rms(identified - true) / rms(true)).max())
    # Share of a signal's root mean square below which a difference is called rounding
    rounding = 1e-9
    quality = "exact to rounding" if share < rounding else "not exact"
    said = [
        f"Identification: {len(study.truth)} coefficients, largest error "
        f"{number(coefficient_error(study), 2)}; on a new motion the torque is wrong by at most "
        f"{number(share, 2)} of its root mean square: {quality}."
    ]
    asked = study.scenarios[0].extraction.problem.conditions
    why = feasibility(nominal_set(study.robot), asked).reasons(0)
    said.append(
        f"Truth: the simulated arm's own parameters are not feasible ({listed(why)}), so near to "
        "the real arm and feasible are two different things here."
        if why
        else "Truth: the simulated arm's own parameters are feasible."
    )
    for bounds in proofs(study).get("", ()):
        said.append(f"Open: whether a set of '{bounds}' has exactly the identified coefficients.")
    if not study.certificates:
        said.append(
            "Open: there is no certificate, so how small the loss of a feasible set can be is not "
            "known."
        )
    off, real = torque_errors(study.sets_motion)
    worst = dict(zip(study.sets_motion.labels[1:], (off / real).amax(1).tolist(), strict=True))
    exact = [name for name, size in worst.items() if size < rounding]
    others = [f"{n} {number(100 * size)} %" for n, size in worst.items() if n not in exact]
    largest = f"; largest error relative to a joint's torque: {listed(others)}" if others else ""
    said.append(
        "Torque on a new motion: equal to the real one to rounding with "
        f"{listed(exact, nothing='no set')}{largest}."
    )
    effects = study.comparison.effects
    said += [_class(study, e) for e in effects if not math.isnan(e.ratio.value)]
    skipped = [f"{e.first} ({e.sets[0]})" for e in effects if math.isnan(e.ratio.value)]
    if skipped:
        said.append(f"Internal forces: not compared for lack of sets: {listed(skipped)}.")
    said.append(_payload(study))
    return said + [f"Noticed: {warning}" for warning in study.warnings]


def proofs(study: Study) -> dict[str, list[str]]:
    """What the certificates prove, and of which bounds; under an empty text those of which it is
    open whether a set has exactly the identified coefficients."""
    out: dict[str, list[str]] = {}
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
        out.setdefault(text, []).append(bounds)
    return out


def _class(study: Study, e: EffectSize) -> str:
    low, high = e.ratio.low, e.ratio.high
    classes, few = run_classes(study), []
    for name in (e.first, e.second):
        rows = [k for k, own_class in enumerate(classes) if own_class == name]
        distinct = count_different(study.errors.force_rms[rows].amax(-1))
        few += [f"{distinct} different among '{name}'"] if distinct < LEAST_CLUSTERS else []
    if few:
        why = f"not judged: only {listed(few)}"
    elif math.isnan(low):
        why = "no interval can be given"
    elif low > 1:
        why = "larger"
    elif high < 1:
        why = "smaller"
    else:
        why = "not distinguished"
    interval = "" if math.isnan(low) else f", 95 % interval {number(low)} to {number(high)}"
    return (
        f"Internal forces: the errors of the {e.sets[0]} '{e.first}' sets are "
        f"{number(e.ratio.value)} times those of the {e.sets[1]} '{e.second}' ones "
        f"({why}{interval})."
    )


def _payload(study: Study) -> str:
    (_, _, true, mass, low, high), *_ = every = payload_quantities(study)
    if math.isnan(low):
        return "Payload: its mass is not determined."
    held = [start <= value <= end for _, _, value, _, start, end in every if start == start]
    return (
        f"Payload: {number(mass, 6)} ± {number((high - low) / 2, 2)} kg against the true "
        f"{number(true, 6)} kg; the intervals hold the truth for {sum(held)} of "
        f"{count(len(held), 'quantity', 'quantities')}."
    )
