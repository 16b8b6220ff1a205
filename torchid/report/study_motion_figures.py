"""A study's motions and torques: exciting trajectories, validation, sets on a new motion."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import torch

from torchid.log.model import Log
from torchid.log.sampling import sampling_rate
from torchid.report.excitation import trajectory_figure
from torchid.report.figures import BLUE, GREEN, GREY, INK, ORANGE, RED, new_figure, styled
from torchid.report.study_drawing import Drawing, Section, finish, headroom, note, thin
from torchid.report.study_facts import (
    ROUNDING,
    at_joint,
    count,
    listed,
    number,
    rms,
    torque_errors,
    validation_torques,
)
from torchid.robot.model import Robot
from torchid.study.motions import new_motion
from torchid.study.result import Study
from torchid.typing import Tensor

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def motion_drawings(study: Study) -> list[Drawing]:
    """Every motion and every torque of the study (figures 5.1 to 5.5 and their like)."""
    return [
        *_exciting(study),
        _validation_motion(study),
        _validation_torque(study),
        _new("validation", "sets_motion", study, study.sets_motion.motion,
             "The motion on which the torques of the best sets are compared"),
        _sets_torque(study),
        _new("wrenches", "reference_motion", study, study.wrench_motion.motion,
             "The reference motion on which the internal wrenches are compared"),
    ]  # fmt: skip


def _exciting(study: Study) -> list[Drawing]:
    planned, logged = study.excitation.trajectories(), study.log.trajectories()
    noise = study.settings.excitation.noise_db
    total = len(planned)
    return [
        Drawing(
            "identification",
            f"excitation_{k}",
            f"Exciting trajectory {k} of {total}, {_sampling(plan)}, per joint. "
            + _use(study.robot, plan)
            + _noise(study.robot, plan, log, noise),
            _drawer(
                study.robot, plan, f"{study.robot.name}: exciting trajectory {k} of {total}",
                None if noise is None else log,
            ),
        )
        for k, (plan, log) in enumerate(zip(planned, logged, strict=True), start=1)
    ]  # fmt: skip


def _drawer(robot: Robot, plan: Log, title: str, noisy: Log | None) -> Callable[[], "Figure"]:
    return lambda: trajectory_figure(robot, plan, title, noisy)


def _validation_motion(study: Study) -> Drawing:
    settings = study.settings.validation
    plan = new_motion(study.robot, settings)
    return Drawing(
        "identification",
        "validation_motion",
        f"The sinusoidal motion that validates the coefficients, {_sampling(plan)}; it takes no "
        f"part in the fit. {_use(study.robot, plan)}"
        f"{_noise(study.robot, plan, study.validation, settings.noise_db)}",
        _drawer(
            study.robot, plan, f"{study.robot.name}: motion of the validation",
            None if settings.noise_db is None else study.validation,
        ),
    )  # fmt: skip


def _new(section: Section, name: str, study: Study, motion: Log, what: str) -> Drawing:
    title = f"{study.robot.name}: {name.replace('_', ' ')}"
    return Drawing(
        section,
        name,
        f"{what}, {_sampling(motion)}. {_use(study.robot, motion)}",
        _drawer(study.robot, motion, title, None),
    )


def _sampling(motion: Log) -> str:
    rate = sampling_rate(motion)[0]
    return f"{motion.duration[0]:.4g} s at {rate:.4g} Hz ({motion.samples} instants)"


def _use(robot: Robot, motion: Log) -> str:
    """How much of the limits a motion uses."""
    parts = []
    for name, signal in (("position", "q"), ("velocity", "dq"), ("acceleration", "ddq")):
        limits = getattr(robot.limits, name)
        values = getattr(motion, signal)
        if limits is None or values is None or not bool(torch.isfinite(limits).all()):
            continue
        middle, half = limits.mean(-1), (limits[:, 1] - limits[:, 0]) / 2
        share = ((values - middle).abs() / half).amax(0)
        joint = int(share.argmax())
        parts.append(f"{100 * float(share[joint]):.0f} % of the {name} limit (joint {joint + 1})")
    return f"It reaches at most {listed(parts)}; limits are red." if parts else ""


def _noise(robot: Robot, plan: Log, log: Log, noise_db: float | None) -> str:
    if noise_db is None:
        return ""
    beyond, shares = torch.zeros(log.samples, dtype=torch.bool), []
    for name, signal in (("position", "q"), ("velocity", "dq"), ("acceleration", "ddq")):
        limits, values, clean = (
            getattr(x, y) for x, y in ((robot.limits, name), (log, signal), (plan, signal))
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


def _validation_torque(study: Study) -> Drawing:
    identified, rebuilt, true = validation_torques(study)
    size = rms(true)
    error = rms(identified - true) / size
    worst, where = float(error.max()), int(error.argmax()) + 1
    verdict = (
        "that is rounding: the two overlap and the identification is exact"
        if worst < ROUNDING
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
    return Drawing(
        "identification", "validation_torque", caption,
        lambda: _torque_figure(study, identified, rebuilt, true),
    )  # fmt: skip


def _torque_figure(study: Study, identified: Tensor, rebuilt: Tensor, true: Tensor) -> "Figure":
    n = study.robot.n
    figure = new_figure(11, 1.2 + 1.35 * n)
    grid = figure.subplots(n, 2, sharex=True, squeeze=False, width_ratios=(3, 2))
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
    for j in range(n):
        left, right = styled(grid[j, 0]), styled(grid[j, 1])
        for values, name, colour, style, width in lines:
            left.plot(t, thin(values[:, j]), style, color=colour, linewidth=width, label=name)
        for values, name, colour in residuals:
            right.plot(t, thin(values[:, j]), color=colour, linewidth=0.7, label=name)
        left.set_ylabel(f"joint {j + 1}", fontsize=8, color=INK)
        right.yaxis.get_offset_text().set_fontsize(8)
        largest = float((identified - true)[:, j].abs().max())
        headroom(right)
        note(right, f"largest {number(largest, 2)}")
    for axes, name in zip(grid[0], ("torque [N m]", "residual [N m]"), strict=True):
        axes.set_title(name, fontsize=9, color=INK)
    for axes in grid[-1]:
        axes.set_xlabel("time [s]", fontsize=8, color=INK)
    handles = [*grid[0, 0].lines, *grid[0, 1].lines]
    figure.legend(
        handles, [str(x.get_label()) for x in handles], loc="outside lower center", ncols=5,
        frameon=False, fontsize=8,
    )  # fmt: skip
    return finish(figure, f"{study.robot.name}: torque on the motion of the validation")


def _sets_torque(study: Study) -> Drawing:
    error, real = torque_errors(study.sets_motion)
    share = error / real
    names = study.sets_motion.labels[1:]
    close = [k for k in range(len(names)) if float(share[k].max()) < ROUNDING]
    sentences = []
    if close:
        sentences.append(
            f"{listed(names[k] for k in close)} {'gives' if len(close) == 1 else 'give'} the real "
            f"torque to rounding (at most {number(float(share[close].max()))} of its root mean "
            "square): the torque cannot tell such a set from the real one."
        )
    sentences += [
        f"{names[k]} does not: its error is largest with {at_joint(error[k].tolist(), 'N m')}, and "
        f"relative to the joint's torque with {at_joint((100 * share[k]).tolist(), '%')}, whose "
        f"torque is {number(float(real[share[k].argmax()]))} N m."
        for k in range(len(names))
        if k not in close
    ]
    caption = (
        f"Torque of the {count(len(names), 'best set')} (columns, dashed) over that of the real "
        f"parameters (grey) per joint (rows) [N m], on a motion that took no part in anything "
        f"before; the number is the root mean square difference. {' '.join(sentences)}"
    )
    return Drawing("validation", "sets_torque", caption, lambda: _sets_figure(study, error))


def _sets_figure(study: Study, error: Tensor) -> "Figure":
    sets, n = study.sets_motion, study.robot.n
    k = len(sets.labels) - 1
    figure = new_figure(max(6.0, 1.0 + 2.05 * k), 1.2 + 1.2 * n)
    grid = figure.subplots(n, k, sharex=True, sharey="row", squeeze=False)
    t = thin(sets.motion.t)
    for s in range(k):
        colour = GREEN if study.scenarios[s].feasible else RED
        for j in range(n):
            axes = styled(grid[j, s])
            axes.plot(t, thin(sets.torque[0, :, j]), color=GREY, linewidth=3.0, label="real")
            axes.plot(t, thin(sets.torque[s + 1, :, j]), "--", color=colour, linewidth=1.1)
            note(axes, number(float(error[s, j]), 2))
            if s == k - 1:
                headroom(axes)
        grid[0, s].set_title(sets.labels[s + 1], fontsize=9, color=INK)
        grid[-1, s].set_xlabel("time [s]", fontsize=8, color=INK)
    for j in range(n):
        grid[j, 0].set_ylabel(f"joint {j + 1}", fontsize=8, color=INK)
    handles = {
        "real": grid[0, 0].plot([], [], color=GREY, linewidth=3.0)[0],
        "feasible set": grid[0, 0].plot([], [], "--", color=GREEN)[0],
        "infeasible set": grid[0, 0].plot([], [], "--", color=RED)[0],
    }
    figure.legend(
        list(handles.values()), list(handles), loc="outside lower center", ncols=3,
        frameon=False, fontsize=8,
    )  # fmt: skip
    return finish(figure, f"{study.robot.name}: torque [N m] of the best sets on a new motion")
