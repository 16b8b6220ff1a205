"""All ways to sets with given base parameters, by their names.

The torque leaves most of a link's parameters open. Where nothing else is known, a search within
wide bounds answers any of the bodies that have it; `near` answers those nearest to what is expected
(nominal bodies, or of a robot of which the kinematics alone are known, typical ones) in the
entropic metric, among all with nearly the least error (`torchid.extraction.entropic`): the root of
the loss and, for the one-step loss, of what is left of the log's torque. Bodies of least error are
often flat or points, since noise asks for more than bodies can give. So each holds a share of the
expected one, the largest of `SHARES` at no price: the least error is then within `SPENT_SHARE` of
that of any bodies.
"""

import time
from dataclasses import replace
from typing import Literal

import torch

from torchid.errors import TorchidError
from torchid.extraction.convex.certificate import Certificate, certificate_where_possible
from torchid.extraction.entropic import (
    EXACT_SHARE,
    SPENT_SHARE,
    SPREAD,
    Quadratic,
    nearest_bodies,
    room_within,
)
from torchid.extraction.extract import extract, require_possible
from torchid.extraction.found import Found, best_set, judged
from torchid.extraction.problem import Problem
from torchid.extraction.settings import SearchSettings
from torchid.feasibility.sets import ParameterSets
from torchid.parallel.workers import Progress, Workers, stage
from torchid.robot.inertia import InertialParameters

SHARES = (1 / SPREAD, 1 / SPREAD**2, 0.0)
"""Shares of the expected body that each link may be asked to hold."""


def near_set(problem: Problem, *, proof: Certificate | None = None) -> Found:
    """The set nearest to the expected bodies with nearly the least loss.

    Bounds of masses and boxes of the centres of mass are kept, and coefficients the sign that
    physics gives them; bounds of inertias and of coefficients are not, which `from-robot`, `wide`
    and `none` derive from the others.

    Args:
        problem: loss, bounds and conditions.
        proof: its certificate, put beside the set.

    Raises:
        TorchidError: conditions on cylinders, spheres or the total mass, which this does not keep;
            boxes of the centres of mass that exclude those of the bounds.

    >>> from torchid import load_robot, problem_of
    >>> from torchid.identification.values import nominal_base
    >>> robot = load_robot("3r")
    >>> problem, _ = problem_of(robot, nominal_base(robot), bounds="none")
    >>> found = near_set(problem)
    >>> bool(found.verdict.feasible.all()), bool(found.torque.max() < 0.01)
    (True, True)
    """
    began = time.perf_counter()
    asked, target = problem.conditions, problem.target
    others = {
        "shapes": bool(torch.isfinite(asked.round_radius).any()),
        "total mass": bool(torch.isfinite(asked.total_mass).any()),
    }
    if any(others.values()):
        raise TorchidError(
            "bodies near to expected ones keep bounds of masses and centres of mass only.",
            got=", ".join(name for name, there in others.items() if there),
            expected="no such condition",
            hint='`method="sdp"` keeps them',
        )
    low = torch.maximum(problem.bounds.com[..., 0], asked.com_box[..., 0])
    high = torch.minimum(problem.bounds.com[..., 1], asked.com_box[..., 1])
    if not bool((low < high).all()):
        link = int((low >= high).any(-1).nonzero()[0])
        raise TorchidError(
            f"the bounds '{problem.bounds.name}' leave no room for a centre of mass.",
            got=f"link {link + 1}, whose box of the centre of mass is elsewhere",
            expected="boxes that overlap",
            hint="other `bounds=...` or `geometry=...`",
        )
    columns, offset = target.matrix_by_link.double(), target.offset.double()
    square = float(offset @ offset) + target.left**2
    signs = torch.eye(len(problem.non_negative)).double()[problem.non_negative]
    loss = Quadratic(columns.T @ columns, columns.T @ offset, square, signs)
    room = room_within(problem.robot, problem.bounds.mass, torch.stack([low, high], -1))
    tried = [
        nearest_bodies(loss, replace(room, least=room.least + share * room.nominal))
        for share in SHARES
    ]
    enough = (1 + SPENT_SHARE) * max(tried[-1].least, (EXACT_SHARE * square) ** 0.5)
    best = next(one for one in tried if one.least <= enough or one is tried[-1])
    sets = ParameterSets(
        ("near",),
        InertialParameters(best.pi.unsqueeze(0)),
        target.effects,
        best.coefficients.unsqueeze(0),
    )
    return judged(problem, "near", sets, time.perf_counter() - began, proof=proof)


Method = Literal["cma-es", "sdp", "near"]


def found_by(
    method: Method,
    problem: Problem,
    settings: SearchSettings,
    *,
    certificate: bool = True,
    search_anyway: bool = False,
    device: torch.device | str = "cpu",
    workers: Workers = 1,
    progress: Progress | None = None,
) -> Found:
    """Sets by one method, with the certificate of the problem.

    Args:
        method: population search, convex optimum, or the bodies nearest to expected ones.
        problem: loss, bounds and conditions, from `problem_of`.
        settings: of the search.
        certificate: whether the least loss possible is put beside it.
        search_anyway: also where no point of the bounds can be feasible.
        device, workers: of a population search; see `extract`.
        progress: called with (stage, done, total).

    Raises:
        TorchidError: no set can be feasible, or as the method raises.
    """

    def running(name: str) -> None:
        if progress is not None:
            progress(name, 0, 0)

    if settings.penalty == "full" and not search_anyway:
        require_possible(problem)
    proof, notes = None, tuple[str, ...]()
    if certificate or method == "sdp":
        running("the certificate")
        proof, notes = certificate_where_possible(problem)
    if method == "sdp":
        running("the best set")
        extraction = best_set(problem, proof=proof, search_anyway=search_anyway)
    elif method == "near":
        running("the nearest bodies")
        extraction = near_set(problem, proof=proof)
    else:
        extraction = extract(
            problem, settings, device=device, workers=workers, report=stage(progress, "stages"),
        ).found  # fmt: skip
    return replace(extraction, proof=proof, warnings=(*notes, *extraction.warnings))
