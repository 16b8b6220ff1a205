"""Nonlinear effects are recovered at their true size, and the corrected model has each once."""

from dataclasses import replace

import pytest
import torch

from tests.arms import consistent_parameters
from tests.gap.motions import ROBOT
from tests.gap.problems import (
    NOISE,
    SIMPLE,
    explanation_of,
    measured,
    on_joint,
    problem_of,
    search_of,
    term,
    two_folds,
    wanted_of,
)
from torchid.design.columns import Model
from torchid.design.gram import least_squares
from torchid.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from torchid.effects.friction_laws import LoadDependentFriction, StribeckFriction
from torchid.effects.gravity import EncoderOffset, TorqueCrosstalk
from torchid.effects.inertia import Payload
from torchid.effects.phase import TimeDelay
from torchid.gap.causes.candidates import Library, Term
from torchid.gap.causes.search import Search
from torchid.gap.data import Data
from torchid.gap.describe.model import Solution, corrected_model, parts_of, solve, undetermined
from torchid.robot.inertia import InertialParameters
from torchid.statistics.robust import huber_weights


def solution_of(search: Search, terms: list[Term]) -> Solution:
    """All terms together."""
    return explanation_of(search, terms).solution


@pytest.mark.parametrize(
    ("effect", "value"),
    [(EncoderOffset(1, at=0.05), 0.05), (TimeDelay(1, at=8e-3), 8e-3)],
)
def test_secants_end_at_the_true_size(effect, value):
    """The torque is that of the whole offset or delay; the candidate's secant begins elsewhere."""
    data = measured([(effect, [value])], noise=0.0)
    search = search_of(data, (effect.name,))
    candidate = on_joint(search, effect.name, 1)
    assert candidate.effect != effect
    found = solution_of(search, [candidate])
    assert float(found.values[0]) == pytest.approx(value, rel=5e-3)
    assert found.parts[0].effects[0].at == pytest.approx(value, rel=0.02)
    ((own, values),) = found.model.effects
    assert own.identity == effect.identity
    assert values[0] == pytest.approx(float(found.values[0]))
    before = search.library.problem.given.gap * data.keep
    assert float(found.left.norm() / before.norm()) < 0.01


def test_standard_deviations_are_those_of_the_noise():
    """Of a term in white noise: that of least squares on as many samples, within a factor of two,
    and the value within three of them. Many blocks tell of it, so that Student's factor is none."""
    data = measured([(ViscousFriction(1), [1.0])])
    search = Search(Library(problem_of(data, wanted_of(SIMPLE), block=4)))
    found = solution_of(search, [term(search, ViscousFriction(1))])
    std, value = float(found.std[0]), float(found.values[0])
    assert abs(value - 1.0) < 3 * std
    square = float(found.a.square().sum())
    left = float(found.left[1].square().mean())
    assert 0.5 < std / (left / square) ** 0.5 < 2.0
    assert left**0.5 < NOISE


def test_friction_that_grows_with_load_sees_the_corrected_load():
    """An offset that is found too changes what the friction's column is."""
    truth = [(TorqueOffset(1), [8.0]), (LoadDependentFriction(1), [0.1])]
    data = measured(truth, noise=0.0)
    search = search_of(data, ("torque_offset", "load_dependent_friction"))
    found = solution_of(search, [on_joint(search, e.name, 1) for e, _ in truth])
    assert [float(v) for v in found.values] == pytest.approx([8.0, 0.1], rel=1e-3)


def test_a_fold_is_not_fitted():
    """Its torque is spoilt, and a model without it does not know."""
    data = measured([(ViscousFriction(1), [1.0])], noise=0.0)
    held = two_folds(data) == 1
    search = search_of(data)
    found = solution_of(search, [term(search, ViscousFriction(1))])
    spoilt = replace(found, left=found.left + 3.0 * held)
    ((_, clean),) = spoilt.without(~held).effects
    assert clean == pytest.approx([1.0], rel=1e-6)
    ((_, both),) = spoilt.without(torch.ones_like(held)).effects
    assert abs(both[0] - 1.0) > 0.01


def test_what_the_other_samples_hardly_hold_keeps_its_size():
    """What happened in one fold cannot be predicted by the others; what is always there can."""
    data = measured([(ViscousFriction(1), [1.0]), (TorqueOffset(0), [0.5])], noise=0.0)
    search = search_of(data)
    terms = [term(search, e) for e in (ViscousFriction(1), TorqueOffset(0))]
    found = solution_of(search, terms)
    few = torch.zeros(len(data.samples), dtype=torch.bool)
    few[:20] = True
    spoilt = replace(found, left=found.left + 3.0)
    kept = {e.name: v for e, v in spoilt.without(few).effects}
    assert kept == {
        "viscous_friction": pytest.approx([1.0], rel=1e-4),
        "torque_offset": pytest.approx([0.5], rel=1e-4),
    }
    again = {e.name: v for e, v in spoilt.without(torch.ones_like(few)).effects}
    assert again["torque_offset"][0] > 1.0


def fitted(search: Search, terms: list[Term], values: list[float]) -> Model:
    x = [torch.tensor([v], dtype=torch.float64) for v in values]
    parts = parts_of(search.library, terms)
    return corrected_model(search.library.problem.given.model, parts, x)


@pytest.fixture(scope="module")
def data() -> Data:
    return measured([])


def test_the_model_s_own_effect_grows(data):
    given = ((CoulombFriction(0), [0.4]), (ViscousFriction(1), [1.5]))
    search = search_of(data, given=given)
    own, other = term(search, ViscousFriction(1)), term(search, TorqueOffset(2))
    assert parts_of(search.library, [own])[0].known == (1.5,)
    assert fitted(search, [own, other], [-0.5, 0.2]).effects == (
        (CoulombFriction(0), [0.4]), (ViscousFriction(1), [1.0]), (TorqueOffset(2), [0.2]),
    )  # fmt: skip


def test_a_negative_correction_of_the_model_s_own_is_no_negative_friction():
    """The model has more viscous friction than the arm; what is left stays positive, or is none."""
    given = ((ViscousFriction(1), [1.5]),)
    for there, whole in ((1.0, 1.0), (-0.5, 0.0)):
        search = search_of(measured([(ViscousFriction(1), [there])]), given=given)
        found = solution_of(search, [term(search, ViscousFriction(1))])
        ((_, (value,)),) = found.model.effects
        assert value == pytest.approx(whole, abs=0.02)


def test_another_shape_replaces_the_model_s_own():
    """As large as the whole of it, not as what is added."""
    own, true = StribeckFriction(1, vs=0.3), StribeckFriction(1, vs=0.4)
    search = search_of(measured([(true, [1.1])], noise=0.0), (own.name,), given=((own, [0.8]),))
    found = solution_of(search, [term(search, true)])
    ((effect, values),) = found.model.effects
    assert effect.vs == pytest.approx(true.vs)
    assert values == pytest.approx([1.1], rel=1e-3)


def test_a_secant_of_the_model_s_own_moves_with_the_sum(data):
    own = EncoderOffset(1, at=0.04)
    search = search_of(data, ("encoder_offset",), given=((own, [0.04]),))
    found = on_joint(search, "encoder_offset", 1)
    ((effect, values),) = fitted(search, [found], [0.02]).effects
    assert values == pytest.approx([0.06])
    assert effect.at == pytest.approx(0.06)


def test_links_are_corrected_one_by_one(data):
    search = search_of(data, ("link_inertia",), inertial=True)
    pi = ROBOT.require_parameters("a test").pi
    change = torch.arange(1.0, 11.0, dtype=torch.float64)
    parts = parts_of(search.library, [on_joint(search, "link_inertia", 2)])
    model = corrected_model(Model(ROBOT, ()), parts, [change])
    found = model.robot.require_parameters("a test").pi
    assert torch.allclose(found[2], pi[2] + change)
    assert torch.allclose(found[:2], pi[:2])
    assert model.effects == ()


def some_load(seed: int, kind: str) -> torch.Tensor:
    """Ten numbers of a load, or of none."""
    g = torch.Generator().manual_seed(seed)
    if kind == "any numbers":
        return 0.3 * torch.randn(10, generator=g, dtype=torch.float64)
    if kind == "a point":
        mass, place = 2 * torch.rand(1, generator=g).double(), 0.3 * torch.randn(1, 3, generator=g)
        return InertialParameters.from_com(mass, place.double(), torch.zeros(1, 6).double()).pi[0]
    return consistent_parameters(1, seed).pi[0]


@pytest.mark.parametrize("share", [0.0, 1.0], ids=["new", "in the file's place"])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", ["a body", "a point", "any numbers"])
def test_a_load_is_a_body(kind: str, seed: int, share: float):
    """Whatever the torque asks for, with or without a load that the file has; of a body as much as
    there is."""
    load, there = some_load(seed, kind), share * consistent_parameters(1, seed + 10).pi[0]
    given, real = (Payload().plant(ROBOT, x) for x in (there, load))
    problem = problem_of(measured([], real=real), wanted_of(("payload",)), given)
    search = Search(Library(replace(problem, load=tuple(there.tolist()))))
    found = solution_of(search, [term(search, Payload())])
    ((_, values),) = found.model.effects
    own = InertialParameters(torch.tensor([values]).double())
    assert float(own.consistency_margin()) > 0
    links = found.model.robot.require_parameters("a test").pi
    torch.testing.assert_close(links, ROBOT.require_parameters("a test").pi)
    if kind != "any numbers":
        assert float(own.mass) == pytest.approx(float(load[0]), rel=0.02)


def test_wrong_base_parameters_are_found_up_to_what_is_seen():
    """The corrected model's torque is the real arm's, whichever bodies stand for it."""
    pi = ROBOT.require_parameters("a test").pi * torch.tensor([[1.0], [1.2], [0.8]])
    data = measured([], real=ROBOT.with_parameters(InertialParameters(pi)), noise=0.0)
    search = search_of(data, (), inertial=True)
    (base,) = (t for t in search.library.terms if t.name == "all_base")
    found = solution_of(search, [base])
    before = (search.library.problem.given.gap * data.keep).norm()
    assert float(found.left.norm() / before) < 1e-3
    margin = found.model.robot.require_parameters("a test").consistency_margin()
    assert bool((margin > 0).all())


def test_crosstalk_has_its_size_although_the_model_lacks_the_friction_of_its_source():
    """The sensor reads the torque that is there. By the model's the size is 40 % off; noise of the
    source's sensor lowers it as much as the noise's share of the torque that no law spans."""
    size, laws = 0.05, [(CoulombFriction(1), [3.0]), (ViscousFriction(1), [1.5])]
    true, noisy = (measured(laws, noise=noise) for noise in (0.0, 0.05))
    read = torch.tensor([size, 0.0, 0.0]).double()
    segments = [
        replace(a, tau=a.tau + b.tau[:, 1:2] * read)
        for a, b in zip(noisy.segments, true.segments, strict=True)
    ]
    data = replace(noisy, samples=type(noisy.samples)(segments, noisy.samples.cutoff))
    search = search_of(data, ("torque_crosstalk",))
    own = term(search, TorqueCrosstalk(0, 1))
    assert own.place == 0
    fit = explanation_of(search, [own]).fit
    assert fit.x[0] == pytest.approx(size, rel=0.02)
    # The same column, put together again.
    columns = search.library.columns
    (part,) = parts_of(search.library, [own])
    torque = part.columns(columns)
    assert not torque[:, 1:].any()
    left = (columns.gap[0] - fit.x[0] * torque[0, 0])[data.keep[0]]
    assert float(left.square().sum()) == pytest.approx(fit.losses[0], rel=1e-6)
    model = data.samples.of([m.require("torque", "a test").T for m in columns.motions])[1]
    assert float(columns.gap[0] @ model / model.square().sum()) > 1.3 * size


def test_no_step_is_taken_where_none_is_asked_for():
    search = search_of(measured([(ViscousFriction(1), [1.0])]))
    fit = search.evidence.fit([term(search, ViscousFriction(1))], search.library.rows / 4)
    found = solve(search.library.problem, search, fit, 0)
    assert float(found.values[0]) == pytest.approx(fit.x[0])
    left = torch.from_numpy(search.evidence.left(fit))
    torch.testing.assert_close(found.left, left, rtol=0, atol=1e-9)


def test_what_no_column_shows_is_open() -> None:
    a = torch.randn(40, 3, generator=torch.Generator().manual_seed(0)).double()
    both = torch.cat([a, a[:, :1] + a[:, 1:2], torch.zeros(40, 1).double()], 1)
    assert undetermined(a.T @ a).tolist() == [False] * 3
    assert undetermined(both.T @ both).tolist() == [True, True, False, True, True]


def test_least_squares_leaves_what_is_not_determined_at_zero():
    g = torch.Generator().manual_seed(0)
    a = torch.randn(2, 60, generator=g, dtype=torch.float64)
    y = 2 * a[0] - a[1]
    x = least_squares(torch.cat([a, torch.zeros(1, 60)]), y)
    assert x.tolist() == pytest.approx([2.0, -1.0, 0.0], abs=1e-9)
    both = least_squares(torch.stack([a[0], a[0]]), 3 * a[0])
    assert both.tolist() == pytest.approx([1.5, 1.5], rel=1e-6)


def test_far_out_samples_count_as_their_limit():
    g = torch.Generator().manual_seed(1)
    r = torch.randn(1, 20_000, generator=g, dtype=torch.float64)
    r[0, :10] = 50.0
    r[0, 10:20] = 0.0  # of samples that do not count
    weights = huber_weights(r).square()
    assert bool((weights[0, :10] * 50.0 < 1.5).all())
    assert float((weights == 1).double().mean()) == pytest.approx(0.82, abs=0.02)


@pytest.mark.parametrize("gain_std", [0.05, 0.2])
def test_an_unknown_scale_of_the_torque_is_in_the_standard_deviations(gain_std: float) -> None:
    data = measured([(ViscousFriction(0), [1.0]), (CoulombFriction(1), [0.5])])
    exact, scaled = (
        solution_of(s, [term(s, ViscousFriction(0)), term(s, CoulombFriction(1))])
        for s in (search_of(data), search_of(replace(data, gain_std=gain_std)))
    )
    for a, b, x in zip(exact.std, scaled.std, exact.values, strict=True):
        assert float(b.square() - a.square()) == pytest.approx(float(gain_std * x) ** 2, rel=1e-6)
