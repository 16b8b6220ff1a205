"""The identification as an estimator of scikit-learn: its cross-validation, grids and pipelines."""

from collections.abc import Sequence

import numpy as np
import torch
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin
from sklearn.utils.validation import check_array, check_is_fitted, check_X_y

from torchid.effects.base import Motion
from torchid.effects.names import DEFAULT_EFFECTS
from torchid.errors import TorchidError
from torchid.identification.asked import asked_effects
from torchid.identification.base_parameters import base_parameters, non_negative, stacked_regressor
from torchid.identification.least_squares import solve, stacked_factor, undetermined_columns
from torchid.identification.model import model_torque
from torchid.inputs import RobotLike, as_robot
from torchid.typing import Bool, Float, Tensor

_PIECE = 4096
"""Rows whose regressor is in memory at a time."""


class FeatureError(TorchidError, ValueError):
    """Features or targets that are not those of the robot's joints."""


class DynamicsRegressor(RegressorMixin, MultiOutputMixin, BaseEstimator):
    """Torque of a robot from its motion, by base parameters and effects.

    X holds q, dq, ddq side by side, (T, 3 n) [rad, rad/s, rad/s^2; m of prismatic joints], and y
    the torques (T, n) [N m; N]. Every row stands for itself, in any order: filter and differentiate
    before, and keep the rows of a trajectory together when validating (`GroupKFold`).
    `torchid.identify` does all that by itself, and gives standard deviations.

    Args:
        robot: kinematics, as a Robot, by name or by file; its masses are not used.
        effects: beside the rigid body: names, as of `torchid.Settings`, without shapes to search.
        bounded: hold coefficients that physics forbids to be negative at zero or above.

    Attributes:
        coef_: (B,) base parameters and coefficients.
        names_, units_: of each of them.
        n_features_in_: 3 n.

    >>> import numpy as np, torchid
    >>> robot = torchid.load_robot("3r")
    >>> X = np.random.default_rng(1).normal(size=(400, 9))
    >>> y = torchid.inverse_dynamics(robot, *np.split(X, 3, axis=1)).numpy()
    >>> model = DynamicsRegressor("3r").fit(X[:200], y[:200])
    >>> len(model.coef_), round(model.score(X[200:], y[200:]), 6)
    (25, 1.0)
    """

    def __init__(
        self,
        robot: RobotLike = "3r",
        effects: Sequence[str] = DEFAULT_EFFECTS,
        bounded: bool = True,
    ):
        self.robot = robot
        self.effects = effects
        self.bounded = bounded

    def fit(self, X: np.ndarray, y: np.ndarray) -> "DynamicsRegressor":
        """Fit to motions (T, 3 n) and torques (T, n), each joint weighted by what it leaves.

        Raises:
            RobotError: no such robot.
            FeatureError: other columns than those of the robot's joints, or no numbers.
            TorchidError: effects that there are not, or whose shape would have to be searched.
        """
        robot = as_robot(self.robot)
        X, y = check_X_y(X, y, multi_output=True, y_numeric=True, dtype=np.float64)
        _require(X, 3 * robot.n, f"q, dq and ddq of the {robot.n} joints of '{robot.name}'")
        tau = torch.as_tensor(y, dtype=torch.float64).reshape(len(X), -1)
        _require(tau, robot.n, f"torques of the {robot.n} joints of '{robot.name}'")
        asked = asked_effects(tuple(self.effects), robot)
        searched = [a.effect.name for a in asked if not a.plain]
        if searched:
            raise TorchidError(
                "these effects have a shape to be searched: `torchid.identify` does.", got=searched
            )
        effects = tuple(a.effect for a in asked)
        base = base_parameters(robot, effects)
        columns = list(base.independent)
        # One triangular factor of [Y tau] a joint: rows need not be in memory together.
        factors = tau.new_zeros(robot.n, 0, len(columns) + 1)
        for first in range(0, len(X), _PIECE):
            part = slice(first, first + _PIECE)
            rows = stacked_regressor(robot, effects, _motion(X[part]))[:, columns]
            rows = torch.cat([rows, tau[part].reshape(-1, 1)], 1)
            rows = rows.unflatten(0, (-1, robot.n)).movedim(1, 0)
            factors = torch.linalg.qr(torch.cat([factors, rows], 1), mode="r").R
        signs = non_negative(base, effects) & self.bounded
        solved = _solved(factors, signs)
        left = (factors @ torch.cat([solved, solved.new_tensor([-1.0])])).norm(dim=1)
        size = factors[:, :, -1].norm(dim=1)
        solved = _solved(
            factors / left.clamp(min=1e-9 * float(size.max()) + 1e-300)[:, None, None], signs
        )
        self._model = robot, base, effects
        self.coef_, self.names_, self.units_ = solved.numpy(), base.names, base.units
        self.n_features_in_, self._flat = 3 * robot.n, y.ndim == 1
        return self

    def predict(self, X: np.ndarray) -> np.ndarray:
        """Torques (T, n) [N m; N] along motions (T, 3 n).

        Raises:
            sklearn.exceptions.NotFittedError: `fit` has not been called.
            FeatureError: other columns than those of the robot's joints.
        """
        check_is_fitted(self)
        X = check_array(X, dtype=np.float64)
        _require(X, self.n_features_in_, f"{self.n_features_in_} features as input")
        tau = model_torque(*self._model, torch.from_numpy(self.coef_), _motion(X)).numpy()
        return tau[:, 0] if self._flat else tau


def _motion(X: np.ndarray) -> Motion:
    return Motion(*torch.from_numpy(X).tensor_split(3, dim=1))


def _require(table: np.ndarray | Tensor, columns: int, what: str) -> None:
    if table.shape[1] != columns:
        raise FeatureError(
            f"X has {table.shape[1]} features, but DynamicsRegressor is expecting {what}.",
            got=tuple(table.shape),
            expected=f"(samples, {columns})",
        )


def _solved(factors: Float[Tensor, "n r c"], signs: Bool[Tensor, " B"]) -> Float[Tensor, " B"]:
    """Least squares of all joints; what the rows do not tell is 0."""
    rows = stacked_factor([factors.flatten(0, 1)])
    return solve(rows, signs, undetermined_columns(rows, torch.zeros_like(signs)))[0]
