"""What settles a question that no motion of the bare arm does."""

from collections.abc import Iterable

from torchid.effects.experiments import APART

_LOAD = "weigh the load, or compare the link's parameters with CAD"
_ZERO = "measure the pose with an external instrument (tracker, gauge, level): calibration"
_FITTED = "take it from the maker's data, or trust the inertial parameters and diagnose again"

_REPEATED = ("torque_gain", "thermal_friction_drift", "saturation", "contact", "dropped_samples")
"""What shows these is no other motion, but the same one under other conditions."""

BEYOND = {
    "payload": _LOAD,
    "link_inertia": _LOAD,
    "all_base": _LOAD,
    "encoder_offset": _ZERO,
    "kinematic_error": _ZERO,
    "base_tilt": _ZERO,
    "torque_crosstalk": "load one joint alone with a known weight",
    "joint_elasticity": "measure on the link's side, or excite the joint with a chirp",
    "time_delay": "stamp both signals with one clock",
    "filter_lag": "record the unfiltered signals",
} | {name: APART[name] for name in _REPEATED}


def beyond(names: Iterable[str]) -> str:
    """What else would tell these effects, in one sentence."""
    asked = dict.fromkeys(names)
    advice: dict[str, list[str]] = {}
    for name in asked:
        advice.setdefault(BEYOND.get(name, _FITTED), []).append(name)
    return "; ".join(f"{', '.join(own)}: {text}" for text, own in advice.items())
