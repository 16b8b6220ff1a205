"""What to do on the arm to tell two effects apart."""

APART = {
    "viscous_friction": "run one joint at three or more constant speeds",
    "power_law_friction": "run the joint at speeds from slow to its limit",
    "gear_coupling": "move the joint alone, then its neighbour alone",
    "coulomb_friction": "reverse slowly and fast, in postures with different loads",
    "stribeck_friction": "run from a fifth of the Stribeck speed to five times it",
    "load_dependent_friction": "repeat the same motion with two payloads, or in two postures",
    "torque_offset": "let the joint dwell, and approach the dwell from both sides",
    "asymmetric_friction": "run the mirrored motion, and let the joint dwell",
    "base_tilt": "repeat the motion with joint 1 turned by 90 degrees",
    "torque_gain": "repeat the motion with a known payload",
    "torque_crosstalk": "move one joint at a time",
    "encoder_offset": "move all joints through postures with different gravity loads",
    "kinematic_error": "cover many postures, also stretched out and folded",
    "joint_spring": "cover the joint's full range, also with the arm's gravity load reversed",
    "rotor_inertia": "accelerate the joint hard in postures with a large and a small link inertia",
    "payload": "repeat the motion with and without a known payload",
    "link_inertia": "compare the link's parameters with CAD, or weigh it",
    "time_delay": "repeat the motion at half the speed",
    "filter_lag": "repeat the diagnosis at two cut-offs, and the motion at two speeds",
    "joint_elasticity": "excite the joint with a chirp, or measure on the link's side",
    "backlash": "bias the joint with a gravity load so that its torque does not change sign",
    "presliding_hysteresis": "make many small reversals, smaller than the bristle's length",
    "cogging": "run the joint at two constant slow speeds",
    "thermal_friction_drift": "repeat one motion cold, warm and cold again",
    "saturation": "repeat the motion at half the torque",
    "contact": "repeat the motion away from obstacles",
    "dropped_samples": "repeat the motion and compare the two logs",
}
"""The experiment in which an effect shows itself (after the literature's usual advice)."""


def experiment(one: str, two: str) -> str:
    """Both experiments in one sentence: each effect shows itself in its own."""
    told = dict.fromkeys(APART[name] for name in (one, two) if name in APART)
    both = "; and ".join(told)
    return both[:1].upper() + both[1:] + "."
