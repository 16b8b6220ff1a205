"""The friction laws of a diagnosis for people: a table, and a figure of small multiples."""

from functools import partial
from typing import Any

import numpy as np
from msgspec import UNSET

from torchid.errors import TorchidError
from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.gap.record import GapRecord
from torchid.report.colours import AFTER, BEFORE, GREY
from torchid.report.panels import Figure, Picture, finish, tiles
from torchid.report.table import Table, table_of
from torchid.results.friction import FrictionLaw

COLUMNS, NARROW_COLUMNS = 3, 1
"""Panels in a row, for a desk and a phone."""
MOST_SAMPLES = 800
"""That are drawn of a joint."""


def friction_table(record: GapRecord) -> Table:
    """The law of each joint: torque at three speeds, forwards and backwards."""
    note = (
        "The whole friction of a joint, of the model and found, where the motion is slow, middle "
        "and fast; details without a probability are the model's. What depends on more than the "
        "speed counts with its mean along the log."
    )
    columns = "joint how_sure torques details share"
    return table_of("friction laws", record.friction, columns, note)


def friction_picture(d: TorqueDiagnosis) -> Picture | None:
    """The figure of all joints with friction, where there is one."""
    if not d.friction or not d.traces:
        return None
    laws = "; ".join(f"joint {law.joint + 1}: {law.words()}" for law in d.friction)
    return Picture(
        "friction",
        "Friction of each joint over its speed. Points are the torque that the model as given "
        "lacks with its own friction taken out; the line is the friction law of the corrected "
        "model with its 95 % interval, dashed that of the model as given. Points far from the line "
        "have other causes.",
        f"Friction over speed. {laws}.",
        partial(friction_figure, d),
        narrow=partial(friction_figure, d, narrow=True),
    )


def friction_figure(d: TorqueDiagnosis, joint: int | None = None, narrow: bool = False) -> Figure:
    """Points of the gap without the model's friction, the law and its band, a panel a joint.

    Args:
        d: with traces.
        joint: from 0; all if None.
        narrow: for a phone.

    Raises:
        TorchidError: a joint without friction.
    """
    laws = [law for law in d.friction if joint is None or law.joint == joint]
    if not laws:
        raise TorchidError(
            "this joint has no friction law.", got=None if joint is None else joint + 1,
            available=[law.joint + 1 for law in d.friction],
        )  # fmt: skip
    columns = NARROW_COLUMNS if narrow else min(COLUMNS, max(len(laws), 2))
    figure, panels = tiles(
        [f"joint {law.joint + 1}" for law in laws], columns, 3.9 if narrow else 11.0, (2.3, 0.9),
        f"speed [{' or '.join(dict.fromkeys(law.speed_unit for law in laws))}]",
        f"friction [{' or '.join(dict.fromkeys(law.unit for law in laws))}]", "left",
    )  # fmt: skip
    for axes, law in zip(panels, laws, strict=True):
        _draw(axes, d, law)
        axes.locator_params(axis="x", nbins=5)
    title = "Friction over speed" if narrow else f"{d.robot.name}: friction over speed, by joint"
    return finish(figure, title, *panels, columns=1 if narrow else 3)


def _draw(axes: Any, d: TorqueDiagnosis, law: FrictionLaw) -> None:
    """One joint."""
    assert law.curve is not UNSET
    curve = law.curve
    speed, torque, half, given = map(
        np.asarray, (curve.speed, curve.torque, curve.half, curve.given)
    )
    seen, lacks = [], []
    for trace in d.traces:
        here = trace.counting[:, law.joint]
        seen.append(trace.motion.dq[here, law.joint].cpu().numpy())
        lacks.append((trace.measured - trace.before)[here, law.joint].cpu().numpy())
    x = np.concatenate(seen)
    y = np.concatenate(lacks) + _at(x, speed, given)
    some = slice(None, None, max(1, len(x) // MOST_SAMPLES))
    axes.scatter(
        x[some],
        y[some],
        s=5,
        color=BEFORE,
        alpha=0.3,
        linewidths=0,
        rasterized=True,
        label="measured - model as given without friction",
    )
    axes.axhline(0, color=GREY, linewidth=0.8)
    for way in (speed < 0, speed > 0):
        axes.fill_between(
            speed[way],
            (torque - half)[way],
            (torque + half)[way],
            color=AFTER,
            alpha=0.3,
            linewidth=0,
        )
        axes.plot(speed[way], torque[way], color=AFTER, linewidth=1.8, label="law, 95 % interval")
        if given.any():
            axes.plot(
                speed[way],
                given[way],
                color=GREY,
                linewidth=1.2,
                linestyle=(0, (4, 2)),
                label="model as given",
            )
    # The outermost points leave the picture, the law does not.
    reach = max(np.quantile(np.abs(y), 0.99) if len(y) else 0.0, np.abs(torque).max()) * 1.15
    axes.set_ylim(-reach, reach)


def _at(x: np.ndarray, speed: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """A curve at speeds, each direction by itself; what lies beyond it has its end's torque."""
    out = np.zeros_like(x)
    for way in (-1.0, 1.0):
        on, here = speed * way > 0, x * way > 0
        if on.any():
            out[here] = np.interp(x[here], speed[on], torque[on])
    return out
