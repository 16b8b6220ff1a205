"""Whether the parameters can belong to a real arm, in the labels of `torchid check`."""

from torchid.errors import TorchidError
from torchid.export.dynamics import Dynamics
from torchid.feasibility.findings import by_percent
from torchid.feasibility.record import Check


def require_feasible(dynamics: Dynamics, found: Check) -> None:
    """Raise TorchidError where the parameters are infeasible: why, and what to do."""
    reasons = found.feasibility.reasons(0)
    if not reasons:
        return
    if dynamics.kind == "base parameters":
        hint = (
            "many sets have these base parameters, and the one nearest to the robot's own is no "
            "body's: `torchid extract ROBOT RESULT --out DIR` finds feasible ones, of which "
            "`torchid export DIR/extraction.json` takes the best; --to csv and --to c need none"
        )
    else:
        hint = (
            "`torchid check ... --nearest FILE` writes the feasible set nearest in torque; "
            "--geometry none asks for physics alone; --force writes it as it is"
        )
    raise TorchidError(
        f"{dynamics.title}: infeasible, so not exported.",
        got="; ".join(explained(found, reason) for reason in reasons),
        expected="a set that a real arm can have",
        hint=hint,
    )


def explained(found: Check, reason: str) -> str:
    """A label with its evidence: `inertia_3 (triangle inequality broken, by 4 %)`."""
    kind, _, place = reason.rpartition("_")
    parameters = found.sets.parameters
    if kind == "inertia":
        link = int(place) - 1
        values = found.eigenvalues[0, link].tolist()
        if found.feasibility.inertia_violation(0, link) == "eigenvalue":
            return f"{reason} (not positive definite: {values[0]:.3g} kg m^2)"
        return f"{reason} (breaks the triangle inequality{by_percent(values)})"
    if kind == "mass":
        return f"{reason} ({float(parameters.mass[0, int(place) - 1]):.3g} kg)"
    if kind == "com":
        link, axis = int(place[:-1]) - 1, "xyz".index(place[-1])
        low, high = found.conditions.com_box[link, axis].tolist()
        at = float(parameters.com[0, link, axis])
        return f"{reason} ({at:.3g} m, outside {low:.3g} to {high:.3g})"
    return reason
