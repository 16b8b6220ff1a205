"""Diagnoses by hand, as their JSON has them."""

from typing import Any

from torchid.results.record import robot_record
from torchid.robot.model import Robot


def found(effect: str, *joints: int, **changes: Any) -> dict[str, Any]:
    """An accepted effect on joints, which count from 1."""
    return {
        "effect": effect, "family": "sign", "joints": list(joints), "common": False,
        "ambiguous_with": [], "parameters": {}, "p_value": None, "std": {}, "unit": {},
        "shape": [], "places": [], "share": 0.5, **changes,
    }  # fmt: skip


def hidden(effect: str, joint: int | None, smallest: float | None = None) -> dict[str, Any]:
    """An effect that could not be tested."""
    return {
        "effect": effect, "joint": joint, "joints": [] if joint is None else [joint],
        "smallest_detectable": smallest, "unit": "N m", "reason": "by hand",
    }  # fmt: skip


def gap(robot: Robot, **changes: Any) -> dict[str, Any]:
    """A diagnosis that found nothing, with changes."""
    n = robot.n
    return {
        "schema": "torchid.gap/1", "robot": robot.name, "status": "explained",
        "where": {"joints": [], "regimes": []}, "which": [],
        "how_far": {
            "rms_before": 1.0, "rms_after": 0.1, "noise_floor_rms": [0.1, 0.2], "closed": 0.9,
            "closed_ci95": [0.8, 1.0], "per_joint": [], "rollout": None,
        },
        "budget": {"parametric": 0.0, "structural": 0.9, "unexplained": 0.1},
        "not_testable": [], "next_experiment": None,
        "noise_floor": {"low": [0.1] * n, "high": [0.4] * n, "source": "repeats", "notes": []},
        "band_hz": 20.0, "cutoff_hz": 8.0,
        "settings": {"background": [], "parameters": "auto", "refitted": False},
        "model": robot_record(robot), "corrected": robot_record(robot), **changes,
    }  # fmt: skip


STRIBECK = found(
    "stribeck_friction", 2, parameters={"Fs": 0.5, "vs": 0.1, "d": 2.0},
    ambiguous_with=["coulomb_friction", "link_inertia", "contact"],
)  # fmt: skip


def open_gap(robot: Robot, **changes: Any) -> dict[str, Any]:
    """A diagnosis that cannot tell two laws of friction apart, with changes."""
    return gap(robot, **{"which": [STRIBECK], **changes})
