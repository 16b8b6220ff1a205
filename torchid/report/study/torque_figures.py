"""A study's torques: of the identified coefficients, and of the best sets on a new motion."""

from typing import TYPE_CHECKING

from torchid.report.figures import BLUE, GREEN, GREY, INK, ORANGE, RED, new_figure, styled
from torchid.report.study.drawing import Drawing, finish, headroom, note, thin
from torchid.report.study.facts import (
    ROUNDING,
    at_joint,
    count,
    listed,
    number,
    rms,
    torque_errors,
    torque_unit,
    validation_torques,
)
from torchid.study.result import Study
from torchid.typing import Tensor

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def torque_drawings(study: Study) -> list[Drawing]:
    """Torques of the validation and of the best sets (figures 5.3, 5.4 and their like)."""
    return [_validation_torque(study), _sets_torque(study)]


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
    unit = torque_unit(study)
    for axes, name in zip(grid[0], (f"torque [{unit}]", f"residual [{unit}]"), strict=True):
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
    share, unit = error / real, torque_unit(study)
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
    return finish(
        figure,
        f"{study.robot.name}: torque [{torque_unit(study)}] of the best sets on a new motion",
    )
