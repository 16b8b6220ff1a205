"""A first answer while the search goes on: each joint's gap, and what explains most of it so far.

Its errors are those of the fit, on the data that were fitted, below the fit's cut-off.
"""

from collections.abc import Callable

import numpy as np

from torchid.gap.causes.candidates import Term
from torchid.gap.causes.evidence import Fit
from torchid.gap.causes.search import Search
from torchid.results.answer import Answer
from torchid.results.cause import LINK, Cause
from torchid.robot.model import Robot, torque_unit

Watch = Callable[[Answer], None]
"""Takes what is known so far."""


def telling(watch: Watch, robot: Robot) -> Callable[[Search, Fit], None]:
    """What a search calls so that somebody is told what is known so far."""
    return lambda search, fit: watch(so_far(search, fit, robot))


def so_far(search: Search, fit: Fit, robot: Robot) -> Answer:
    """What a fit that is not finished says."""
    empty = search.evidence.fit((), fit.samples)
    before, after = (search.library.rms(search.evidence.left(f)) for f in (empty, fit))
    levels = zip(robot.joint_names, before.tolist(), after.tolist(), strict=True)
    whole = float(np.linalg.norm(before)), float(np.linalg.norm(after))
    causes = (_cause(t, x.tolist()) for t, x in zip(fit.terms, fit.values(), strict=True))
    return Answer.so_far("the gap", torque_unit(robot), whole, levels, causes)


def _cause(term: Term, values: list[float]) -> Cause:
    """A term of a fit."""
    if term.effect is None or term.inertial:
        return Cause(effect=LINK, joints=term.joints)
    pairs = list(zip(term.effect.coefficients, values, strict=False))
    return Cause(
        effect=term.name, joints=term.joints, parameters={c.name: v for c, v in pairs},
        std=dict.fromkeys(c.name for c, _ in pairs), unit={c.name: c.unit for c, _ in pairs},
    )  # fmt: skip
