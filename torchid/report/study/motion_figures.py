"""A study's motions: exciting trajectories with their noise, and those of the comparisons."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import torch

from torchid.log.model import Log
from torchid.log.sampling import sampling_rate
from torchid.report.excitation import trajectory_figure
from torchid.report.figures import INK, ORANGE, new_figure, styled
from torchid.report.study.drawing import Drawing, Section, finish, headroom, note, thin
from torchid.report.study.facts import (
    at_joint,
    listed,
    number,
    rms,
)
from torchid.robot.model import Robot
from torchid.study.motions import new_motion
from torchid.study.result import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_NOISY = (("position", "q", "rad"), ("velocity", "dq", "rad/s"), ("acceleration", "ddq", "rad/s²"))
"""Signals that the report's noise is added to, with units of turning joints."""


def motion_drawings(study: Study) -> list[Drawing]:
    """Every motion of the study (figures 5.1, 5.2, 5.5 and their like)."""
    return [
        *_exciting(study),
        *_noise_drawing(study),
        _validation_motion(study),
        _new("validation", "sets_motion", study, study.sets_motion.motion,
             "The motion on which the torques of the best sets are compared"),
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


def _noise_drawing(study: Study) -> list[Drawing]:
    """The noise alone: at the scale of the motion it is as wide as a line."""
    noise = study.settings.excitation.noise_db
    if noise is None:
        return []
    plan, log = study.excitation.trajectories()[0], study.log.trajectories()[0]
    largest = []
    for name, signal, unit in _NOISY:
        sizes = rms(getattr(log, signal) - getattr(plan, signal)).tolist()
        largest.append(f"{name} {at_joint(sizes, unit)}")
    return [
        Drawing(
            "identification",
            "excitation_noise",
            f"The noise of exciting trajectory 1 alone: the noisy minus the planned motion, with "
            f"its root mean square in each panel. Largest: {listed(largest)}.",
            lambda: _noise_figure(study.robot, plan, log),
        )
    ]


def _noise_figure(robot: Robot, plan: Log, log: Log) -> "Figure":
    figure = new_figure(11, 1.0 + 1.25 * robot.n)
    grid = figure.subplots(robot.n, 3, sharex=True, squeeze=False)
    t = thin(plan.t - plan.t[0])
    for c, (name, signal, unit) in enumerate(_NOISY):
        difference = getattr(log, signal) - getattr(plan, signal)
        grid[0, c].set_title(f"{name} [{unit}]", fontsize=9, color=INK)
        grid[-1, c].set_xlabel("time [s]", fontsize=8, color=INK)
        for j in range(robot.n):
            axes = styled(grid[j, c])
            axes.plot(t, thin(difference[:, j]), color=ORANGE, linewidth=0.6)
            headroom(axes)
            note(axes, number(float(rms(difference)[j]), 2))
    for j in range(robot.n):
        grid[j, 0].set_ylabel(f"joint {j + 1}", fontsize=8, color=INK)
    return finish(figure, f"{robot.name}: noise of exciting trajectory 1")


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
