"""What settles a question that no motion of the bare arm does."""

from collections.abc import Iterable

_LOAD = "weigh the load, or compare the link's parameters with CAD"
_ZERO = "measure the pose with an external instrument (tracker, gauge, level): calibration"
_FITTED = "take it from the maker's data, or trust the inertial parameters and diagnose again"

BEYOND = {
    "payload": _LOAD,
    "link_inertia": _LOAD,
    "all_base": _LOAD,
    "encoder_offset": _ZERO,
    "kinematic_error": _ZERO,
    "base_tilt": _ZERO,
    "torque_gain": "repeat the motion with a known payload",
    "torque_crosstalk": "load one joint alone with a known weight",
    "joint_elasticity": "measure on the link's side, or excite the joint with a chirp",
    "time_delay": "stamp both signals with one clock",
    "filter_lag": "record the unfiltered signals",
    "thermal_friction_drift": "repeat one motion cold, warm and cold again",
    "saturation": "repeat the motion at half the torque",
    "contact": "repeat the motion away from obstacles",
    "dropped_samples": "repeat the motion and compare the two logs",
}


def beyond(names: Iterable[str]) -> str:
    """What else would tell these effects, in one sentence."""
    asked = dict.fromkeys(names)
    advice: dict[str, list[str]] = {}
    for name in asked:
        advice.setdefault(BEYOND.get(name, _FITTED), []).append(name)
    return "; ".join(f"{', '.join(own)}: {text}" for text, own in advice.items())
