"""A diagnosis over time for a viewer: MCAP for Foxglove and PlotJuggler.

For every trajectory and joint, on the log's own time and in the band of the report:

    measured = predicted + sum of effects + residual

`predicted` is the torque of the model as given and `residual` what is left beside the corrected
one. The effects are all that the correction adds: each effect by its name, `parameters` for changed
inertial parameters, and `refit`, by how much the models that are judged here, fitted without this
stretch of the log, differ from the answered one.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from torchid.design.columns import SMOOTHED, Model
from torchid.effects.registry import EVENTS
from torchid.errors import MissingExtraError, TorchidError
from torchid.files import atomic_write
from torchid.gap.cause_records import valued
from torchid.gap.describe.where import regime_instants
from torchid.gap.diagnosis import TorqueDiagnosis, Trace
from torchid.log.filtering import low_passed
from torchid.position.diagnosis import PositionDiagnosis
from torchid.results.answer import Diagnosis
from torchid.robot.model import joint_unit
from torchid.typing import Bool, Float, Tensor


@dataclass(frozen=True, eq=False)
class JointView:
    """One joint along one trajectory, torques [N m; N]; of logs of positions, positions [rad; m].

    Attributes:
        trajectory, joint, unit: names, and the torque's unit.
        t: (T,) the log's time [s]; instants at the filter's ends are left out.
        q, dq: (T,) [rad, rad/s; m, m/s].
        measured, predicted, residual: (T,) of the arm, of the model as given, left by the corrected
            one.
        effects: (T,) what the correction adds, by name.
        regimes: (T,) where regimes are that hold more of the gap than their share of time.
    """

    trajectory: str
    joint: str
    unit: str
    t: Float[Tensor, " T"]
    q: Float[Tensor, " T"]
    dq: Float[Tensor, " T"]
    measured: Float[Tensor, " T"]
    predicted: Float[Tensor, " T"]
    residual: Float[Tensor, " T"]
    effects: Mapping[str, Float[Tensor, " T"]]
    regimes: Mapping[str, Bool[Tensor, " T"]]


def joint_views(diagnosis: Diagnosis) -> tuple[JointView, ...]:
    """Every trajectory's joints over time.

    Args:
        diagnosis: in memory; one read back has no torque over time.

    >>> import torch, torchid
    >>> robot = torchid.load_robot("3r")
    >>> motion = torchid.excite(robot, duration=8.0, restarts=1, iterations=0).log()
    >>> friction = {"effect": "viscous_friction", "joint": 2, "Fv": 0.5}
    >>> log = torchid.simulate(robot, motion, effects=[friction])
    >>> settings = torchid.GapSettings(effects=("viscous_friction",))
    >>> joint = joint_views(torchid.diagnose(robot, log, settings=settings))[1]
    >>> total = joint.predicted + sum(joint.effects.values()) + joint.residual
    >>> torch.allclose(total, joint.measured), "viscous_friction" in joint.effects
    (True, True)
    """
    if isinstance(diagnosis, PositionDiagnosis):
        return _positions(diagnosis)
    assert isinstance(diagnosis, TorqueDiagnosis)
    robot, out = diagnosis.robot, []
    spans = regime_instants(diagnosis.traces, diagnosis.band)
    for trace, places in zip(diagnosis.traces, spans, strict=True):
        effects = _effects(diagnosis, trace)
        kept = torch.zeros_like(trace.valid)
        # 10.0: instants kept a period of the band's edge: the signals have nothing faster
        kept[:: max(1, int(trace.rate / (10.0 * diagnosis.band)))] = True
        kept &= trace.valid
        motion = trace.motion
        since = torch.arange(len(kept), dtype=torch.float64) / trace.rate
        for j, name in enumerate(robot.joint_names):
            at = (kept, j)
            # 0.05: p below which a regime is shown
            clear = [r for r in diagnosis.regimes if r.joint == j and r.p < 0.05 and r.excess > 0]
            regimes = {str(r.regime): places[r.regime][at] for r in clear}
            out.append(
                JointView(
                    trajectory=trace.name,
                    joint=name,
                    unit=joint_unit(robot, j),
                    t=trace.stamp + since[kept],
                    q=motion.q[at],
                    dq=motion.dq[at],
                    measured=trace.measured[at],
                    predicted=trace.before[at],
                    residual=(trace.measured - trace.after)[at],
                    effects={k: x[at] for k, x in effects.items() if bool(x[:, j].any())},
                    regimes=regimes,
                )
            )
    return tuple(out)


def _positions(diagnosis: PositionDiagnosis) -> tuple[JointView, ...]:
    """Joints of a diagnosis of positions: predicted is a plain servo's motion, and what all causes
    add to it is one effect. Both were fitted without the motion that is shown."""
    data, out = diagnosis.data, []
    plain, answered = diagnosis.errors
    for k, rows in enumerate(data.log.slices()):
        q = data.log.q[rows]
        for j, name in enumerate(data.robot.joint_names):
            out.append(
                JointView(
                    trajectory=data.log.names[k],
                    joint=name,
                    unit="rad",
                    t=data.log.t[rows],
                    q=q[:, j],
                    dq=data.dq[rows, j] / data.scale[j],
                    measured=q[:, j],
                    predicted=q[:, j] + plain[rows, j],
                    residual=-answered[rows, j],
                    effects={"causes": (answered - plain)[rows, j]},
                    regimes={},
                )
            )
    return tuple(out)


def _effects(diagnosis: TorqueDiagnosis, trace: Trace) -> dict[str, Float[Tensor, "T n"]]:
    """What the correction adds to the model as given along a trajectory, by name."""
    motion, given = trace.motion, Model.of(diagnosis.robot)
    events = tuple(valued(c, diagnosis.robot) for c in diagnosis.which if c.effect in EVENTS)
    answered = Model.of(diagnosis.corrected)
    answered = Model(answered.robot, (*answered.effects, *events))
    added: dict[str, Tensor] = {}
    for model, sign in ((answered, 1.0), (given, -1.0)):
        sharp = motion._replace(torque=model.load(motion))
        # What effects see that differentiate it, as `Model.torque` has it.
        low = {k: low_passed(getattr(sharp, k).T, trace.rate, diagnosis.cutoff) for k in SMOOTHED}
        smooth = sharp._replace(**{k: x.T.contiguous() for k, x in low.items()})
        for effect, values in model.effects:
            seen = smooth if effect.smooth else sharp
            torque = sign * effect.all_torques(seen, values, model.arm_of(effect))
            added[effect.name] = added.get(effect.name, torch.zeros_like(torque)) + torque
    bodies, before = (Model(model.robot, ()).load(motion) for model in (answered, given))
    added["parameters"] = bodies - before
    added = {k: low_passed(x.T, trace.rate, diagnosis.band).T for k, x in added.items()}
    total = torch.stack(list(added.values())).sum(0)
    return {**added, "refit": trace.after - trace.before - total}


def write_view(diagnosis: Diagnosis, path: str | Path) -> None:
    """Write a diagnosis over time for a viewer.

    MCAP has one topic a trajectory and joint, /trajectory/joint, of JSON messages with a schema:
    numbers, the effects' torques under `effects`, regimes as true or false under `regimes`. Times
    are the log's; where one is below zero, all start from zero.

    Args:
        diagnosis: in memory; one read back has no torque over time.
        path: .mcap.

    Raises:
        TorchidError: another suffix, or the file cannot be written.
        MissingExtraError: without the package mcap (extra `view`).

    >>> import tempfile, torchid
    >>> robot = torchid.load_robot("3r")
    >>> motion = torchid.excite(robot, duration=8.0, restarts=1, iterations=0).log()
    >>> settings = torchid.GapSettings(effects=("viscous_friction",))
    >>> found = torchid.diagnose(robot, torchid.simulate(robot, motion), settings=settings)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_view(found, f"{folder}/gap.mcap")
    """
    path = Path(path)
    require_viewer(path)
    _write_mcap(joint_views(diagnosis), path)


def require_viewer(path: Path) -> None:
    """Whether such a file can be written.

    Raises:
        TorchidError: another suffix.
        MissingExtraError: what writes it is not installed.
    """
    if path.suffix.lower() != ".mcap":
        raise TorchidError(
            "a view is written for Foxglove and PlotJuggler.", got=path, expected="FILE.mcap"
        )
    try:
        import mcap.writer  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("mcap", "view", f"writing '{path}'") from error


def _topic(view: JointView) -> str:
    """Names that a viewer's paths take without quotes."""
    return "/".join(re.sub(r"\W+", "_", x).strip("_") for x in (view.trajectory, view.joint))


def _stream(view: JointView) -> dict[str, Tensor]:
    """All that a viewer shows of a joint over time, by the path below its topic."""
    names = ("measured", "predicted", "residual", "q", "dq")
    return {
        **{name: getattr(view, name) for name in names},
        **{f"effects/{k}": x for k, x in view.effects.items()},
        **{f"regimes/{k}": x for k, x in view.regimes.items()},
    }


def _nested(entries: Mapping[str, Any]) -> dict[str, Any]:
    """Entries by path, as the objects that hold them."""
    groups: dict[str, dict[str, Any]] = {"": {}, "effects": {}, "regimes": {}}
    for path, entry in entries.items():
        group, _, name = path.rpartition("/")
        groups[group][name] = entry
    return groups.pop("") | groups


def _schema(view: JointView) -> dict[str, Any]:
    """JSON schema of a joint's messages."""
    kinds: dict[str, Any] = {}
    for path, x in _stream(view).items():
        kinds[path] = {"type": "boolean" if x.dtype == torch.bool else "number"}
        if path not in ("q", "dq") and x.dtype != torch.bool:
            kinds[path]["description"] = view.unit
    fields = _nested(kinds)
    for group in ("effects", "regimes"):
        fields[group] = {"type": "object", "properties": fields[group]}
    return {"title": "torchid.gap.Joint", "type": "object", "properties": fields}


def _write_mcap(views: tuple[JointView, ...], path: Path) -> None:
    from mcap.writer import CompressionType, Writer

    start = min([0.0, *(float(v.t.min()) for v in views if len(v.t))])
    with atomic_write(path, "wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="", library="torchid")
        for view in views:
            schema = writer.register_schema(
                "torchid.gap.Joint", "jsonschema", json.dumps(_schema(view)).encode()
            )
            channel = writer.register_channel(f"/{_topic(view)}", "json", schema)
            columns = {name: x.tolist() for name, x in _stream(view).items()}
            for k, t in enumerate(view.t.tolist()):
                message = json.dumps(_nested({name: x[k] for name, x in columns.items()}))
                stamp = round(1e9 * (t - start))
                writer.add_message(channel, stamp, message.encode(), stamp, k)
        writer.finish()
