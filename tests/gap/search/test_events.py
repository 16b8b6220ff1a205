"""Pushes are found where they were, and not in noise, however slow."""

from dataclasses import replace

import pytest
import torch

import torchid
from tests.effects.exact_logs import smooth_motion
from tests.gap.motions import noises
from tests.gap.problems import NOISE, SIMPLE, data_of, measured, question_of
from torchid.design.columns import Columns, Model
from torchid.design.repeats import Pair, Repeats, counterparts
from torchid.design.segments import Segment
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


@pytest.mark.nightly
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


@pytest.mark.parametrize("seed", range(3))
def test_what_comes_again_with_the_motion_is_no_push(quiet, columns, seed):
    """Both runs have the push: where the motion is known to repeat itself, it is a law."""
    data = noisy(quiet, seed, None)
    (one, two) = data.segments
    length = min(len(one.tau), len(two.tau))
    torque = PUSH.all_torques(two.motion, [1.0, 0.0, 2.0], load_robot("3r"))[:length]
    pushed = [replace(s, tau=s.tau.clone()) for s in (one, two)]
    for s in pushed:
        s.tau[:length] += torque
    both = replace(data, samples=type(data.samples)(pushed, data.samples.cutoff))
    question = question_of(both, (*SIMPLE, "contact"), columns=columns)
    rows = slice(0, length)
    again = counterparts(both.samples, Repeats((Pair(0, rows, 1, rows, 0.0),)))
    assert len(contacts(question)) > 0
    assert contacts(question, again) == []
    # What one of the two has is an event, repeats or not.
    once = replace(data, samples=type(data.samples)([one, pushed[1]], data.samples.cutoff))
    question = question_of(once, (*SIMPLE, "contact"), columns=columns)
    assert contacts(question, again) == contacts(question) != []


@pytest.mark.slow
def test_a_push_on_the_forearm_is_found_there():
    """The wrist feels nothing of it, which no force at the tool explains."""
    robot = load_robot("ur10e")
    robot = robot.with_parameters(torchid.InertialParameters(torch.zeros(6, 10).double()))
    motion = smooth_motion(robot, 4000, rate=200.0)
    push = Contact(9.0, 10.2, robot.link_names[2], 0.5)
    torque = push.all_torques(motion, [8.0, 15.0, -10.0], robot)
    g = torch.Generator().manual_seed(0)
    noise = NOISE * torch.randn(torque.shape, dtype=torch.float64, generator=g)
    segment = Segment("run", 200.0, 80.0, motion, torque + noise, True)
    data = data_of([segment])
    columns = Columns(Model(robot, ()), data.samples)
    found = contacts(question_of(data, ("coulomb_friction", "contact"), columns=columns))
    near = [c for c in found if c.start < push.stop and c.stop > push.start]
    # Of the tool's and the link's the search decides.
    assert {c.tip for c in near} == {push.tip, None}
    # A force at the tool is felt by the wrist, too, so no link is offered.
    torque = Contact(9.0, 10.2).all_torques(motion, [8.0, 15.0, -10.0], robot)
    data = data_of([replace(segment, tau=torque + noise)])
    found = contacts(question_of(data, ("coulomb_friction", "contact"), columns=columns))
    assert {c.tip for c in found} == {None}


def test_windows_lie_within_their_run(quiet, columns):
    found = found_in(noisy(quiet, 4, None, [2.0, 0.0, 0.0]), columns)
    (one, two) = quiet.segments
    ends = [(s.start, float(s.motion.t[-1])) for s in (one, two)]
    for c in found:
        assert any(a <= c.start < c.stop <= b for a, b in ends)
    assert torch.isfinite(torch.tensor([c.start for c in found])).all()
