"""A study's figures (5.1 to 5.19 of the report, and more): its motions and torques, searches and
degrees, internal wrenches of its sets, and its payload."""

from collections.abc import Sequence
from functools import partial
from itertools import product
from typing import Any

import torch

from torchid.log.model import Log
from torchid.report.colours import BLUE, BREAKS, GREEN, GREY, INK, KEEPS, ORANGE, REAL, RED
from torchid.report.log import trajectory_figure
from torchid.report.panels import (
    Figure,
    Figures,
    Picture,
    drawing,
    finish,
    headroom,
    jitter,
    joint_lines,
    joint_rows,
    note,
    panel,
    thin,
)
from torchid.robot.model import torque_unit
from torchid_study.report.equal_torque import by_class, error_by_degree
from torchid_study.report.study import facts
from torchid_study.report.study.facts import by_feasibility, ids, number
from torchid_study.result import SetsOnMotion, Study
from torchid_study.study import new_motion

_Line = tuple[str, str, str]
"""What the legend says, id of the set or `real`, colour."""
_REAL: _Line = ("real", "real", REAL)


def drawings(study: Study) -> list[Picture]:
    """Every figure with its caption, none of them drawn yet."""
    # Of every study, whatever its sets.
    fixed = (
        ("identification", "validation_torque", _torque_figure,
         "Torque on the validation motion: of the identified coefficients (red), of those "
         "reconstructed from the true parameters (blue, dotted) and of the true parameters in "
         "the dynamic model (green, dashed). The residuals at the right have their own scales."),
        ("validation", "sets_torque", _sets_figure,
         "Torque of the best sets (columns, dashed) over that of the real parameters (grey) per "
         "joint (rows), on a motion that took no part in anything before; the number is the "
         "root mean square difference."),
        ("classification", "degrees", _degrees,
         "Degree of every run: the smallest margin of its conditions over their scales, "
         "negative outside, 0 on the boundary (the axis is linear within 0.001 and logarithmic "
         "beyond)."),
        ("wrenches", "force_error_by_degree", _error_figure,
         "Force error of every run (root mean square of the vector difference from the real "
         "arm, largest joint) against its degree, by the kind of its reasons. The best sets "
         "have their names."),
        ("payload", "payload_force", _force,
         "Norms of the internal forces on the reference motion without the payload, with the "
         "true one, and with the estimated one."),
    )  # fmt: skip
    return [
        *_motions(study),
        *(drawing(place, name, text, partial(draw, study)) for place, name, draw, text in fixed),
        *_combinations(study),
    ]


def kinds(study: Study) -> Figures:
    """What draws each figure, by its name."""
    return {picture.name: picture.draw for picture in drawings(study)}


def _motions(study: Study) -> list[Picture]:
    """Every motion, and the noise with which it was logged."""
    planned, logged = study.excitation.trajectories(), study.log.trajectories()
    validation, noise = study.settings.validation, study.settings.excitation.noise_db
    shown: list[tuple[str, str, str, Log, Log | None, float | None]] = [
        ("identification", f"excitation_{k}", f"Exciting trajectory {k} of {len(planned)}", plan,
         log, noise)
        for k, (plan, log) in enumerate(zip(planned, logged, strict=True), start=1)
    ]  # fmt: skip
    shown += [
        ("identification", "validation_motion",
         "The sinusoidal motion that validates the coefficients and takes no part in the fit",
         new_motion(study.robot, validation), study.validation, validation.noise_db),
        ("validation", "sets_motion",
         "The motion on which the torques of the best sets are compared",
         study.sets_motion.motion, None, None),
        ("wrenches", "reference_motion",
         "The reference motion on which the internal wrenches are compared",
         study.wrench_motion.motion, None, None),
    ]  # fmt: skip
    out = []
    for section, name, what, plan, log, noise_db in shown:
        seconds = plan.duration[0]
        caption = (
            f"{what}, {seconds:.4g} s at {(plan.samples - 1) / seconds:.4g} Hz ({plan.samples} "
            "instants), per joint; limits are red."
        )
        if noise_db is not None:
            caption += (
                f" Orange: the same with white noise of {noise_db:g} dB signal-to-noise ratio on "
                "position, velocity and acceleration, from which the torque is computed: the log "
                "is noisy in its motion but does not contradict itself."
            )
        title = f"{study.robot.name}: {name.replace('_', ' ')}"
        noisy = None if noise_db is None else log
        draw = partial(trajectory_figure, study.robot, plan, title, noisy)
        out.append(drawing(section, name, caption, draw))
    return out


def _combinations(study: Study) -> list[Picture]:
    """Internal forces of every feasible best set beside every infeasible one; one of them is left
    out where there is none."""
    good, bad = (ids(by_feasibility(study, kind)) or [""] for kind in (True, False))
    wrench, out = study.wrench_motion, []
    for a, b in product(good, bad):
        parts = [x for x in (("F", a, KEEPS), ("UN", b, BREAKS)) if x[1]]
        shown = [_REAL, *((f"{kind} = {own}", own, colour) for kind, own, colour in parts)]
        named = ", ".join(x[0] for x in shown[1:])
        caption = f"Norms of the internal forces on the reference motion, per joint: {named}, real."
        title = f"{study.robot.name}: internal forces, {named}, real"
        draw = partial(_norms, wrench, shown, title)
        name = "wrenches_" + "_".join(f"{kind}-{own}" for kind, own, _ in parts)
        out.append(drawing("wrenches", name, caption, draw))
    return out


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


def _degrees(study: Study) -> Figure:
    names = [f"{s.scenario.id}\n{s.scenario.bounds}, {s.scenario.penalty}" for s in study.scenarios]
    figure, axes = panel(max(6.0, 1.5 + 1.5 * len(names)), 4.6)
    ring = {"s": 90, "facecolors": "none", "edgecolors": INK, "linewidth": 1.2, "label": "best set"}
    for c, s in enumerate(study.scenarios):
        degree, feasible = s.feasibility.degree, s.feasibility.feasible
        place, best = c + jitter(len(degree), 3, 0.25), s.extraction.best
        for own, colour, marker, name in (
            (~feasible, BREAKS, "x", "infeasible"), (feasible, KEEPS, "o", "feasible"),
        ):  # fmt: skip
            look = {"s": 16, "color": colour, "marker": marker, "linewidth": 1, "label": name}
            axes.scatter(place[own.numpy()], degree[own].numpy(), **look)
        axes.scatter(place[best], float(degree[best]), **ring)
    axes.set_yscale("symlog", linthresh=1e-3, linscale=0.6)
    low, high = axes.get_ylim()
    high = max(high, 1e-1)
    axes.axhspan(0, high, color=KEEPS, alpha=0.08, linewidth=0)
    axes.axhline(0, color=INK, linewidth=0.9)
    axes.set_xticks(range(len(names)), names, fontsize=8)
    axes.set(xlim=(-0.6, len(names) - 0.4), ylim=(low, high), ylabel="degree [-]")
    return finish(figure, f"{study.robot.name}: degree of feasibility of all runs", axes, columns=3)


def _norms(sets: SetsOnMotion, chosen: Sequence[_Line], title: str) -> Figure:
    """Norms of the forces of some sets, one panel a joint."""
    shown = sets.force[[sets.labels.index(own) for _, own, _ in chosen]]
    real = sets.force[0].amax(0)
    # 8.0: times the real arm's largest value from which a logarithmic axis is easier to read
    far = bool((shown.amax((0, 1)) > 8.0 * real.clamp(min=1e-9)).any())
    curves = {}
    for (text, own, colour), norms in zip(chosen, shown, strict=True):
        width, order = (2.4, 2) if own == "real" else (1.3, 3)
        style = {"linewidth": width, "zorder": order, "alpha": 0.85}
        curves[text] = (thin(norms), {"color": colour, **style})
    title += " (logarithmic)" if far else ""
    figure, panels = joint_lines(
        title, "force norm [N]", thin(sets.motion.t - sets.motion.t[0]), curves
    )
    for j, axes in enumerate(panels if far else ()):
        # 1e-3: share of the real arm's largest value down to which a logarithmic axis goes
        least = max(1e-3 * float(real[j]), float(shown[..., j].min()) / 2)
        axes.set(yscale="log", ylim=(least, None))
    return figure


def _error_figure(study: Study) -> Figure:
    return error_by_degree(
        f"{study.robot.name}: force error by degree and by reason, all runs",
        torch.cat([s.feasibility.degree for s in study.scenarios]).numpy(),
        study.errors.force_rms.amax(-1).numpy(),
        by_class(facts.run_classes(study)),
        zip(facts.best_rows(study), ids(study.scenarios), strict=True),
    )


def _force(study: Study) -> Figure:
    t = study.wrench_motion.motion.t
    styles = {
        "without payload": {"color": GREY, "linewidth": 1.2},
        "with the true payload": {"color": INK, "linewidth": 2.4},
        "with the estimated payload": {"color": ORANGE, "linewidth": 1.3, "linestyle": "--"},
    }
    lines = zip(styles, study.payload.force, styles.values(), strict=True)
    curves = {name: (thin(force), style) for name, force, style in lines}
    title = f"{study.robot.name}: internal forces with a payload"
    return joint_lines(title, "force norm [N]", thin(t - t[0]), curves)[0]
