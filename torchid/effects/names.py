"""The names of all effects, for those who check one without loading torch."""

from collections.abc import Iterable

from torchid.errors import TorchidError

NAMES = (
    "viscous_friction", "power_law_friction", "coulomb_friction", "stribeck_friction",
    "load_dependent_friction", "load_dependent_stribeck", "bearing_moment_friction",
    "axial_load_friction", "torque_offset", "asymmetric_friction", "joint_spring",
    "rotor_inertia", "presliding_hysteresis", "load_hysteresis", "cogging", "motor_ripple",
    "position_dependent_friction", "thermal_friction_drift", "gear_coupling", "base_tilt",
    "torque_gain", "torque_crosstalk", "encoder_offset", "kinematic_error", "payload",
    "link_inertia", "inertia_reference_point", "inertia_scale", "mirrored_link", "time_delay",
    "filter_lag", "joint_elasticity", "backlash", "saturation", "drive_saturation", "end_stop",
    "plane_contact", "contact", "dropped_samples",
)  # fmt: skip
"""In the order of the registry."""
EXCITED_EFFECTS = ("viscous_friction", "coulomb_friction", "torque_offset")
"""That a motion is designed for unless others are asked for: friction of the paper's model."""
DEFAULT_EFFECTS = (*EXCITED_EFFECTS, "rotor_inertia")
"""That are fitted beside base parameters unless others are asked for."""
PLACES = ("joint", "source_joint")
"""Fields of effects that are joints: from 0 in Python, from 1 in files."""


def require_effects(names: Iterable[str], known: Iterable[str] = NAMES) -> None:
    """Raise a TorchidError, which lists those that exist, where one of the names is no effect's."""
    for name in names:
        if name not in known:
            raise TorchidError(f"unknown effect '{name}'.", available=list(known))
