"""The estimator keeps scikit-learn's protocol, and finds what the identification finds."""

import pickle
from typing import Any

import numpy as np
import pytest
import torch
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.model_selection import GridSearchCV, GroupKFold, cross_val_score

import torchid
from torchid.errors import TorchidError
from torchid.identification.estimator import DynamicsRegressor, FeatureError
from torchid.robot.yaml_file import from_mapping

checks = pytest.importorskip("sklearn.utils.estimator_checks")

PENDULUM = from_mapping(
    {
        "name": "pendulum",
        "dh": {"convention": "classical", "joints": [{"a": 0.3, "alpha": 0.0, "d": 0.0}]},
        "gravity": [0.0, -9.81, 0.0],
    },
    "pendulum.yaml",
)
"""One joint: the checks that make three features fit it."""

OTHER_FEATURES = "its features are q, dq and ddq of one joint: the check makes another number"
EXPECTED = dict.fromkeys(
    (
        "check_estimators_overwrite_params", "check_estimators_fit_returns_self",
        "check_readonly_memmap_input", "check_n_features_in_after_fitting",
        "check_positive_only_tag_during_fit", "check_estimators_dtypes", "check_dtype_object",
        "check_regressors_train", "check_regressor_data_not_an_array",
        "check_regressors_no_decision_function", "check_regressors_int", "check_fit_idempotent",
        "check_fit_check_is_fitted", "check_n_features_in", "check_fit2d_1sample",
        "check_fit2d_1feature",
    ),
    OTHER_FEATURES,
) | {"check_regressor_multioutput": "two targets would be the torques of two joints"}  # fmt: skip


@pytest.mark.skipif(
    not hasattr(checks, "estimator_checks_generator"), reason="checks as of scikit-learn 1.6"
)
@pytest.mark.filterwarnings("ignore")
def test_protocol_of_scikit_learn() -> None:
    """Every check passes but those that make other features than a robot has: these fail for that
    reason and no other."""
    results = checks.check_estimator(DynamicsRegressor(PENDULUM), on_fail=None, on_skip=None)
    failed = {r["check_name"]: str(r["exception"]) for r in results if r["status"] == "failed"}
    assert failed.keys() <= EXPECTED.keys()
    assert sum(r["status"] == "passed" for r in results) > 30
    reasons = ("X has", "FeatureError", "should contain one of")
    assert all(any(reason in text for reason in reasons) for text in failed.values()), failed


@pytest.fixture(scope="module")
def motion() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Motions, torques and trajectories of an arm with friction, with a little noise."""
    robot, generator = torchid.load_robot("3r_friction"), np.random.default_rng(3)
    X = generator.normal(size=(600, 9))
    log = torchid.Log(0.01 * np.arange(600), *np.split(X, 3, axis=1))
    tau = torchid.simulate(robot, log, noise=None).tau
    assert tau is not None
    y = tau.numpy() + 1e-3 * generator.normal(size=tau.shape)
    return X, y, np.repeat(np.arange(6), 100)


@pytest.mark.parametrize("form", ["name", "robot"])
def test_it_finds_the_base_parameters(motion: Any, form: str) -> None:
    X, y, _ = motion
    robot = torchid.load_robot("3r_friction")
    model = DynamicsRegressor("3r" if form == "name" else robot).fit(X, y)
    found = dict(zip(model.names_, model.coef_, strict=True))
    effects = [e for e in robot.effects if e["effect"] == "viscous_friction"]
    for effect in effects:
        assert found[f"Fv{effect['joint']}"] == pytest.approx(effect["Fv"], abs=2e-3)
    assert model.score(X, y) > 0.9999
    assert model.predict(X[:5]).shape == (5, 3)


def test_rows_need_no_order_and_no_single_pass(
    motion: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    X, y, _ = motion
    whole = DynamicsRegressor("3r").fit(X, y)
    monkeypatch.setattr("torchid.identification.estimator._PIECE", 77)
    order = np.random.default_rng(5).permutation(len(X))
    pieces = DynamicsRegressor("3r").fit(X[order], y[order])
    assert np.allclose(pieces.coef_, whole.coef_, rtol=1e-6, atol=1e-8)


def test_grids_groups_and_copies(motion: Any) -> None:
    X, y, groups = motion
    model = DynamicsRegressor("3r")
    scores = cross_val_score(model, X, y, groups=groups, cv=GroupKFold(3))
    assert (scores > 0.999).all()
    grid = GridSearchCV(model, {"effects": [(), ("viscous_friction", "coulomb_friction")]}, cv=2)
    assert grid.fit(X, y).best_params_["effects"] == ("viscous_friction", "coulomb_friction")
    fitted = model.set_params(effects=("viscous_friction",)).fit(X, y)
    assert clone(fitted).get_params() == fitted.get_params()
    again = pickle.loads(pickle.dumps(fitted))
    np.testing.assert_allclose(again.predict(X[:3]), fitted.predict(X[:3]), rtol=1e-12)


def test_a_sign_that_physics_forbids_is_bounded(motion: Any) -> None:
    X, y, _ = motion
    slippery = y - 0.8 * X[:, 3:6]
    for bounded in (True, False):
        model = DynamicsRegressor("3r", bounded=bounded).fit(X, slippery)
        low = min(c for n, c in zip(model.names_, model.coef_, strict=True) if n.startswith("Fv"))
        assert (low >= 0) == bounded


@pytest.mark.parametrize(
    ("columns", "targets", "text"), [(6, 3, "X has 6 features"), (9, 2, "torques of the 3 joints")]
)
def test_other_columns_are_refused(columns: int, targets: int, text: str) -> None:
    with pytest.raises(FeatureError, match=text) as refused:
        DynamicsRegressor("3r").fit(np.ones((50, columns)), np.ones((50, targets)))
    assert isinstance(refused.value, ValueError)


def test_what_cannot_be_fitted_is_refused(motion: Any) -> None:
    X, y, _ = motion
    with pytest.raises(TorchidError, match="shape to be searched"):
        DynamicsRegressor("3r", effects=("stribeck_friction",)).fit(X, y)
    with pytest.raises(TorchidError):
        DynamicsRegressor("no_such_robot").fit(X, y)
    with pytest.raises(NotFittedError):
        DynamicsRegressor("3r").predict(X)
    assert torch.get_default_dtype() == torch.float32
