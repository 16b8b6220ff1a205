"""How well the coefficients and shapes of causes are known, all of them together."""

from torchid.effects.inertia import LinkInertia
from torchid.effects.registry import EVENTS
from torchid.gap.describe.model import Part, Solution
from torchid.gap.record import Coefficient, Covariance
from torchid.gap.wanted import BASE
from torchid.results.cause import LINK
from torchid.robot.inertia import PARAMETERS_PER_LINK


def covariance_of(solution: Solution) -> Covariance | None:
    """Of a solution's coefficients and free shapes, without those of what happened once; None where
    nothing was fitted."""
    if not len(solution.covariance):
        return None
    coefficients: list[Coefficient] = []
    lasting: list[int] = []
    for k, part in enumerate(solution.parts):
        if not any(e.name in EVENTS for e in part.effects):
            lasting += range(*solution.at(k).indices(len(solution.a)))
            name = LINK if part.name == BASE else part.name
            coefficients += [Coefficient(effect=name, names=x) for x in _names(part)]
    for k, shape in enumerate(solution.shapes, len(solution.a)):
        if shape.effect.name not in EVENTS:
            lasting.append(k)
            coefficients.append(Coefficient(effect=shape.effect.name, names=(shape.known,)))
    matrix = solution.covariance[lasting][:, lasting]
    return Covariance(coefficients=tuple(coefficients), matrix=matrix)


def _names(part: Part) -> list[tuple[str, ...]]:
    """Names of each coefficient: bodies' by link; of one that joints share all of theirs."""
    if part.effects:
        return list(zip(*(e.coefficient_names() for e in part.effects), strict=True))
    assert part.rows is not None
    places = (divmod(row, PARAMETERS_PER_LINK) for row in part.rows.tolist())
    return [(LinkInertia(link).coefficient_names()[c],) for link, c in places]
