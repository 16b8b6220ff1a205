"""Figures of sets with equal torque. matplotlib is imported when a figure is drawn."""

import numpy as np
import torch

from torchid.report.colours import BLUE, BROWN, GREEN, GREY, INK, ORANGE, PURPLE, RED
from torchid.report.panels import Figure, finish, joint_lines, panel, tiles
from torchid.report.wrenches.tables import kind_words
from torchid.robot.inertia import InertialParameters
from torchid.study.equal_torque.study import EqualTorqueStudy
from torchid.wrenches.regressor import wrench_norms

COLOURS = {
    "feasible": GREEN,
    "inertia": BLUE,
    "com": ORANGE,
    "mass": RED,
    "total_mass": BROWN,
    "inertia+com": PURPLE,
}
_LINEAR = 1e-3
"""Degrees smaller than this are drawn on a linear scale."""


def figures(study: EqualTorqueStudy) -> dict[str, Figure]:
    """All figures by the names of their files."""
    return {
        "force_by_degree": degree_figure(study),
        "force_by_kind": kind_figure(study),
        "force_by_mass": mass_figure(study),
        "force_over_time": time_figure(study),
    }


def degree_figure(study: EqualTorqueStudy) -> Figure:
    """Force error against the degree, coloured by kind; what any feasible set can reach."""
    figure, axes = panel(10.5, 5.4)
    degree, worst = study.degree.numpy(), study.worst.numpy()
    for kind in study.kinds:
        rows = study.rows(kind)
        axes.scatter(
            degree[rows], worst[rows], s=11, color=_colour(kind), alpha=0.55, linewidths=0,
            label=f"{kind_words(kind)} ({len(rows)})",
        )  # fmt: skip
        # Running median of six groups of neighbours.
        order = np.argsort(degree[rows])
        groups = [g for g in np.array_split(order, 6) if len(g) >= 5]
        x, y = ([float(np.median(v[rows][g])) for g in groups] for v in (degree, worst))
        axes.plot(x, y, color="white", linewidth=3.6)
        axes.plot(x, y, color=_colour(kind), linewidth=2.0)
    axes.set_xscale("symlog", linthresh=_LINEAR, linscale=0.6)
    axes.set(yscale="log", ylabel=_ERROR)
    axes.set_xlabel("degree (smallest margin over its scale; 0 is the boundary)")
    axes.axvline(0, color=INK, linewidth=0.9)
    for text, side in ((" feasible", "left"), ("infeasible ", "right")):
        axes.text(
            0.0, 1.04, text, transform=axes.get_xaxis_transform(), ha=side, va="top",
            fontsize=8, color=INK,
        )  # fmt: skip
    greatest = [float(r.reached.max()) for r in study.reach if r.kind == "feasible"]
    for value in greatest:
        axes.axhline(value, color=GREEN, linewidth=1.0, linestyle=(0, (5, 3)))
        axes.annotate(
            f"greatest of any feasible set: {value:.3g} N", (0.995, value),
            xycoords=axes.get_yaxis_transform(), xytext=(0, 3), textcoords="offset points",
            fontsize=8, color=GREEN, va="bottom", ha="right",
        )  # fmt: skip
    what = "the degree of a violation and the error of the internal forces"
    return finish(figure, f"{study.setting.robot.name}: {what}", axes)


def kind_figure(study: EqualTorqueStudy) -> Figure:
    """Boxes of the force error per joint and kind, with the greatest of any set and the force."""
    n, kinds = study.setting.robot.n, study.kinds
    columns = min(n, 4)
    joints = [f"joint {j + 1}" for j in range(n)]
    figure, grid = tiles(
        joints, columns, 2.6 * columns + 1.0, (3.0, 0.9), y="force error [N], RMS", sharey=True
    )
    reach = {r.kind: r.reached.tolist() for r in study.reach}
    own = study.errors.reference_force_rms.tolist()
    floor = 1e-2 * float(study.worst.median())
    for j, axes in enumerate(grid):
        for place, kind in enumerate(kinds):
            values = study.errors.force_rms[study.rows(kind), j].clamp(min=floor).numpy()
            colour = _colour(kind)
            axes.boxplot(
                values, positions=[place], widths=0.62, whis=(5, 95), showfliers=False,
                patch_artist=True, manage_ticks=False,
                boxprops={"facecolor": colour, "alpha": 0.45, "edgecolor": colour},
                medianprops={"color": INK, "linewidth": 1.4},
                whiskerprops={"color": colour}, capprops={"color": colour},
            )  # fmt: skip
            if kind in reach:
                axes.plot(place, max(reach[kind][j], floor), marker="_", color=INK, markersize=13)
        axes.axhline(max(own[j], floor), color=GREY, linewidth=1.2, linestyle=(0, (4, 2)))
        axes.set_yscale("log")
        shown = [kind_words(k) for k in kinds]
        axes.set_xticks(range(len(kinds)), shown, rotation=40, ha="right", fontsize=7)
    keys = {
        "the force itself (RMS)": {"color": GREY, "linewidth": 1.2, "linestyle": (0, (4, 2))},
        "greatest of any set of the kind": {
            "color": INK, "linewidth": 0, "marker": "_", "markersize": 12,
        },
    }  # fmt: skip
    title = f"{study.setting.robot.name}: force error per joint and kind of violation"
    return finish(figure, title, columns=2, keys=keys)


def mass_figure(study: EqualTorqueStudy) -> Figure:
    """Force error against the weight of the carried mass's error: what it comes from."""
    figure, axes = panel(6.2, 5.2)
    weight = study.carried.abs().amax(-1) * study.setting.robot.gravity.norm()
    for kind in study.kinds:
        rows = study.rows(kind)
        axes.scatter(
            weight[rows].numpy(), study.worst[rows].numpy(), s=12, color=_colour(kind), alpha=0.6,
            linewidths=0, label=kind_words(kind),
        )  # fmt: skip
    ends = [float(study.worst.min()), float(study.worst.max())]
    axes.plot(ends, ends, color=INK, linewidth=0.9)
    axes.set(xscale="log", yscale="log", ylabel=_ERROR)
    axes.set_xlabel("weight of the carried mass's error, largest joint [N]")
    title = f"{study.setting.robot.name}: the error is the weight of wrongly placed mass"
    return finish(figure, title, axes)


def time_figure(study: EqualTorqueStudy) -> Figure:
    """Norms of the internal forces over time: the reference and each kind's median set."""
    chosen = []
    for kind in study.kinds:
        rows = study.rows(kind)
        chosen.append(rows[int(study.worst[rows].argsort()[len(rows) // 2])])
    pi = torch.cat([study.setting.reference.parameters.pi, study.family.sets.parameters.pi[chosen]])
    motion = study.motion.state
    force, _ = wrench_norms(study.setting.robot, *motion, InertialParameters(pi))
    curves = {}
    for kind, norms in zip(study.kinds, force[1:], strict=True):
        style = {"color": _colour(kind), "linewidth": 1.1}
        curves[f"{kind_words(kind)}, median set"] = (norms.numpy(), style)
    curves["reference"] = (force[0].numpy(), {"color": INK, "linewidth": 1.8})
    t = np.arange(force.shape[1]) / (study.rate or 1.0)
    title = f"{study.setting.robot.name}: norms of the internal forces, all with the same torque"
    x = "sample" if study.rate is None else "time [s]"
    return joint_lines(title, "force norm [N]", t, curves, x)[0]


_ERROR = "force error, largest joint [N], RMS over the motion"


def _colour(kind: str) -> str:
    return COLOURS.get(kind, GREY)
