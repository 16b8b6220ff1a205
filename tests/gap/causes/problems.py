"""Small gaps of the 3R whose cause is known, and their search, made once."""

from functools import cache

from tests.gap.problems import measured, problem_of, wanted_of
from torchid.effects.base import Effect
from torchid.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from torchid.effects.gravity import TorqueGain
from torchid.effects.inertia import RotorInertia
from torchid.gap.causes.candidates import Library, Term
from torchid.gap.causes.search import Found, Search
from torchid.gap.problem import Problem

NAMES = (
    "viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia", "torque_gain",
    "joint_spring", "presliding_hysteresis",
)  # fmt: skip

PLANTED: dict[str, tuple[Effect, list[float]]] = {
    "viscous_friction": (ViscousFriction(1), [0.4]),
    "coulomb_friction": (CoulombFriction(0), [0.5]),
    "torque_offset": (TorqueOffset(2), [0.2]),
    "rotor_inertia": (RotorInertia(0), [0.05]),
    "torque_gain": (TorqueGain(1), [0.1]),
}

SEVERAL = {"dry_and_viscous": [(ViscousFriction(1), [0.4]), (CoulombFriction(1), [0.02])]}


@cache
def problem(name: str | None, hz: float | None = None, names: tuple[str, ...] = NAMES) -> Problem:
    """The gap of the 3R with an effect, or without any; noise is white, or below `hz`."""
    effects = [] if name is None else SEVERAL[name] if name in SEVERAL else [PLANTED[name]]
    return problem_of(measured(effects, hz=hz), wanted_of(names))


@cache
def search(name: str | None, hz: float | None = None) -> Search:
    """Its search, not begun."""
    return Search(Library(problem(name, hz)))


def explanation(of: Search) -> Found:
    """What a search ends with, from nothing."""
    return of.completed(of.joined())


def candidate(of: Search, name: str, joint: int) -> Term:
    """The first candidate of this name on a joint."""
    return next(t for t in of.library.terms if (t.name, t.joints) == (name, (joint,)))
