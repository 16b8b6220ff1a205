"""What is told of every effect besides its class: equation, signature, rivals.

`Y_i` are the columns of link i in the regressor (eq. 2.18), `tau(..)` is the model's torque,
`e_j` the unit vector of joint j. Every rivalry holds in both directions.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Entry:
    """How an effect is written, seen and mistaken.

    Attributes:
        equation: torque that it adds, in the names of its coefficients and shape parameters.
        signature: how it shows in the residual torque.
        rivals: effects that it is confused with, the most likely first.
    """

    equation: str
    signature: str
    rivals: tuple[str, ...]


ENTRIES: dict[str, Entry] = {
    "viscous_friction": Entry(
        "Fv dq",
        "odd in the joint's speed, and grows with it",
        ("power_law_friction", "time_delay", "thermal_friction_drift"),
    ),
    "power_law_friction": Entry(
        "F2 |dq|^a sgn(dq)",
        "a friction curve that bends at speed",
        ("viscous_friction", "stribeck_friction"),
    ),
    "gear_coupling": Entry(
        "on j: Iam ratio ddq_i + Fvm ratio dq_i + Fcm (sgn(w) - sgn(dq_j));  "
        "on i: Iam ratio ddq_j + Fvm ratio dq_j + Fcm ratio sgn(w);  w = dq_j + ratio dq_i",
        "friction of one joint that follows another joint's speed",
        ("torque_crosstalk",),
    ),
    "coulomb_friction": Entry(
        "Fc sgn(dq)",
        "a step where the joint reverses, of the same height everywhere",
        (
            "load_dependent_friction",
            "stribeck_friction",
            "presliding_hysteresis",
            "thermal_friction_drift",
        ),
    ),
    "stribeck_friction": Entry(
        "Fs exp(-|dq/vs|^d) sgn(dq)",
        "friction in excess at low speed, gone at a few vs",
        ("coulomb_friction", "presliding_hysteresis", "power_law_friction"),
    ),
    "load_dependent_friction": Entry(
        "mu |tau| sgn(dq)",
        "a step at reversals that is higher where the joint carries more",
        ("coulomb_friction", "torque_gain"),
    ),
    "torque_offset": Entry(
        "F0",
        "the same torque everywhere, at rest too",
        ("asymmetric_friction", "joint_spring"),
    ),
    "asymmetric_friction": Entry(
        "dF |sgn(dq)| + dFv |dq|",
        "an offset while the joint moves, none while it dwells",
        ("torque_offset", "base_tilt"),
    ),
    "joint_spring": Entry(
        "k sin(w q)/w + c0 cos(w q) with w^2 = curvature; sinh and cosh where it is negative, "
        "k q + c0 where it is 0",
        "torque over the joint's own position, whatever the others do",
        ("link_inertia", "torque_offset", "cogging"),
    ),
    "rotor_inertia": Entry(
        "Ia ddq",
        "follows the joint's own acceleration; for the first joints exactly as J_zz does",
        ("link_inertia", "time_delay"),
    ),
    "presliding_hysteresis": Entry(
        "Fh z with dz/dt = (dq - |dq| z)/length",
        "a loop over position after each reversal",
        ("stribeck_friction", "coulomb_friction", "backlash"),
    ),
    "cogging": Entry(
        "a_s sin(k q) + a_c cos(k q)",
        "a line in the residual's spectrum over the angle",
        ("joint_spring",),
    ),
    "thermal_friction_drift": Entry(
        "(dFv dq + dFc sgn(dq)) (1 - exp(-t/T))",
        "a slow trend with the shape of friction",
        ("viscous_friction", "coulomb_friction"),
    ),
    "base_tilt": Entry(
        "tau(q; turned gravity) - tau(q; gravity) at rest, turned by tilt_x and tilt_y, linearised",
        "gravity-shaped on all joints at once, from one vector",
        ("encoder_offset", "kinematic_error", "asymmetric_friction"),
    ),
    "torque_gain": Entry(
        "gain tau_j",
        "grows with the joint's own torque; a gain that all joints share is invisible without a "
        "known payload",
        ("link_inertia", "load_dependent_friction", "saturation"),
    ),
    "torque_crosstalk": Entry(
        "C tau_i with i the source_joint",
        "follows another joint's torque",
        ("gear_coupling",),
    ),
    "encoder_offset": Entry(
        "tau(q + offset e_j, dq, ddq) - tau(q, dq, ddq)",
        "gravity-shaped and on several joints; unobservable on a vertical first joint",
        ("base_tilt", "joint_elasticity"),
    ),
    "kinematic_error": Entry(
        "the change of tau(q, dq, ddq) with joint j's frame moved by dx, dy, dz and turned by rx, "
        "ry, linearised",
        "follows the posture, on the joint and those before it",
        ("base_tilt", "link_inertia"),
    ),
    "payload": Entry(
        "Y_n (m, mx, my, mz, Jxx, Jxy, Jxz, Jyy, Jyz, Jzz)",
        "on all joints that carry the tool; exactly an error of the last link",
        ("link_inertia", "contact"),
    ),
    "link_inertia": Entry(
        "Y_j (m, mx, my, mz, Jxx, Jxy, Jxz, Jyy, Jyz, Jzz)",
        "on the link's joint and those before it, with gravity and with acceleration",
        ("payload", "torque_gain", "rotor_inertia", "joint_spring", "kinematic_error"),
    ),
    "time_delay": Entry(
        "tau_j(t - delay) - tau_j(t)",
        "a phase that grows with frequency",
        ("filter_lag", "viscous_friction", "rotor_inertia", "joint_elasticity", "dropped_samples"),
    ),
    "filter_lag": Entry(
        "tau(q, dq(t + lag), ddq(t + lag)) - tau(q, dq, ddq)",
        "a phase of velocity and acceleration alone, on all joints; moves with the cut-off",
        ("time_delay",),
    ),
    "joint_elasticity": Entry(
        "tau(q - compliance tau_j e_j, ..) - tau(q, ..), likewise dq and ddq with the derivatives "
        "of tau_j",
        "gravity-shaped like an offset that follows the load, and strong at high frequency",
        ("backlash", "encoder_offset", "time_delay"),
    ),
    "backlash": Entry(
        "tau(q - width/2 s e_j, ..) - tau(q, ..), s = 1 or -1 the flank in contact",
        "pulses where the joint's torque, not its speed, changes sign",
        ("presliding_hysteresis", "joint_elasticity"),
    ),
    "saturation": Entry(
        "-clip max(|tau| - limit, 0) sgn(tau)",
        "peaks of the torque are missing",
        ("torque_gain",),
    ),
    "contact": Entry(
        "J(q)' (fx, fy, fz) between start and stop",
        "on all joints at once, in a window of time, in proportion to the tool's lever arms",
        ("payload",),
    ),
    "dropped_samples": Entry(
        "hold (tau_j(t - age) - tau_j(t))",
        "short windows in which the torque stands still",
        ("time_delay",),
    ),
}
