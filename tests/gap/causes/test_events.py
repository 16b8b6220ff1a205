"""Pushes are found where they were, and not in noise, however slow."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch

import torchid
from tests.effects.exact_logs import smooth_motion
from tests.gap.causes.problems import explanation
from tests.gap.motions import ROBOT, noises
from tests.gap.problems import NOISE, SIMPLE, data_of, measured, problem_of, wanted_of
from torchid.design.repeats import Pair, Repeats
from torchid.design.segments import Segment
from torchid.effects.friction import CoulombFriction
from torchid.effects.transient import Contact
from torchid.gap.causes.candidates import Library
from torchid.gap.causes.events import _chance, pushes
from torchid.gap.causes.search import Search
from torchid.gap.data import Data
from torchid.robot.library import load_robot
from torchid.robot.model import Robot

FRICTION = [(CoulombFriction(j), [0.3]) for j in range(3)]
PUSH = Contact(13.0, 14.2)  # in the second run, which begins at 11 s


@pytest.fixture(scope="module")
def quiet() -> Data:
    return measured(FRICTION, noise=0.0)


def noisy(quiet: Data, seed: int, hz: float | None, force: list[float] | None = None) -> Data:
    """The same motion with noise, and perhaps a push."""
    found = []
    for s, z in zip(quiet.segments, noises(quiet.segments, seed, hz, NOISE), strict=True):
        pushed = 0.0 if force is None else PUSH.all_torques(s.motion, force, ROBOT)
        found.append(replace(s, tau=s.tau + z + pushed))
    return replace(quiet, samples=type(quiet.samples)(found, quiet.samples.cutoff))


def search_of(
    data: Data,
    names: Sequence[str] = SIMPLE,
    repeats: Repeats = Repeats(()),  # noqa: B008
    robot: Robot = ROBOT,
) -> Search:
    wanted = wanted_of((*names, "contact"))
    return Search(Library(problem_of(data, wanted, robot, repeats=repeats)))


def found_in(of: Search) -> list[Contact]:
    """Contacts of the explanation."""
    effects = (t.effect for t in explanation(of).fit.terms)
    return [e for e in effects if isinstance(e, Contact)]


@pytest.mark.parametrize("hz", [None, 2.0])
@pytest.mark.parametrize("force", [[1.0, 0.0, 0.0], [0.0, 1.5, 2.0]])
def test_a_push_is_found_in_its_window(quiet, hz, force):
    (found,) = found_in(search_of(noisy(quiet, 3, hz, force)))
    assert found.start == pytest.approx(PUSH.start, abs=0.15)
    assert found.stop == pytest.approx(PUSH.stop, abs=0.15)


@pytest.mark.nightly
def test_noise_is_no_push(quiet):
    """Twenty logs, white to slow."""
    alarms = 0
    for seed in range(20):
        hz = (None, 5.0, 2.0, 1.0)[seed % 4]
        alarms += bool(found_in(search_of(noisy(quiet, 100 + seed, hz))))
    assert alarms <= 1


def test_a_wrong_law_is_no_push(quiet):
    """Friction that no law of the library is comes at every reversal."""
    data = noisy(quiet, 5, None)
    late = [replace(s, tau=s.tau + 0.5 * s.motion.dq.tanh()) for s in data.segments]
    data = replace(data, samples=type(data.samples)(late, data.samples.cutoff))
    assert found_in(search_of(data)) == []


@pytest.mark.parametrize("seed", range(3))
def test_what_comes_again_with_the_motion_is_no_push(quiet, seed):
    """Both runs have the push: where the motion is known to repeat itself, it is a law."""
    data = noisy(quiet, seed, None)
    (one, two) = data.segments
    length = min(len(one.tau), len(two.tau))
    torque = PUSH.all_torques(two.motion, [1.0, 0.0, 2.0], ROBOT)[:length]
    pushed = [replace(s, tau=s.tau.clone()) for s in (one, two)]
    for s in pushed:
        s.tau[:length] += torque
    rows = slice(0, length)
    repeats = Repeats((Pair(0, rows, 1, rows, 0.0),))

    def offered(segments: list[Segment], repeats: Repeats) -> set[tuple[float, float]]:
        """Windows beside the laws."""
        both = replace(data, samples=type(data.samples)(segments, data.samples.cutoff))
        of = search_of(both, repeats=repeats)
        laws = [t for t in of.library.terms if t.name == "coulomb_friction"]
        fit = of.evidence.fit(laws, of.library.rows)
        weight = of.library.rows / fit.losses
        found = pushes(of.library, of.evidence.left(fit), weight)
        return {(t.effect.start, t.effect.stop) for t in found}

    assert offered(pushed, Repeats(()))
    assert not offered(pushed, repeats)
    # What one of the two has is an event, repeats or not.
    once = [one, pushed[1]]
    assert offered(once, repeats) == offered(once, Repeats(())) != set()


@pytest.mark.slow
def test_a_push_on_the_forearm_is_found_there():
    """The wrist feels nothing of it, which no force at the tool explains; and what is felt there is
    none of the forearm's."""
    robot = load_robot("ur10e")
    robot = robot.with_parameters(torchid.InertialParameters(torch.zeros(6, 10).double()))
    motion = smooth_motion(robot, 4000, rate=200.0)
    g = torch.Generator().manual_seed(0)
    noise = NOISE * torch.randn(motion.q.shape, dtype=torch.float64, generator=g)
    forearm = Contact(9.0, 10.2, robot.link_names[2], 0.5)
    for push in (forearm, Contact(9.0, 10.2)):
        torque = push.all_torques(motion, [8.0, 15.0, -10.0], robot)
        data = data_of([Segment("run", 200.0, 80.0, motion, torque + noise, True)])
        (found,) = found_in(search_of(data, ("coulomb_friction",), robot=robot))
        assert found.tip == push.tip
        assert found.start < 9.3
        assert found.stop > 9.9


def offered_by(data: Data) -> list[Contact]:
    """Pushes that are offered beside the laws of each joint."""
    of = search_of(data)
    laws = [t for t in of.library.terms if t.name == "coulomb_friction"]
    fit = of.evidence.fit(laws, of.library.rows)
    some = pushes(of.library, of.evidence.left(fit), of.library.rows / fit.losses)
    return [t.effect for t in some]


def test_a_push_at_the_end_stands_out_from_windows_of_like_motion(quiet):
    """What a law leaves, felt at every reversal, is none; 5 N beside it are."""

    def wrong(data: Data) -> Data:
        late = [replace(s, tau=s.tau + 0.5 * (s.motion.dq / 0.3).tanh()) for s in data.segments]
        return replace(data, samples=type(data.samples)(late, data.samples.cutoff))

    assert offered_by(wrong(noisy(quiet, 5, None))) == []
    (found,) = offered_by(wrong(noisy(quiet, 5, None, [5.0, 0.0, 5.0])))
    assert (found.start, found.stop) == pytest.approx((PUSH.start, PUSH.stop), abs=0.1)


@pytest.mark.parametrize("swings", [False, True])
def test_a_push_is_worth_what_it_foretells_of_its_own_window(quiet, swings):
    """A torque that swings about half of its size has no force that holds a moment later."""
    data = noisy(quiet, 2, None)
    one, two = data.segments
    t = two.motion.require("t", "a test")
    size = 0.5 + torch.sin(4 * torch.pi * (t - PUSH.start) / (PUSH.stop - PUSH.start)).sign()
    torque = PUSH.all_torques(two.motion, [1.0, 0.0, 2.0], ROBOT)
    two = replace(two, tau=two.tau + torque * (size.unsqueeze(1) if swings else 1.0))
    of = search_of(replace(data, samples=type(data.samples)([one, two], data.samples.cutoff)), ())
    term = of.library.of_event(PUSH)
    friction = [t for t in of.library.terms if t.name == "coulomb_friction"]
    found = of.worthwhile(of.again(of.evidence.fit([*friction, term], of.library.rows)))
    assert (term in found.fit.terms, term in found.small) == (not swings, swings)


def test_a_push_is_longer_than_the_filters_answer(quiet):
    of = search_of(noisy(quiet, 1, None))
    assert of.library.of_event(Contact(3.0, 3.0 + 0.9 / 8.0)) is None
    assert of.library.of_event(Contact(3.0, 3.0 + 1.1 / 8.0)) is not None


def test_windows_lie_within_their_run(quiet):
    of = search_of(noisy(quiet, 4, None, [2.0, 0.0, 0.0]))
    (one, two) = quiet.segments
    ends = [(s.start, float(s.motion.t[-1])) for s in (one, two)]
    t = of.library.samples.t
    for first, last in of.library.windows.spans:
        assert any(a <= t[first] < t[last - 1] <= b for a, b in ends)


def test_a_force_that_is_there_again_is_of_no_usual_size():
    spans = np.arange(0, 4000, 10)[:, None] + [0, 10]
    push = (2000, 2010)
    gains = np.where(spans[:, 0] % 3 == 0, 1.0, -np.inf)
    gains[200] = 12.0
    with np.errstate(all="raise"):
        chances = [
            _chance(np.maximum(gains, low), spans, push, [push], 1.0) for low in (-np.inf, 0)
        ]
        # All are there again but the push.
        gains = np.where(np.arange(400) == 200, 12.0, -np.inf)
        assert _chance(gains, spans, push, [push], 1.0) < 1e-3
    assert chances[0] == chances[1] < 1e-3
