"""Pushes are found where they were, and not in noise, however slow."""

from dataclasses import replace

import pytest
import torch

from tests.gap.motions import noises
from tests.gap.problems import NOISE, SIMPLE, measured, question_of
from torchid.design.columns import Columns, Model
from torchid.effects.friction import CoulombFriction
from torchid.effects.transient import Contact
from torchid.gap.data import Data
from torchid.gap.search.events import contacts
from torchid.robot.library import load_robot

FRICTION = [(CoulombFriction(j), [0.3]) for j in range(3)]
PUSH = Contact(13.0, 14.2)  # in the second run, which begins at 11 s


@pytest.fixture(scope="module")
def quiet() -> Data:
    return measured(FRICTION, noise=0.0)


@pytest.fixture(scope="module")
def columns(quiet: Data) -> Columns:
    """Of all that is sought: the motion is the same in every log."""
    return Columns(Model(load_robot("3r"), ()), quiet.samples)


def noisy(quiet: Data, seed: int, hz: float | None, force: list[float] | None = None) -> Data:
    """The same motion with noise, and perhaps a push."""
    robot = load_robot("3r")
    found = []
    for s, z in zip(quiet.segments, noises(quiet.segments, seed, hz, NOISE), strict=True):
        pushed = 0.0 if force is None else PUSH.all_torques(s.motion, force, robot)
        found.append(replace(s, tau=s.tau + z + pushed))
    return replace(quiet, samples=type(quiet.samples)(found, quiet.samples.cutoff))


def found_in(data: Data, columns: Columns) -> list[Contact]:
    return contacts(question_of(data, (*SIMPLE, "contact"), columns=columns))


@pytest.mark.parametrize("hz", [None, 2.0])
@pytest.mark.parametrize("force", [[1.0, 0.0, 0.0], [0.0, 1.5, 2.0]])
def test_a_push_is_found_in_its_window(quiet, columns, hz, force):
    found = found_in(noisy(quiet, 3, hz, force), columns)
    # The clearest window is a part of the push; of those about it one has its ends.
    first = found[0]
    shared = min(first.stop, PUSH.stop) - max(first.start, PUSH.start)
    assert shared > 0.6 * (first.stop - first.start)
    about = [c for c in found if c.start < PUSH.stop and c.stop > PUSH.start]
    assert 1 <= len(about) <= 4
    off = [max(abs(c.start - PUSH.start), abs(c.stop - PUSH.stop)) for c in about]
    assert min(off) < 0.1


def test_noise_is_no_push(quiet, columns):
    """Twenty logs, white to slow; of a hundred one may have one, and the search decides."""
    alarms = 0
    for seed in range(20):
        hz = (None, 5.0, 2.0, 1.0)[seed % 4]
        alarms += bool(found_in(noisy(quiet, 100 + seed, hz), columns))
    assert alarms <= 1


def test_a_wrong_law_is_no_push(quiet, columns):
    """Friction that no law in the question has comes at every reversal, so no window stands out."""
    data = noisy(quiet, 5, None)
    late = [replace(s, tau=s.tau + 0.5 * s.motion.dq.tanh()) for s in data.segments]
    data = replace(data, samples=type(data.samples)(late, data.samples.cutoff))
    assert found_in(data, columns) == []


def test_windows_lie_within_their_run(quiet, columns):
    found = found_in(noisy(quiet, 4, None, [2.0, 0.0, 0.0]), columns)
    (one, two) = quiet.segments
    ends = [(s.start, float(s.motion.t[-1])) for s in (one, two)]
    for c in found:
        assert any(a <= c.start < c.stop <= b for a, b in ends)
    assert torch.isfinite(torch.tensor([c.start for c in found])).all()
