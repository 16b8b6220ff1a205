"""A study's payload: what was estimated against the truth, and what it does inside the arm."""

import math
from typing import TYPE_CHECKING

from torchid.report.figures import BLUE, GREEN, GREY, INK, ORANGE, RED, new_figure, styled
from torchid.report.study.drawing import Drawing, finish, joint_panels, panel_size, thin
from torchid.report.study.facts import at_joint, count, listed, number, rms
from torchid.report.study.wrench_tables import PAYLOAD_QUANTITIES, payload_numbers
from torchid.study.result import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def payload_drawings(study: Study) -> list[Drawing]:
    """Estimate against truth, and internal forces without and with the payload."""
    return [
        Drawing("payload", "payload_estimate", _estimate_caption(study), lambda: _estimate(study)),
        Drawing("payload", "payload_force", _force_caption(study), lambda: _force(study)),
    ]


def _estimate_caption(study: Study) -> str:
    truth, value, low, high = payload_numbers(study)
    rows = list(zip(PAYLOAD_QUANTITIES, truth, value, low, high, strict=True))
    known = [row for row in rows if math.isfinite(row[3]) and math.isfinite(row[4])]
    missed = [name for (name, _), t, _, a, b in known if not a <= t <= b]
    unknown = [name for (name, _), _, v, _, _ in rows if not math.isfinite(v)]
    text = (
        "The payload estimated from two runs of the exciting motion with the noise of real "
        "sensors (encoder steps, noisy torque), without and with it: error of each quantity in "
        "half-widths of its 95 % interval, so that the true value is inside the green band where "
        f"the interval holds it. It does for {len(known) - len(missed)} of "
        f"{count(len(known), 'quantity', 'quantities')}"
    )
    text += f" (not {listed(missed)})." if missed else "."
    if unknown:
        text += f" Not determined: {listed(unknown)}."
    return text


def _estimate(study: Study) -> "Figure":
    truth, value, low, high = payload_numbers(study)
    figure = new_figure(9, 4.2)
    axes = styled(figure.subplots())
    axes.axvspan(-1, 1, color=GREEN, alpha=0.12, linewidth=0)
    axes.axvline(0, color=GREY, linewidth=0.8)
    labels, largest = [], 2.0
    for k, (name, unit) in enumerate(PAYLOAD_QUANTITIES):
        half = (high[k] - low[k]) / 2
        error = (value[k] - truth[k]) / half if half > 0 else math.nan
        if math.isfinite(error):
            axes.errorbar(error, k, xerr=1, fmt="o", markersize=4, capsize=3, linewidth=1,
                          color=BLUE if abs(error) <= 1 else RED)  # fmt: skip
            largest = max(largest, 1.15 * abs(error) + 1)
            shown = f"{number(value[k], 4)} ± {number(half, 2)}"
        else:
            shown = "not known"
        labels.append(f"{name} [{unit}]\n{shown}, true {number(truth[k], 4)}")
    axes.set_yticks(range(len(labels)), labels, fontsize=6.5)
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.set_xlim(-largest, largest)
    axes.set_xlabel("(estimated - true) / half-width of the 95 % interval", fontsize=8, color=INK)
    return finish(figure, f"{study.robot.name}: payload, estimated against true")


def _force_caption(study: Study) -> str:
    force = study.payload.force
    before, after = rms(force[0]), rms(force[1])
    rise = ((after - before) / before).tolist()
    joint = max(range(len(rise)), key=lambda j: abs(rise[j]))
    wrong = rms(force[2] - force[1])
    return (
        "Norms of the internal forces on the reference motion without the payload, with the true "
        f"one of {number(study.settings.payload.mass)} kg, and with the estimated one. The payload "
        f"changes the force most at joint {joint + 1}, from a root mean square of "
        f"{number(float(before[joint]))} to {number(float(after[joint]))} N; with the estimated "
        f"one the force is wrong by at most {at_joint(wrong.tolist(), 'N')}."
    )


def _force(study: Study) -> "Figure":
    force, n = study.payload.force, study.robot.n
    figure = new_figure(*panel_size(n))
    panels = joint_panels(figure, n, "force norm [N]")
    motion = study.wrench_motion.motion
    t = thin(motion.t - motion.t[0])
    lines = (
        ("without payload", GREY, "-", 1.2),
        ("with the true payload", INK, "-", 2.4),
        ("with the estimated payload", ORANGE, "--", 1.3),
    )
    for j, axes in enumerate(panels):
        for values, (label, colour, style, width) in zip(force, lines, strict=True):
            axes.plot(t, thin(values[:, j]), style, color=colour, linewidth=width, label=label)
    return finish(figure, f"{study.robot.name}: internal forces with a payload", panels[0], 3)
