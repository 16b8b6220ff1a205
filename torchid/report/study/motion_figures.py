"""A study's motions and torques: exciting trajectories with their noise, the motions of the
comparisons, and the torques of the identified coefficients and of the best sets."""

from functools import partial
from typing import Any

import torch

from torchid.log.model import Log
from torchid.report.colours import BLUE, BREAKS, GREEN, GREY, KEEPS, ORANGE, RED
from torchid.report.log import SIGNALS, trajectory_figure
from torchid.report.panels import Figure, Picture, drawing, finish, headroom, joint_rows, note, thin
from torchid.report.study import facts
from torchid.report.study.facts import at_joint, number, rms
from torchid.report.table import count, listed, torque_unit
from torchid.study.motions import new_motion
from torchid.study.result import Study

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
    plan = new_motion(study.robot, validation)
    caption = (
        f"The sinusoidal motion that validates the coefficients, {_sampling(plan)}; it takes no "
        "part in the fit. "
    )
    title = f"{name}: motion of the validation"
    out.append(
        _motion(
            study, "identification", "validation_motion", plan, title, caption,
            study.validation, validation.noise_db,
        )
    )  # fmt: skip
    comparisons: tuple[tuple[str, str, Log, str], ...] = (
        ("validation", "sets_motion", study.sets_motion.motion,
         "The motion on which the torques of the best sets are compared"),
        ("wrenches", "reference_motion", study.wrench_motion.motion,
         "The reference motion on which the internal wrenches are compared"),
    )  # fmt: skip
    for section, file, motion, what in comparisons:
        title = f"{name}: {file.replace('_', ' ')}"
        caption = f"{what}, {_sampling(motion)}. "
        out.append(_motion(study, section, file, motion, title, caption))
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
