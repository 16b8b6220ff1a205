"""How wide to randomise a simulator: draws of the robot from what is known of it, and their ranges.

What a diagnosis fitted has a covariance (block jackknife, all coefficients together), from which a
draw takes its coefficients; a model of a type has the spread of its units in its own.
Quasi-random normal points (Sobol, scipy) make a few hundred draws tell the ends of a range.

Bodies: torque knows base parameters only. Each draw's change of them is carried by the smallest
relative change of the bodies (the entropic metric's second derivative at the centre, see
torchid.extraction.entropic), and draws that no body has are drawn anew: the distribution is the one
that the log leaves, given that the arm exists. Where hardly any draw is a body, each has the bodies
that are nearest in torque and to the robot as given.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch

from torchid.design.bodies import INSIDE, usual_bodies
from torchid.dynamics.regressor import regressor
from torchid.effects.inertia import LinkInertia
from torchid.effects.registry import Valued, carrying, nominal_effects
from torchid.errors import TorchidError
from torchid.export.drawn_from import DrawnFrom, of_diagnosis, of_model
from torchid.export.dynamics import random_states, records
from torchid.export.projection import PRICE
from torchid.export.randomisation import (
    FIELDS,
    Draws,
    Randomisation,
    drawn_values,
    normal_points,
    range_row,
    sobol_points,
)
from torchid.export.randomise_positions import randomise_positions
from torchid.export.record import RangeRow
from torchid.extraction.entropic import NearBodies, Quadratic, nearest_bodies, room_of
from torchid.gap.record import Covariance, GapRecord
from torchid.identification.base_parameters import base_parameters
from torchid.inputs import RobotLike, as_robot
from torchid.position.record import PositionRecord
from torchid.robot.inertia import (
    PARAMETERS_PER_LINK,
    InertialParameters,
    paper_order,
    pseudo_inertia_basis,
)
from torchid.robot.model import JointType, Robot
from torchid.tensors import require_count
from torchid.typing import Bool, Float, Int, Tensor

BODY_FIELDS = {"mass": "kg", "com_x": "m", "com_y": "m", "com_z": "m"}

CANDIDATES = 8
"""Times as many points as draws are asked for, where bodies have to be found among them."""

NEARLY = 1e-3
"""Share of what is left of the log's torque that the centre's bodies may add to it."""


def randomise(
    found: GapRecord | PositionRecord | Robot,
    level: float = 0.95,
    *,
    robot: RobotLike | None = None,
    draws: int = 256,
    seed: int = 0,
) -> Randomisation:
    """Draws of a diagnosed robot, and the range of each field that holds a share of them.

    Args:
        found: a diagnosis (`torchid.load("gap.json")`, or `diagnosis.record`), of torques or of
            positions, or a robot whose model says how sure it is, after any number of sessions.
        level: share of the draws in each range.
        robot: whose bodies the drawn ones are near to: as given to the diagnosis; what that
            records, or the model's own, if None.
        draws: how many.
        seed: of the draws.

    Raises:
        TorchidError: a diagnosis in which nothing was fitted, or a model that does not say how sure
            it is; a level outside 0 to 1; another robot.

    >>> import torch, torchid
    >>> robot = torchid.load_robot("3r")
    >>> motion = torchid.excite(robot, duration=8.0, restarts=1, iterations=5).log()
    >>> arm = torchid.load_robot("3r_friction")
    >>> log = torchid.simulate(arm, motion, noise=torchid.HonestNoise(), seed=1)
    >>> known = ("viscous_friction", "coulomb_friction")
    >>> settings = torchid.GapSettings(effects=known)
    >>> wide = randomise(torchid.diagnose(robot, log, settings=settings).record)
    >>> {r.field for r in wide.ranges} == {"damping", "friction"}
    True
    """
    robot = None if robot is None else as_robot(robot)
    if not 0 < level < 1:
        raise TorchidError("the level is out of range.", got=level, expected="0..1, e.g. 0.95")
    require_count(draws, "robots", 2)
    if isinstance(found, PositionRecord):
        return randomise_positions(found, level, robot, draws, seed)
    if isinstance(found, Robot):
        source = of_model(found, robot, level)
    else:
        source = of_diagnosis(found, robot, level)
    centre, every, more = _drawn(source, draws, seed)
    fields, beside = drawn_values(every, centre)
    ranges = _ranges(fields, beside, every, centre, level)
    return Randomisation(
        centre.name, level, every, ranges, centre, centre.joint_names, source.bands,
        (*source.warnings, *more),
    )  # fmt: skip


def _drawn(source: DrawnFrom, draws: int, seed: int) -> tuple[Robot, Draws, list[str]]:
    """The centre, draws, and what is to be said of them."""
    given, near = source.given, _Near(source.given, source.left)
    told = _Explained.of(source.corrected, source.known)
    mean = near.centre(told.pi)
    said = near.words(mean, told.pi)
    count = draws * (CANDIDATES if bool(told.body.any()) else 1)
    steps = normal_points(sobol_points(count, max(1, told.root.shape[1]), seed))
    steps = steps[:, : told.root.shape[1]] @ told.root.T
    change = torch.zeros(count, told.pi.numel(), dtype=torch.float64)
    change.index_add_(1, told.at_body, steps[:, told.body])
    pi = near.moved(mean, change)
    # The first that are bodies; where too few are, of all draws the nearest bodies.
    are = _are_bodies(pi, INSIDE * usual_bodies(mean))
    kept, none = are.nonzero().flatten()[:draws], list[int]()
    if len(kept) < draws:
        kept = torch.arange(draws)
        none = (~are[:draws]).nonzero().flatten().tolist()
        for d in none:
            pi[d] = near.to(pi[d])
    anew = 0.0 if none else 1 - float(are[: int(kept.max()) + 1].double().mean())
    effects = tuple(told.effects(steps[d]) for d in kept.tolist())
    if none or anew > 0.05:
        said.append(
            f"{len(none)} of {draws} draws of base parameters belong to no body, and have the "
            "bodies nearest in torque and to the robot as given"
            if none
            else f"{100 * anew:.0f} % of the points that the log allows are no bodies and were "
            "drawn anew"
        )
        said[-1] += ": ranges of single fields hold mostly impossible robots, the draws do not"
    robot = given.with_parameters(InertialParameters(mean))
    every = Draws(pi[kept], effects, len(none), anew)
    return replace(robot, effects=records(told.effects(None))), every, said


@dataclass(frozen=True, eq=False)
class _Explained:
    """A model as it is drawn from.

    Attributes:
        pi: (10 n,) of its model, loads included.
        pairs: its effects but bodies.
        root: (K, R) of the covariance of its K coefficients and shapes.
        body, at_body: (K,) which coefficients are of bodies, and (those,) where in `pi`.
        places: per coefficient or shape (effect, coefficient) numbers among `pairs`, shapes behind
            coefficients; none of bodies.
    """

    pi: Float[Tensor, " P"]
    pairs: tuple[Valued, ...]
    root: Float[Tensor, "K R"]
    body: Bool[Tensor, " K"]
    at_body: Int[Tensor, " B"]
    places: tuple[tuple[tuple[int, int], ...], ...]

    @staticmethod
    def of(model: Robot, fit: Covariance) -> "_Explained":
        """Of a corrected model, and how well its coefficients are known."""
        pairs, others = nominal_effects(model), list[Valued]()
        robot, known = model, dict[tuple[str, str], tuple[int, int | None]]()
        for link in range(model.n_links):
            names = LinkInertia(link).coefficient_names()
            known |= {(LinkInertia.name, x): (10 * link + k, None) for k, x in enumerate(names)}
        for effect, values in pairs:
            names = [*effect.coefficient_names(), *effect.shape_names()]
            own = [(effect.name, name) for name in names]
            if (own_link := effect.body(model)) is not None:
                robot = carrying(robot, [(effect, values)])
                first = PARAMETERS_PER_LINK * own_link
                known |= {key: (first + k, None) for k, key in enumerate(own)}
            else:
                known |= {key: (len(others), k) for k, key in enumerate(own)}
                others.append((effect, list(values)))
        keys = [[(c.effect, name) for name in c.names] for c in fit.coefficients]
        sizes, axes = torch.linalg.eigh(fit.matrix.double())
        root = axes * sizes.clamp(min=0).sqrt()
        at = [[known[key] for key in own if key in known] for own in keys]
        body = [bool(own) and own[0][1] is None for own in at]
        return _Explained(
            robot.require_parameters("a randomisation").pi.double().flatten(),
            tuple(others),
            root,
            torch.tensor(body, dtype=torch.bool),
            torch.tensor([own[0][0] for own, b in zip(at, body, strict=True) if b]).long(),
            tuple(
                tuple((i, c) for i, c in own if c is not None) if not b else ()
                for own, b in zip(at, body, strict=True)
            ),
        )

    def effects(self, step: Float[Tensor, " K"] | None) -> tuple[Valued, ...]:
        """The effects with coefficients and shapes a step away, which keep the signs that physics
        asks for."""
        values = [list(v) for _, v in self.pairs]
        shapes: list[dict[str, float]] = [{} for _ in self.pairs]
        for own, by in zip(self.places, [] if step is None else step.tolist(), strict=False):
            for i, c in own:
                effect, count = self.pairs[i][0], len(values[i])
                if c < count:
                    values[i][c] += by
                    continue
                shape, value = effect.shapes[c - count], effect.shape_values[c - count]
                # What is refined in ratios stays on its side of zero.
                ratio = shape.logarithmic
                shapes[i][shape.name] = value * math.exp(by / value) if ratio else value + by
        for (effect, _), v in zip(self.pairs, values, strict=True):
            signed = [c.non_negative for c in effect.coefficients]
            v[:] = [max(0.0, x) if s else x for x, s in zip(v, signed, strict=True)]
        pairs = zip(self.pairs, shapes, values, strict=True)
        return tuple((replace(e, **to), v) for (e, _), to, v in pairs)


def _are_bodies(pi: Float[Tensor, "*D n 10"], least: Float[Tensor, "n 10"]) -> Bool[Tensor, "*D"]:
    """Whether all links are bodies that hold at least these."""
    rest = InertialParameters(pi - least).pseudo_inertia
    return (torch.linalg.cholesky_ex(rest)[1] == 0).all(-1)


class _Near:
    """Bodies near the robot as given with nearly the torque of parameters, joint by joint in units
    of what is left of the log's torque, at random states.

    Args:
        given: the robot.
        left: (n,) torque that is left, RMS [N m; N].
    """

    def __init__(self, given: Robot, left: Float[Tensor, " n"]):
        motion, n, order = random_states(given, 0), given.n, paper_order(given.n_links)
        self.left, self.room = left, room_of(given)
        rows = torch.empty(len(motion.q), n, PARAMETERS_PER_LINK * n, dtype=torch.float64)
        rows[..., order] = regressor(given, motion.q, motion.dq, motion.ddq)
        self.rows = rows / left.unsqueeze(-1)
        self.matrix = self.rows.flatten(0, 1)
        self.square = self.matrix.T @ self.matrix
        base = base_parameters(given)
        self.grouping = torch.zeros(len(base), PARAMETERS_PER_LINK * n, dtype=torch.float64)
        self.grouping[:, order] = base.grouping
        self.last: NearBodies | None = None

    def to(self, pi: Float[Tensor, "n 10"]) -> Float[Tensor, "n 10"]:
        """The nearest bodies; the first answer is where the search for the others begins."""
        y = self.matrix @ pi.flatten()
        # What is left anyway is one on each row, beside which the bodies' part counts.
        whole, none = float(y @ y) + len(y), torch.zeros(0, 0).double()
        asked = Quadratic(self.square, self.matrix.T @ y, whole, none)
        if self.last is None:
            self.last = nearest_bodies(asked, self.room, spent=NEARLY)
            if self.last.error > (1 + PRICE) * len(y) ** 0.5:
                self.room = self.room.bodies_alone
                self.last = nearest_bodies(asked, self.room, spent=NEARLY)
        return nearest_bodies(asked, self.room, near=self.last).pi

    def centre(self, pi: Float[Tensor, " P"]) -> Float[Tensor, "n 10"]:
        """Bodies with just the torque of parameters, or those nearest to it."""
        whole = pi.view(-1, PARAMETERS_PER_LINK)
        if bool(_are_bodies(whole, INSIDE * usual_bodies(whole))):
            return whole
        near = self.to(whole)
        exact = self.moved(near, (pi - near.flatten()).unsqueeze(0))[0]
        return exact if bool(_are_bodies(exact, INSIDE * usual_bodies(exact))) else near

    def moved(
        self, centre: Float[Tensor, "n 10"], change: Float[Tensor, "D P"]
    ) -> Float[Tensor, "D n 10"]:
        """A centre with the base parameters of changes, by the smallest relative change of bodies:
        M^-1 G' (G M^-1 G')^-1 G, M the second derivative of the entropic metric there."""
        near = InertialParameters(centre + usual_bodies(centre)).pseudo_inertia
        inner = torch.linalg.inv(torch.linalg.cholesky(near)).unsqueeze(1)
        units = inner @ pseudo_inertia_basis() @ inner.mT
        metric = torch.block_diag(*torch.einsum("naij,nbij->nab", units, units))
        back = torch.linalg.solve(metric, self.grouping.T)
        spread = back @ torch.linalg.pinv(self.grouping @ back, hermitian=True, rtol=1e-13)
        return centre + (change @ (spread @ self.grouping).T).view(-1, *centre.shape)

    def words(self, centre: Float[Tensor, "n 10"], pi: Float[Tensor, " P"]) -> list[str]:
        """A sentence on how far a centre's torque is from the parameters', if it is far."""
        off = (self.rows @ (centre.flatten() - pi)).square().mean(0).sqrt()
        worst = int(off.argmax())
        size, share = float(off[worst] * self.left[worst]), 100 * float(off[worst])
        return [
            f"the corrected parameters belong to no body: the nearest bodies' torque is up to "
            f"{size:.2g} off on joint {worst + 1} (RMS at random states), {share:.0f} % of the "
            "log's remainder there"
        ] * int(off[worst] > PRICE)


def _ranges(
    fields: Mapping[str, Float[Tensor, "D n"]],
    beside: Sequence[tuple[str, str, Float[Tensor, " D"]]],
    every: Draws,
    centre: Robot,
    level: float,
) -> tuple[RangeRow, ...]:
    """Of everything in which draws differ."""
    out = []

    def row(field: str, name: str, unit: str, x: Float[Tensor, " D"]) -> None:
        spread = float(x.max() - x.min())
        if spread <= 1e-9 * float(x.abs().max()):
            return
        why = f"one standard deviation is {float(x.std()):.2g} {unit} by the log."
        out.append(range_row(field, name, unit, x, level, float(x.median()), why))

    for field, x in fields.items():
        kind, c = FIELDS[field]
        for j, name in enumerate(centre.joint_names):
            coefficient = kind.coefficients[c]
            unit = coefficient.unit_for(centre.joint_types[j] is JointType.PRISMATIC)
            row(field, name, unit, x[:, j])
    bodies = InertialParameters(every.pi)
    values = torch.cat([bodies.mass.unsqueeze(-1), bodies.com], -1)
    for k, (field, unit) in enumerate(BODY_FIELDS.items()):
        for j, name in enumerate(centre.link_names):
            row(field, name, unit, values[:, j, k])
    for name, unit, x in beside:
        row(name.rpartition(" ")[0], name, unit, x)
    return tuple(out)
