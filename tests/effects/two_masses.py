"""A pendulum behind a gear that gives way, integrated by scipy along a motor's motion."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from scipy.integrate import solve_ivp

from torchid.effects.motion import Motion
from torchid.robot.library import load_robot
from torchid.robot.model import Robot

MASS, ARM, OWN = 3.0, 0.4, 0.12
INERTIA = OWN + MASS * ARM**2


def pendulum(folder: Path) -> Robot:
    """One joint with a horizontal axis."""
    file = folder / "pendulum.yaml"
    file.write_text(f"""
name: pendulum
dh: {{convention: modified, joints: [{{type: R, a: 0, alpha: 0, d: 0, theta: 0}}]}}
gravity: [0, -9.81, 0]
parameters:
  mass: [{MASS}]
  com: [[{ARM}, 0, 0]]
  inertia_about_com: [[0.01, 0, 0, {OWN}, 0, {OWN}]]
""")
    return load_robot(str(file))


def driven(
    amplitudes: list[float], hertz: list[float], seconds: float, rate: float, centre: float = 0.3
) -> tuple[Motion, Callable[[float], tuple[float, float]]]:
    """A sum of sines as the motor's motion, and its angle and acceleration at any time."""
    a, w = np.array(amplitudes), 2 * np.pi * np.array(hertz)
    phase = np.arange(len(a)) * 1.3

    def at(t: float) -> tuple[float, float]:
        x = w * t + phase
        return centre + float(a @ np.sin(x)), -float((a * w**2) @ np.sin(x))

    t = torch.arange(round(seconds * rate), dtype=torch.float64) / rate
    x = t.unsqueeze(1) * torch.from_numpy(w) + torch.from_numpy(phase)
    size, omega = torch.from_numpy(a), torch.from_numpy(w)
    q = centre + torch.sin(x) @ size
    dq, ddq = torch.cos(x) @ (size * omega), -torch.sin(x) @ (size * omega**2)
    return Motion(*(s.unsqueeze(1) for s in (q, dq, ddq)), t=t), at


def gear_torque(
    at: Callable[[float], tuple[float, float]],
    t: torch.Tensor,
    stiffness: float,
    damping: float,
    play: float = 0.0,
) -> torch.Tensor:
    """Torque that the gear transmits to the link (T,); a flank pushes and does not pull, and the
    bearing's drag is as large as the flanks' damping."""

    def transmitted(lag: float, rate: float) -> float:
        beyond = lag - min(max(lag, -play / 2), play / 2)
        force = stiffness * beyond + damping * rate
        return force if play == 0 or force * beyond > 0 else damping * rate

    def slope(now: float, state: np.ndarray) -> list[float]:
        motor, acceleration = at(now)
        gravity = 9.81 * MASS * ARM * np.cos(motor - state[0])
        change = acceleration + (gravity - transmitted(*state)) / INERTIA
        return [state[1], change]

    start = 9.81 * MASS * ARM * np.cos(at(0.0)[0])
    first = [start / stiffness + np.sign(start) * play / 2, 0.0]
    times = t.numpy()
    found = solve_ivp(
        slope, (times[0], times[-1]), first, "LSODA", times, rtol=1e-8, atol=1e-11, max_step=1e-3
    )
    return torch.tensor([transmitted(*s) for s in found.y.T], dtype=torch.float64)
