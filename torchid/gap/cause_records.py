"""Causes as they are told: effects with their numbers on the arm, beside what the file has."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from types import MappingProxyType
from typing import Any

from torchid.design.columns import Model
from torchid.effects.base import Coefficient, Effect
from torchid.effects.names import PLACES
from torchid.effects.registry import Valued, effect_from_record, effect_kind
from torchid.json_data import plain
from torchid.results.cause import LINK, Cause
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import JointType, Robot
from torchid.statistics.criteria import SET_MASS

INERTIA_MEANING = "The link's mass, centre of mass or inertia differs from the model's."
INERTIA_REMEDY = (
    "Replace the link's inertial parameters, or all of them by those `torchid identify` finds."
)


def effect_cause(
    fitted: Valued,
    std: Sequence[float],
    given: Model,
    corrected: Model,
    main: int,
    shapes: Mapping[str, float] = MappingProxyType({}),
    **more: Any,
) -> Cause:
    """An effect as a cause.

    Args:
        fitted: effect, of one that joints share that of the first, and the coefficients that it has
            beside the model as given.
        std: standard deviations of the coefficients.
        given, corrected: the models before and after.
        main: number of the coefficient that makes most of its torque.
        shapes: standard deviations of the shapes that were fitted with them, by name.
        more: fields of the cause; its `joints` if it belongs to the whole arm.
    """
    effect, values = fitted
    file = _own(effect, given)
    if file is None:  # another shape of the same effect, whose place it takes
        left = [e for e, _ in corrected.effects]
        gone = (v for e, v in given.effects if e.identity == effect.identity and e not in left)
        file = next(gone, None)
    # What mends the file's bodies is no effect of the corrected model.
    arm = _own(effect, corrected) or values
    names = [c.name for c in effect.coefficients]
    signs = [c.non_negative for c in effect.coefficients]
    values = [max(0.0, x) if s else x for x, s in zip(arm, signs, strict=True)]
    numbers = {
        key: value
        for key, value in effect.record(values).items()
        if key not in ("effect", "joint", "joints") and key[0] != "_"
    }
    units = [(c.name, c.unit) for c in effect.coefficients]
    units += [(s.name, s.unit) for s in effect.shapes]
    joints = more.pop("joints", effect.joints)
    # A unit follows the joints that the effect is at.
    where = effect.joints or joints
    return Cause(
        effect=effect.name,
        family=effect.family,
        joints=joints,
        parameters=plain(numbers),
        file={} if file is None else dict(zip(names, file, strict=True)),
        std=plain(dict(zip(names, std, strict=True)) | dict(shapes)),
        unit={k: unit_of(u, where, given.robot) for k, u in units},
        shape=tuple(name for name in numbers if name in {s.name for s in effect.shapes}),
        places=tuple(name for name in numbers if name in PLACES),
        main=names[main],
        meaning=effect.meaning,
        source=effect.source,
        **{"remedy": effect.remedy, "located": effect.joints, **more},
    )


def body_cause(links: Sequence[int], remedy: str = "", **more: Any) -> Cause:
    """Other inertial parameters of links, or of all where there are none, as a cause."""
    return Cause(
        effect=LINK,
        family="inertia",
        joints=tuple(links),
        parameters={"links": [k + 1 for k in links]},
        meaning=INERTIA_MEANING,
        remedy=remedy or INERTIA_REMEDY,
        **more,
    )


def how_named(branch: str, sure: float, alone: float, of_branch: float) -> dict[str, Any]:
    """The one probability of a cause, and the branch where no more than that is sure: the deepest
    node of the tree of causes that is sure enough is the name.

    Args:
        branch: of its effect.
        sure: probability of it, or of its set.
        alone: of it.
        of_branch: that any cause of the branch is there.
    """
    wide = min(sure, alone) < SET_MASS <= of_branch
    return {"branch": branch if wide else "", "how_sure": of_branch if wide else sure}


def valued(cause: Cause, robot: Robot) -> Valued:
    """The effect that a cause is, with the arm's coefficients."""
    kind = effect_kind(cause.effect)
    own = {f.name for f in fields(kind)} | {c.name for c in kind.coefficients}
    # What all joints share may be felt by none of them as much as is worth a name.
    place = {"joint": (*cause.joints, 0)[0] + 1} if "joint" in own else {}
    values = {k: v for k, v in cause.parameters.items() if k in own}
    return effect_from_record({"effect": kind.name, **place, **values}, robot)


def unit_of(unit: str, joints: Iterable[int], robot: Robot) -> str:
    """A coefficient's unit on these joints: that of revolute ones unless all are prismatic."""
    kinds = {robot.joint_types[j] for j in joints}
    return Coefficient("", unit, False, "").unit_for(kinds == {JointType.PRISMATIC})


def _own(effect: Effect, model: Model) -> Sequence[float] | None:
    """Coefficients that a model has of an effect of this shape; None where it has none."""
    same = [
        v
        for e, v in model.effects
        if e.identity == effect.identity
        and (e == effect or (e.linearised and e.shape_values == effect.shape_values))
    ]
    return same[0] if same else None


def body_change(before: InertialParameters, after: InertialParameters) -> str:
    """What to set of a link: its mass, centre of mass and inertia, before and after; of numbers
    without a mass the first moment, and the inertia about the link's frame."""
    heavy = min(float(before.mass), float(after.mass)) > 0
    mass, centre, inertia = (
        " -> ".join(words)
        for words in zip(*(_body_words(body, heavy) for body in (before, after)), strict=True)
    )
    where, about = ("centre of mass", "it") if heavy else ("first moment", "the link's frame")
    return (
        f"Set the link's mass {mass} kg, its {where} {centre} {'m' if heavy else 'kg m'}, its "
        f"inertia about {about} (xx, yy, zz) {inertia} kg m²."
    )


def _body_words(body: InertialParameters, heavy: bool) -> tuple[str, str, str]:
    """Mass, centre of mass or first moment, and inertia about that or the link's frame."""
    centre = body.com if heavy else body.first_moment
    inertia = body.inertia_about_com if heavy else body.inertia_about_link_frame
    parts = (centre, inertia[[0, 3, 5]])
    centre_words, inertia_words = (f"({', '.join(f'{v:.3g}' for v in x.tolist())})" for x in parts)
    return f"{float(body.mass):.3g}", centre_words, inertia_words
