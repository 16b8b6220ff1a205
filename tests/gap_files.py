"""Diagnoses by hand, as their JSON has them."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torchid.results.record import robot_record
from torchid.robot.library import load_robot
from torchid.robot.model import Robot


def found(effect: str, *joints: int, **changes: Any) -> dict[str, Any]:
    """An accepted effect on joints, which count from 1."""
    return {
        "effect": effect, "family": "sign", "joints": list(joints), "common": False,
        "ambiguous_with": [], "parameters": {}, "file": {}, "std": {}, "unit": {},
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
        "schema": "torchid.gap/2", "robot": robot.name, "status": "explained",
        "where": {"joints": [], "regimes": []}, "which": [],
        "how_far": {
            "rms_before": 1.0, "rms_after": 0.1, "on": [], "how": "left out in turn",
            "noise_floor_rms": [0.1, 0.2], "closed": 0.9, "closed_ci95": [0.8, 1.0],
            "per_joint": [],
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


def named(
    effect: str = "coulomb_friction", joint: int = 2, also: Sequence[str] = (), **values: float
) -> dict[str, Any]:
    """An accepted effect with its coefficients, each to 0.02 of its unit."""
    values = values or {"Fc": 0.5}
    return found(
        effect, joint, ambiguous_with=list(also), parameters={**values, "smoothing": 0.0},
        std=dict.fromkeys(values, 0.02), unit=dict.fromkeys(values, "N m"),
    )  # fmt: skip


def diagnosis(
    path: Path,
    *which: dict[str, Any],
    hidden: Sequence[dict[str, Any]] = (),
    robot: str = "3r",
    effects: Sequence[dict[str, Any]] = (),
) -> Path:
    """A file of a diagnosis that names effects, whose corrected model has others."""
    arm = load_robot(robot)
    corrected = {**robot_record(arm), "effects": list(effects)}
    data = gap(arm, which=list(which), not_testable=list(hidden), corrected=corrected)
    path.write_text(json.dumps(data))
    return path
