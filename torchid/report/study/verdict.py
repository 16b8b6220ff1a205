"""What came out of a study, in sentences whose numbers and words are computed."""

import math

from torchid.feasibility.margins import feasibility
from torchid.feasibility.sets import nominal_set
from torchid.report.study import facts
from torchid.report.study.facts import at_joint, count, ids, number, rms
from torchid.report.text import listed
from torchid.study.result import Study
from torchid.wrenches.compare import LEAST_CLUSTERS, EffectSize


def headline(study: Study) -> str:
    """Two sentences: how many sets are feasible, and what being infeasible costs inside."""
    good = ids(facts.by_feasibility(study, True))
    error = float((study.identification.values - study.truth).abs().max())
    medians = [
        f"{c.name} {number(c.median)}" for c in study.comparison.classes if c.median is not None
    ]
    inside = (
        f" Median error of the internal force over all runs [N]: {', '.join(medians)}."
        if medians
        else ""
    )
    return (
        f"{study.settings.title}: {len(study.truth)} coefficients identified with errors up to "
        f"{number(error, 2)}; {len(good)} of {len(study.scenarios)} best sets feasible"
        f"{f' ({listed(good)})' if good else ''}.{inside}"
    )


def verdict(study: Study) -> list[str]:
    """One sentence or two for each part of the study."""
    identified, _, true = facts.validation_torques(study)
    share = float((rms(identified - true) / rms(true)).max())
    error = float((study.identification.values - study.truth).abs().max())
    quality = "exact to rounding" if share < facts.ROUNDING else "not exact"
    said = [
        f"Identification: {len(study.truth)} coefficients, largest error {number(error, 2)}; on a "
        f"new motion the torque is wrong by at most {number(share, 2)} of its root mean square: "
        f"{quality}."
    ]
    asked = study.scenarios[0].extraction.problem.conditions
    why = feasibility(nominal_set(study.robot), asked).reasons(0)
    said.append(
        f"Truth: the simulated arm's own parameters are not feasible ({listed(why)}), so near to "
        "the real arm and feasible are two different things here."
        if why
        else "Truth: the simulated arm's own parameters are feasible."
    )
    said += _possible(study)
    good, bad = facts.by_feasibility(study, True), facts.by_feasibility(study, False)
    runs = sum(len(s.extraction.sets) for s in study.scenarios)
    feasible = sum(int(s.feasibility.feasible.sum()) for s in study.scenarios)
    failing = [f"{s.scenario.id} ({', '.join(s.reasons)})" for s in bad]
    said.append(
        f"Feasible: {len(good)} of the {len(study.scenarios)} best sets"
        f"{f' ({listed(ids(good))})' if good else ''}, and {feasible} of "
        f"{count(runs, 'run')}.{f' Not feasible: {listed(failing)}.' if failing else ''}"
    )
    off, real = facts.torque_errors(study.sets_motion)
    exact, others = [], []
    for name, row in zip(study.sets_motion.labels[1:], off / real, strict=True):
        if float(row.max()) < facts.ROUNDING:
            exact.append(name)
        else:
            others.append(f"{name} {at_joint((100 * row).tolist(), '%')}")
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


def _possible(study: Study) -> list[str]:
    """What the certificates say: the least loss of a feasible set, and what forces it."""
    free = [b for b, c in study.certificates.items() if c.exact and c.with_conditions]
    out = []
    if free:
        out.append(
            f"Possible: within the bounds {listed(free)} there are feasible sets with exactly the "
            "identified coefficients (phi_min = 0)."
        )
    for bounds, c in study.certificates.items():
        if math.isinf(c.phi_min):
            out.append(f"Impossible: within the bounds {bounds} there is no physical set.")
            continue
        if math.isnan(c.phi_min):
            out.append(f"Unknown: within the bounds {bounds} the solver failed.")
            continue
        whose = "feasible" if facts.with_conditions(study, bounds) else "physical"
        if c.phi_min > 0:
            why = f" Forced by {listed(c.forcing)}." if c.forcing else ""
            out.append(
                f"Impossible: within the bounds {bounds} no {whose} set has a loss below phi_min = "
                f"{number(c.phi_min, 4)} (a set with {number(c.phi_strict, 4)} was found), so "
                f"none has exactly the identified coefficients.{why}"
            )
        elif not c.exact:
            out.append(
                f"Open: within the bounds {bounds} the least loss of a {whose} set lies between 0 "
                f"and {number(c.phi_strict, 4)}."
            )
    return out


def _class(study: Study, e: EffectSize) -> str:
    low, high = e.ratio.low, e.ratio.high
    distinct = {name: facts.distinct_errors(study, name) for name in (e.first, e.second)}
    few = [f"{k} different among '{name}'" for name, k in distinct.items() if k < LEAST_CLUSTERS]
    if few:
        told = f"not judged: only {listed(few)}"
    elif math.isnan(low):
        told = "no interval can be given"
    elif low > 1:
        told = "larger"
    elif high < 1:
        told = "smaller"
    else:
        told = "not told apart"
    interval = "" if math.isnan(low) else f", 95 % interval {number(low)} to {number(high)}"
    return (
        f"Internal forces: the errors of the {e.sets[0]} '{e.first}' sets are "
        f"{number(e.ratio.value)} times those of the {e.sets[1]} '{e.second}' ones "
        f"({told}{interval})."
    )


def _payload(study: Study) -> str:
    truth, value, low, high = facts.payload_numbers(study)
    known = [k for k in range(len(truth)) if math.isfinite(value[k]) and math.isfinite(low[k])]
    held = sum(low[k] <= truth[k] <= high[k] for k in known)
    if 0 not in known:
        return "Payload: its mass is not determined."
    return (
        f"Payload: {number(value[0], 6)} ± {number((high[0] - low[0]) / 2, 2)} kg against the true "
        f"{number(truth[0], 6)} kg; the intervals hold the truth for {held} of "
        f"{count(len(known), 'quantity', 'quantities')}."
    )
