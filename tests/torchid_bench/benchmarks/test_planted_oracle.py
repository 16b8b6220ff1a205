"""The likelihood of the oracle beside closed forms, and the class of a case that is plain."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal

from tests.arms import arm
from torchid.effects.registry import effect_from_record, model_torque
from torchid.log.model import Log
from torchid_bench.benchmarks.planted_cases import Case
from torchid_bench.benchmarks.planted_evidence import (
    Gap,
    Terms,
    comparable,
    held_out,
    independent,
    nats,
)
from torchid_bench.benchmarks.planted_library import Half, half_of, left_open, library
from torchid_bench.benchmarks.planted_oracle import Known, class_of, classified

N, JOINTS = 60, 2


def terms(count: int, seed: int = 0) -> Terms:
    """Random columns on two joints, a gap of the first and noise."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(count, JOINTS, N)) * [[[1.0], [5.0]]]
    y = 2 * columns[0] + rng.normal(size=(JOINTS, N)) * [[0.3], [2.0]]
    gap = Gap(y, np.full(JOINTS, float(N)), (slice(0, N),), np.arange(N) * 5 // N)
    return Terms(gap, columns)


def test_the_evidence_is_a_marginal_likelihood_at_the_noise_that_is_left() -> None:
    """y = A z + e, z ~ N(0, 1), e ~ N(0, L_j/n_j): log N(y; 0, AA' + noise), but for constants."""
    own = terms(5)
    effective = np.full(JOINTS, float(N))
    fit = own.fit(effective)
    a = own.columns.reshape(5, -1).T
    noise = np.repeat(fit.losses / N, N)
    exact = multivariate_normal(cov=a @ a.T + np.diag(noise)).logpdf(own.gap.y.ravel())
    constant = JOINTS * N * (np.log(N) - np.log(2 * np.pi) - 1) / 2
    assert fit.evidence + constant == pytest.approx(exact, abs=1e-6)


def test_coefficients_are_those_of_the_highest_evidence() -> None:
    own, effective = terms(3), np.array([20.0, 45.0])

    def target(z: np.ndarray) -> float:
        left = own.gap.y - np.tensordot(z, own.columns, 1)
        return float(effective @ np.log((left**2).sum(1)) + z @ z)

    z = own.fit(effective).z
    steps = 1e-3 * np.random.default_rng(1).normal(size=(20, 3))
    assert all(target(z + step) > target(z) for step in steps)


def test_columns_of_zeros_net_nothing() -> None:
    own = terms(4)
    zeros = np.zeros((3, JOINTS, N))
    assert nats(own.with_(zeros), own) == pytest.approx(0, abs=1e-9)
    assert held_out(own.with_(zeros), own) == pytest.approx(0, abs=1e-9)
    assert independent(np.zeros((3, 3))).shape == (3, 0)


def test_both_sides_of_a_comparison_have_the_same_samples() -> None:
    both, one = terms(4), Terms(terms(4).gap, terms(4).columns[1:3])
    assert comparable(both, one) == pytest.approx(comparable(one, both))
    assert nats(both, one) == pytest.approx(-nats(one, both))
    assert nats(both, one) > 20


@pytest.mark.parametrize("seed", [1, 2])
def test_a_law_in_other_coefficients_is_as_likely(seed: int) -> None:
    """Its torque alone is bounded beforehand, so a spring may be k q + c0 about any position."""
    base, rng = terms(1), np.random.default_rng(seed)
    raw = rng.normal(size=(2, JOINTS, N))

    def evidence(columns: np.ndarray) -> float:
        into = independent(np.einsum("cjN,djN->cd", columns, columns) / N)
        return base.with_(np.tensordot(into.T, columns, 1)).fit(base.gap.rows).evidence

    mixed = np.tensordot(np.array([[1.0, 0.0], [40.0, 0.01]]), raw, 1)
    assert evidence(mixed) == pytest.approx(evidence(raw), abs=1e-6)


@pytest.mark.parametrize(
    ("share", "nothing", "rival", "expected"),
    [
        (0.009, 50.0, 50.0, "below"),
        (0.02, 5.0, 50.0, "undecidable"),
        (0.02, 6.0, 3.0, "ambiguous"),
        (0.02, 6.0, 3.1, "decidable"),
    ],
)
def test_classes(share: float, nothing: float, rival: float, expected: str) -> None:
    assert class_of(share, nothing, rival) == expected


@pytest.fixture(scope="module")
def planted() -> Callable[..., tuple[Known, Case, Log]]:
    """A log of 3r of six seconds with an effect planted, and what is known of it without."""
    robot, t = arm("3r"), torch.arange(0, 6, 0.01, dtype=torch.float64)
    phase = 2 * torch.pi * t.unsqueeze(1) * torch.tensor([[0.35, 0.5, 0.8]]).double()
    q = torch.sin(phase) * torch.tensor([0.8, 0.7, 0.9]).double()
    g = torch.Generator().manual_seed(0)
    still = Log(t, q, tau=q)
    motion = half_of(robot, still, None).columns.samples.segments[0].motion
    assert motion.t is not None
    motion = motion._replace(torque=model_torque(robot, [], motion))
    noise = 0.02 * torch.randn(q.shape, generator=g, dtype=torch.float64)

    def on_stamps(x: torch.Tensor) -> torch.Tensor:
        grid = motion.require("t", "a test") - motion.require("t", "a test")[0]
        return torch.from_numpy(
            np.stack([np.interp(t.numpy(), grid.numpy(), c) for c in x.T.numpy()], 1)
        )

    tau = on_stamps(motion.require("torque", "a test")) + noise
    log = still.replace(tau=tau)
    half: Half = half_of(robot, log, None)
    kept = [c for c in library(half) if c.effects[0].family in ("speed", "constant", "sign")]
    known = Known(half, kept)

    def make(**record: object) -> tuple[Known, Case, Log]:
        effect, values = effect_from_record(record, robot)
        added = on_stamps(effect.all_torques(motion, values, robot))
        key = {
            "effect": effect.name, "record": record, "size": 2.0,
            "joints": list(effect.joints), "felt_by": list(effect.joints),
        }  # fmt: skip
        case = Case(f"{effect.name}-2", key, (tau + added).numpy())
        return known, case, case.log(log)

    return make


def test_what_is_plainly_there_is_decidable(
    planted: Callable[..., tuple[Known, Case, Log]],
) -> None:
    known, case, log = planted(effect="torque_offset", joint=2, F0=0.5)
    found = classified(known, case, log, None)
    assert found["class"] == "decidable"
    assert found["over_nothing"] > 20
    assert found["over_nothing_held_out"] > 5


def test_what_is_not_there_is_below(planted: Callable[..., tuple[Known, Case, Log]]) -> None:
    known, case, log = planted(effect="torque_offset", joint=2, F0=1e-6)
    found = classified(known, case, log, None)
    assert found["class"] == "below"
    assert found["over_nothing"] < 5


def test_the_model_that_leaves_an_effect_open_cannot_tell_it(
    planted: Callable[..., tuple[Known, Case, Log]],
) -> None:
    """Base parameters that nobody vouches for take the place of a rotor's inertia."""
    known, case, log = planted(effect="rotor_inertia", joint=1, Ia=0.5)
    assert len(left_open(known.half).columns) > 5
    assert classified(known, case, log, None)["over_nothing"] < 3


def test_a_case_is_read_as_it_was_written(tmp_path, planted) -> None:  # type: ignore[no-untyped-def]
    _, case, _ = planted(effect="viscous_friction", joint=2, Fv=0.1)
    case = replace(case, dq=0 * case.tau)
    case.write(tmp_path)
    again = Case.read(tmp_path / "viscous_friction-2.npz")
    assert again.key == case.key
    assert np.array_equal(again.tau, case.tau)
    assert again.dq is not None
