"""A study's motions, torques and searches: exciting trajectories with their noise, the motions of
the comparisons, the torques of the identified coefficients and of the best sets; convergence,
losses against what is possible, degrees."""

import math
from functools import partial
from typing import Any

import numpy as np
import torch

from torchid.log.model import Log
from torchid.report.colours import BLUE, BREAKS, GREEN, GREY, INK, KEEPS, ORANGE, RED
from torchid.report.log import SIGNALS, trajectory_figure
from torchid.report.panels import (
    Figure,
    Picture,
    drawing,
    finish,
    headroom,
    joint_rows,
    note,
    panel,
    spread,
    thin,
)
from torchid.report.study import facts
from torchid.report.study.facts import at_joint, ids, kept, number, rms
from torchid.results.words import count, listed
from torchid.robot.model import torque_unit
from torchid.study.result import ScenarioResult, Study
from torchid.study.study import new_motion
from torchid.typing import Tensor

_UNITS = ("rad", "rad/s", "rad/s²")
"""Of the signals that the report's noise is added to, where joints turn."""


def motion_drawings(study: Study) -> list[Picture]:
    """Every motion of the study (figures 5.1, 5.2, 5.5 and their like)."""
    planned, logged = study.excitation.trajectories(), study.log.trajectories()
    total, name = len(planned), study.robot.name
    noise, validation = study.settings.excitation.noise_db, study.settings.validation
    out = [
        _motion(
            study, "identification", f"excitation_{k}", plan,
            f"{name}: exciting trajectory {k} of {total}",
            f"Exciting trajectory {k} of {total}, {_sampling(plan)}, per joint. ", log, noise,
        )
        for k, (plan, log) in enumerate(zip(planned, logged, strict=True), start=1)
    ]  # fmt: skip
    if noise is not None:
        plan, log = planned[0], logged[0]
        largest = []
        for (what, signal), unit in zip(SIGNALS, _UNITS, strict=True):
            sizes = rms(getattr(log, signal) - getattr(plan, signal)).tolist()
            largest.append(f"{what} {at_joint(sizes, unit)}")
        caption = (
            "The noise of exciting trajectory 1 alone: the noisy minus the planned motion, with "
            f"its root mean square in each panel. Largest: {listed(largest)}."
        )
        noise_only = partial(_noise_figure, study, plan, log)
        out.append(drawing("identification", "excitation_noise", caption, noise_only))
    others = (
        ("identification", "validation_motion",
         "The sinusoidal motion that validates the coefficients and takes no part in the fit",
         new_motion(study.robot, validation), study.validation, validation.noise_db),
        ("validation", "sets_motion",
         "The motion on which the torques of the best sets are compared",
         study.sets_motion.motion, None, None),
        ("wrenches", "reference_motion",
         "The reference motion on which the internal wrenches are compared",
         study.wrench_motion.motion, None, None),
    )  # fmt: skip
    for section, file, what, plan, own, noise_db in others:
        title, caption = f"{name}: {file.replace('_', ' ')}", f"{what}, {_sampling(plan)}. "
        out.append(_motion(study, section, file, plan, title, caption, own, noise_db))
    return out


def _motion(
    study: Study,
    section: str,
    file: str,
    plan: Log,
    title: str,
    caption: str,
    log: Log | None = None,
    noise_db: float | None = None,
) -> Picture:
    """A planned motion with the robot's limits, under the noisy one, if it is noisy."""
    noisy = None if noise_db is None else log
    robot = study.robot
    caption += _use(study, plan)
    if noisy is not None:
        caption += _noise(study, plan, noisy, noise_db)
    return drawing(section, file, caption, lambda: trajectory_figure(robot, plan, title, noisy))


def _noise_figure(study: Study, plan: Log, log: Log) -> Figure:
    """The noise alone: at the scale of the motion it is as wide as a line."""
    robot = study.robot
    headings = [f"{name} [{unit}]" for (name, _), unit in zip(SIGNALS, _UNITS, strict=True)]
    figure, grid = joint_rows(robot.n, headings, (11, 1.0 + 1.25 * robot.n))
    t = thin(plan.t - plan.t[0])
    for column, (_, signal) in zip(grid.T, SIGNALS, strict=True):
        difference = getattr(log, signal) - getattr(plan, signal)
        for j, axes in enumerate(column):
            axes.plot(t, thin(difference[:, j]), color=ORANGE, linewidth=0.6)
            headroom(axes)
            note(axes, number(float(rms(difference)[j]), 2))
    return finish(figure, f"{robot.name}: noise of exciting trajectory 1")


def _sampling(motion: Log) -> str:
    rate = (motion.samples - 1) / motion.duration[0]
    return f"{motion.duration[0]:.4g} s at {rate:.4g} Hz ({motion.samples} instants)"


def _use(study: Study, motion: Log) -> str:
    """How much of the limits a motion uses."""
    parts = []
    for name, signal in SIGNALS:
        limits = getattr(study.robot.limits, name)
        values = getattr(motion, signal)
        if limits is None or values is None or not bool(torch.isfinite(limits).all()):
            continue
        middle, half = limits.mean(-1), (limits[:, 1] - limits[:, 0]) / 2
        share = ((values - middle).abs() / half).amax(0)
        joint = int(share.argmax())
        parts.append(f"{100 * float(share[joint]):.0f} % of the {name} limit (joint {joint + 1})")
    return f"It reaches at most {listed(parts)}; limits are red." if parts else ""


def _noise(study: Study, plan: Log, log: Log, noise_db: float | None) -> str:
    beyond, shares = torch.zeros(log.samples, dtype=torch.bool), []
    for name, signal in SIGNALS:
        limits, values, clean = (
            getattr(x, y) for x, y in ((study.robot.limits, name), (log, signal), (plan, signal))
        )
        shares.append(float((rms(values - clean) / rms(clean)).max()))
        if limits is not None:
            beyond |= ((values < limits[:, 0]) | (values > limits[:, 1])).any(-1)
    return (
        f" Orange: the same with white noise of {noise_db:g} dB signal-to-noise ratio on "
        "position, velocity and acceleration, from which the torque is computed: the log is noisy "
        "in its motion but does not contradict itself. The noise is at most "
        f"{number(100 * max(shares))} % of a signal's root mean square, little more than the line "
        "is wide; with it "
        f"{100 * float(beyond.double().mean()):.1f} % of the instants are beyond a limit."
    )


def torque_drawings(study: Study) -> list[Picture]:
    """Torques of the validation and of the best sets (figures 5.3, 5.4 and their like)."""
    identified, rebuilt, true = facts.validation_torques(study)
    size = rms(true)
    error = rms(identified - true) / size
    worst, where = float(error.max()), int(error.argmax()) + 1
    verdict = (
        "that is rounding: the two overlap and the identification is exact"
        if worst < facts.ROUNDING
        else "the identification is not exact"
    )
    other = float((rms(rebuilt - true) / size).max())
    caption = (
        "Torque on the validation motion: of the identified coefficients (red), of the "
        "coefficients reconstructed from the true parameters (blue, dotted) and of the true "
        "parameters in the dynamic model (green, dashed). The residuals at the right have scales "
        "of their own. The identified torque differs from the true one by at most "
        f"{number(worst)} of its root mean square (joint {where}); {verdict}. The reconstructed "
        f"one differs by at most {number(other)}: as far as the regrouping itself is exact."
    )
    validation = drawing(
        "identification", "validation_torque", caption,
        lambda: _torque_figure(study),
    )  # fmt: skip
    return [validation, _sets_torque(study)]


def _torque_figure(study: Study) -> Figure:
    identified, rebuilt, true = facts.validation_torques(study)
    n, unit = study.robot.n, torque_unit(study.robot, "N m; N")
    headings = (f"torque [{unit}]", f"residual [{unit}]")
    figure, grid = joint_rows(n, headings, (11, 1.2 + 1.35 * n), width_ratios=(3, 2))
    t = thin(study.validation.t - study.validation.t[0])
    lines = (
        (identified, "identified", RED, "-", 2.6),
        (rebuilt, "reconstructed", BLUE, ":", 2.0),
        (true, "true parameters", GREEN, "--", 1.2),
    )
    residuals = (
        (identified - true, "identified - true", ORANGE),
        (rebuilt - true, "reconstructed - true", GREY),
    )
    for j, (left, right) in enumerate(grid):
        for values, name, colour, style, width in lines:
            left.plot(t, thin(values[:, j]), style, color=colour, linewidth=width, label=name)
        for values, name, colour in residuals:
            right.plot(t, thin(values[:, j]), color=colour, linewidth=0.7, label=name)
        right.yaxis.get_offset_text().set_fontsize(8)
        headroom(right)
        note(right, f"largest {number(float((identified - true)[:, j].abs().max()), 2)}")
    title = f"{study.robot.name}: torque on the motion of the validation"
    return finish(figure, title, *grid[0], columns=5)


def _sets_torque(study: Study) -> Picture:
    error, real = facts.torque_errors(study.sets_motion)
    share, unit = error / real, torque_unit(study.robot, "N m; N")
    names = study.sets_motion.labels[1:]
    close = [k for k in range(len(names)) if float(share[k].max()) < facts.ROUNDING]
    sentences = []
    if close:
        sentences.append(
            f"{listed(names[k] for k in close)} {'gives' if len(close) == 1 else 'give'} the real "
            f"torque to rounding (at most {number(float(share[close].max()))} of its root mean "
            "square): the torque cannot tell such a set from the real one."
        )
    sentences += [
        f"{names[k]} does not: its error is largest with {at_joint(error[k].tolist(), unit)}, and "
        f"relative to the joint's torque with {at_joint((100 * share[k]).tolist(), '%')}, whose "
        f"torque is {number(float(real[share[k].argmax()]))} {unit}."
        for k in range(len(names))
        if k not in close
    ]
    caption = (
        f"Torque of the {count(len(names), 'best set')} (columns, dashed) over that of the real "
        f"parameters (grey) per joint (rows) [{unit}], on a motion that took no part in anything "
        f"before; the number is the root mean square difference. {' '.join(sentences)}"
    )
    return drawing("validation", "sets_torque", caption, lambda: _sets_figure(study))


def _sets_figure(study: Study) -> Figure:
    error, _ = facts.torque_errors(study.sets_motion)
    sets, n, unit = study.sets_motion, study.robot.n, torque_unit(study.robot, "N m; N")
    names = sets.labels[1:]
    size = max(6.0, 1.0 + 2.05 * len(names)), 1.2 + 1.2 * n
    figure, grid = joint_rows(n, names, size, sharey="row")
    t = thin(sets.motion.t)
    for s, column in enumerate(grid.T):
        colour = KEEPS if study.scenarios[s].feasible else BREAKS
        for j, axes in enumerate(column):
            axes.plot(t, thin(sets.torque[0, :, j]), color=GREY, linewidth=3.0)
            axes.plot(t, thin(sets.torque[s + 1, :, j]), "--", color=colour, linewidth=1.1)
            note(axes, number(float(error[s, j]), 2))
            if s == len(names) - 1:
                headroom(axes)
    keys: dict[str, dict[str, Any]] = {
        "real": {"color": GREY, "linewidth": 3.0},
        "feasible set": {"color": KEEPS, "linestyle": "--"},
        "infeasible set": {"color": BREAKS, "linestyle": "--"},
    }
    title = f"{study.robot.name}: torque [{unit}] of the best sets on a new motion"
    return finish(figure, title, columns=3, keys=keys)


_LEAST_PHI = 1e-32
"""Losses below it are drawn on it: the square of rounding."""
_NEAR = 1e-4
"""Degree below which a feasible set is called close to the boundary."""
_REACHED = 1.01
"""Times phi_min up to which a loss counts as having reached it."""


def search_drawings(study: Study) -> list[Picture]:
    """Convergence, losses and degrees of all runs."""
    return [
        drawing("extraction", "search_convergence", _convergence_caption(study),
                lambda: _convergence(study)),
        drawing("extraction", "search_losses", _losses_caption(study), lambda: _losses(study)),
        drawing("classification", "degrees", _degrees_caption(study), lambda: _degrees(study)),
    ]  # fmt: skip


def _convergence_caption(study: Study) -> str:
    search = study.settings.search
    sentences = []
    for s in study.scenarios:
        e = s.extraction
        first, last = (float(e.history_phi[:, k].median()) for k in (0, -1))
        sentences.append(
            f"{s.scenario.id}: median phi {number(first)} after the first stage and {number(last)} "
            f"after the last, {kept(e.history_gamma[:, -1])} of {len(e.sets)} runs without penalty"
        )
    return (
        "Loss phi (above) and penalty gamma (below) of the best point so far after each of "
        f"{search.stages} stages; thin: all runs, thick: the run that is best "
        "in the end, red: phi_min of the scenario's bounds where it is not zero. Under the "
        "full loss xi grows from stage to stage, so phi may rise while gamma falls. "
        f"{'; '.join(sentences)}."
    )


def _convergence(study: Study) -> Figure:
    k = len(study.scenarios)
    width = max(6.0, 1.0 + 2.1 * k)
    figure, grid = panel(width, 5.6, 2, k, sharex=True, sharey="row", squeeze=False)
    gammas = torch.cat([s.extraction.history_gamma.flatten() for s in study.scenarios])
    positive = gammas[(gammas > 0) & torch.isfinite(gammas)]
    zero = 10.0 ** (math.floor(math.log10(float(positive.min()))) - 1) if len(positive) else 1e-1
    for c, s in enumerate(study.scenarios):
        e = s.extraction
        for axes, history, floor in zip(
            grid[:, c], (e.history_phi, e.history_gamma), (_LEAST_PHI, zero), strict=True
        ):
            values = _floored(history, floor)
            axes.set(yscale="log", xlabel="stage" if axes is grid[1, c] else "")
            stages = np.arange(1, values.shape[1] + 1)
            axes.plot(stages, values.T, color=GREY, linewidth=0.5, alpha=0.7)
            axes.plot(stages, values[e.best], color=BLUE, linewidth=2.0)
        least = facts.phi_min(study, s)
        if _LEAST_PHI < least < math.inf:
            grid[0, c].axhline(least, color=BREAKS, linewidth=1.2)
        heading = f"{s.scenario.id}: {s.scenario.bounds}, {s.scenario.penalty}"
        grid[0, c].set_title(heading, fontsize=9, color=KEEPS if s.feasible else BREAKS)
        grid[1, c].axhline(zero, color=INK, linewidth=0.8)
        grid[1, c].text(0.98, zero / 1.3, "gamma = 0", transform=grid[1, c].get_yaxis_transform(),
                        fontsize=7, color=INK, ha="right", va="top")  # fmt: skip
    grid[0, 0].set_ylabel("phi")
    grid[1, 0].set(ylim=(zero / 10, None), ylabel="gamma")
    keys = {
        "runs": {"color": GREY, "linewidth": 0.8},
        "best run": {"color": BLUE, "linewidth": 2.0},
        "phi_min": {"color": BREAKS, "linewidth": 1.2},
    }
    if not any(_LEAST_PHI < facts.phi_min(study, s) < math.inf for s in study.scenarios):
        del keys["phi_min"]
    return finish(figure, f"{study.robot.name}: the search, stage by stage", keys=keys)


def _losses_caption(study: Study) -> str:
    sentences = []
    for s in study.scenarios:
        e, least = s.extraction, facts.phi_min(study, s)
        if math.isnan(least):
            said = "no phi_min is known"
        elif least == 0:
            said = "phi_min is 0"
        else:
            near = int((e.phi <= _REACHED * least).sum())
            under = e.phi < least
            said = (
                f"phi_min is {number(least)}, {near} runs end within 1 % of it or below, "
                f"{int(under.sum())} below ({int((under & s.feasibility.feasible).sum())} of these "
                "feasible)"
            )
        ended = count(len(facts.endings(s).unique()), "different set")
        sentences.append(
            f"{s.scenario.id}: best {number(s.phi)}, {ended} in {count(len(e.sets), 'run')}; {said}"
        )
    return (
        "Loss of every run after its last stage (grey) and in the end (green: feasible, red: "
        "infeasible), the best set ringed, and phi_min as a bar: the proven least loss of any "
        "feasible set, so nothing green can be below it. Losses below "
        f"{_LEAST_PHI:g} are drawn there. {'. '.join(sentences)}."
    )


def _losses(study: Study) -> Figure:
    figure, axes = _columns(study)
    axes.set(yscale="log", ylabel="loss phi")
    for c, s in enumerate(study.scenarios):
        e = s.extraction
        before, after = (_floored(x, _LEAST_PHI) for x in (e.history_phi[:, -1], e.phi))
        axes.scatter(c - 0.2 + spread(len(before), 1, 0.1), before, s=10, color=GREY, linewidth=0)
        place = c + 0.15 + spread(len(after), 2, 0.12)
        _marks(axes, s, place, after)
        least = facts.phi_min(study, s)
        if not math.isnan(least) and least < math.inf:
            axes.hlines(max(least, _LEAST_PHI), c - 0.42, c + 0.42, color=INK, linewidth=1.6)
    axes.scatter([], [], s=10, color=GREY, label="after the last stage")
    _names(axes)
    axes.plot([], [], color=INK, linewidth=1.6, label="phi_min")
    title = f"{study.robot.name}: losses of all runs against what is possible"
    return finish(figure, title, axes, columns=5)


def _floored(values: Tensor, floor: float) -> np.ndarray:
    """Values for a logarithmic axis: what is smaller than the floor is drawn on it."""
    return torch.nan_to_num(values, nan=torch.inf).clamp(min=floor).cpu().numpy()


def _marks(axes: Any, s: ScenarioResult, place: np.ndarray, values: np.ndarray) -> None:
    feasible = s.feasibility.feasible.cpu().numpy()
    for chosen, colour, marker in ((~feasible, BREAKS, "x"), (feasible, KEEPS, "o")):
        axes.scatter(place[chosen], values[chosen], s=16, color=colour, marker=marker, linewidth=1)
    best = s.extraction.best
    axes.scatter(place[best], values[best], s=90, facecolors="none", edgecolors=INK, linewidth=1.2)


def _names(axes: Any) -> None:
    axes.scatter([], [], s=16, color=KEEPS, marker="o", label="feasible")
    axes.scatter([], [], s=16, color=BREAKS, marker="x", label="infeasible")
    axes.scatter([], [], s=90, facecolors="none", edgecolors=INK, label="best set")


def _columns(study: Study) -> tuple[Figure, Any]:
    """A panel with one column a scenario."""
    names = [f"{s.scenario.id}\n{s.scenario.bounds}, {s.scenario.penalty}" for s in study.scenarios]
    figure, axes = panel(max(6.0, 1.5 + 1.5 * len(names)), 4.6)
    axes.set_xticks(range(len(names)), names, fontsize=8)
    axes.set_xlim(-0.6, len(names) - 0.4)
    return figure, axes


def _degrees_caption(study: Study) -> str:
    sentences = []
    for s in study.scenarios:
        degree = s.feasibility.degree
        sentences.append(
            f"{s.scenario.id}: {int(s.feasibility.feasible.sum())} of {len(degree)} runs feasible, "
            f"degrees from {number(float(degree.min()), 2)} to {number(float(degree.max()), 2)}"
        )
    good = facts.by_feasibility(study, True)
    firm = max(good, key=lambda s: s.degree) if good else None
    if firm is None:
        last = "No best set is feasible."
    elif len(good) == 1:
        last = f"The only feasible best set, {firm.scenario.id}, has {number(firm.degree, 2)}."
    else:
        last = (
            f"Of the feasible best sets ({listed(ids(good))}) {firm.scenario.id} is the firmest, "
            f"with {number(firm.degree, 2)}."
        )
    degrees, feasible = facts.all_degrees(study), int((facts.all_degrees(study) > 0).sum())
    near = int(((degrees > 0) & (degrees < _NEAR)).sum())
    close = (
        f" {near} of {count(feasible, 'feasible run')} are within {_NEAR:g} of the boundary: "
        "feasible, but only just."
        if near
        else ""
    )
    return (
        "Degree of every run: the smallest margin of its conditions over their scales, negative "
        "outside, 0 on the boundary (the axis is linear within 0.001 and logarithmic beyond). "
        f"{'; '.join(sentences)}. {last}{close}"
    )


def _degrees(study: Study) -> Figure:
    figure, axes = _columns(study)
    axes.set_yscale("symlog", linthresh=1e-3, linscale=0.6)
    for c, s in enumerate(study.scenarios):
        degree = s.feasibility.degree.cpu().numpy()
        _marks(axes, s, c + spread(len(degree), 3, 0.25), degree)
    low, high = axes.get_ylim()
    high = max(high, 1e-1)
    axes.axhspan(0, high, color=KEEPS, alpha=0.08, linewidth=0)
    axes.axhline(0, color=INK, linewidth=0.9)
    axes.set(ylim=(low, high), ylabel="degree [-]")
    _names(axes)
    return finish(figure, f"{study.robot.name}: degree of feasibility of all runs", axes, columns=3)
