"""Results compared, as their JSON has them: the schema torchid.compare/2."""

from typing import Annotated, Literal

from msgspec import UNSET, UnsetType, field

from torchid.fleet.record import Spread
from torchid.results.record import Col, Part, Real, Record, Rows
from torchid.results.words import short
from torchid.typing import Float, Tensor

Kind = Literal["identifications", "gap diagnoses", "position diagnoses", "parameter sets"]
Verdict = Literal["differ", "agree", "never_determined", "not_compared"]
State = Literal["named", "not_testable", "not_found"]
WORDS: dict[Verdict, str] = {
    "differ": "differs",
    "agree": "agrees",
    "never_determined": "undetermined",
    "not_compared": "not tested",
}


class TorqueSpread(Part, frozen=True):
    """Torque of m models on one motion [N m; N].

    Attributes:
        source: of the motion, in words.
        size: (n,) RMS of the models' mean.
        spread: (n,) standard deviation between models, RMS over the motion.
        claimed: (n,) RMS of the standard deviation that the parameters' covariances claim for a
            model's torque; None where there are none.
        errors: (m, n) RMS of the measured torque minus each model's; None without a log.
    """

    source: str = field(name="on")
    size: Float[Tensor, " n"] = field(name="rms")
    spread: Float[Tensor, " n"]
    claimed: Float[Tensor, " n"] | None = field(name="claimed_std", default=None)
    errors: Float[Tensor, "m n"] | None = None


class PositionErrors(Part, frozen=True):
    """RMS position errors of m diagnosed arms along a log [thousandths of its unit].

    Attributes:
        source: of the motion, in words.
        unit: of the errors.
        whole: (m, n) whole motions from their measured start; nan of joints that never move.
        windows: (m, n) windows of 2 s.
    """

    source: str = field(name="on")
    unit: str
    whole: Float[Tensor, "m n"]
    windows: Float[Tensor, "m n"] = field(name="windows_2s")


class ComparedParameter(Spread, frozen=True, kw_only=True):
    """One coefficient in m results, of units of one type or of one unit.

    Attributes:
        cause: of a coefficient of a diagnosis, e.g. `coulomb_friction of joint 2`; else empty.
        verdict: `differ`: the test of equal values rejects them; `never_determined`: relative
            standard deviation above 50 % in every result that has it; `not_compared`: fewer than
            two results give it with a standard deviation; else `agree`.
        own, own_std: (m,) of each result; nan where it has none. A value that a fit held, e.g. at
            zero, has no standard deviation.
        p: of Welch's test that all values are equal, adjusted for the number of coefficients.
    """

    name: Annotated[str, Col("coefficient", words=lambda name: short(name, 22))]
    cause: Annotated[str, Col("of")]
    verdict: Annotated[Verdict, Col(words=WORDS.__getitem__)]
    own: Float[Tensor, " m"]
    own_std: Float[Tensor, " m"]
    p: Annotated[Real, Col(digits=".1g")] = field(name="p_adjusted")


class ComparedCause(Part, frozen=True, kw_only=True):
    """One cause in m diagnoses: effects at one place that name each other as alternatives.

    Attributes:
        label: their names and place, e.g. `coulomb_friction of joint 2`.
        states: (m,) what each diagnosis says.
        smallest: (m,) smallest detectable size, where it was not testable.
    """

    label: Annotated[str, Col("cause")]
    states: tuple[State, ...]
    smallest: tuple[float | None, ...] = field(name="smallest_detectable")


class Comparison(Record, frozen=True, kw_only=True, tag="torchid.compare/2"):
    """Results of one kind, compared.

    Attributes:
        robot: its name, or names.
        kind: of the results.
        labels, about: (m,) of the results, in the order given: names, and a few words.
        parameters: every coefficient that any result has.
        causes: of diagnoses, those that most name first.
        torque: None where the models are not known.
        positions: of diagnoses of positions along a log; absent without one.
        notes: sentences for the user.
        seed: from a command.
    """

    robot: str
    kind: Kind
    labels: tuple[str, ...] = field(name="results")
    about: tuple[str, ...]
    parameters: tuple[ComparedParameter, ...]
    causes: tuple[ComparedCause, ...]
    torque: TorqueSpread | None
    notes: tuple[str, ...]
    positions: PositionErrors | UnsetType = UNSET
    seed: int | UnsetType = UNSET

    @property
    def table(self) -> Rows[ComparedParameter]:
        """The coefficients."""
        return Rows(self.parameters)

    def having(self, *verdicts: Verdict) -> list[ComparedParameter]:
        """Coefficients of these verdicts."""
        return [p for p in self.parameters if p.verdict in verdicts]
