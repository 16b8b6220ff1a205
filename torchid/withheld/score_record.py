"""A scored set as its JSON has it: the schema torchid.withheld.score/1."""

from torchid.results.record import Part, Record, Rows

Interval = tuple[float, float]


class Rate(Part, frozen=True, kw_only=True):
    """A share of cases with its 95 % interval; None of nothing."""

    hits: int
    total: int
    share: float | None
    ci95: Interval


class F1(Part, frozen=True, kw_only=True):
    """F1 of (effect, joint) over all cases together."""

    f1: float | None
    ci95: Interval | None
    hits: int
    extra: int
    missed: int
    cases: int


class MedianScore(Part, frozen=True, kw_only=True):
    """A median over cases."""

    median: float | None
    ci95: Interval | None
    cases: int


class Naming(Part, frozen=True, kw_only=True):
    """Of cases with one effect: whether it is seen, named first, in the set, anywhere, by family,
    and exactly; how large the set is."""

    detected: Rate
    top1: Rate
    in_set: Rate
    anywhere: Rate
    family: Rate
    exact: Rate
    set_size: float | None


class Single(Naming, frozen=True, kw_only=True):
    """The same by effect and by noise."""

    by_effect: dict[str, Naming]
    white: Naming
    coloured: Naming
    growing: Naming


class Sureness(Part, frozen=True, kw_only=True, rename={"low": "from", "high": "to"}):
    """How often names are right that were given with probabilities alike."""

    low: float
    high: float
    mean: float
    hits: int
    total: int
    share: float | None
    ci95: Interval


class Reliability(Part, frozen=True, kw_only=True):
    """Of the probabilities that names were given with (Brier 1950)."""

    brier: float | None
    names: int
    curve: tuple[Sureness, ...]


class Parameters(Part, frozen=True, kw_only=True):
    """Of cases where only inertial parameters are wrong."""

    structural: Rate
    found: Rate
    parametric_only: Rate


class Several(Part, frozen=True, kw_only=True):
    """Of cases with several effects, alternatives counting or not."""

    with_sets: F1
    strict: F1


class Outside(Part, frozen=True, kw_only=True):
    """Of cases with a cause that the library lacks."""

    confident_wrong: Rate
    verdicts: dict[str, int]
    by_cause: dict[str, dict[str, int]]


class Poor(Part, frozen=True, kw_only=True):
    """Of cases that excite too little."""

    honest: Rate
    not_testable_or_hedged: Rate
    verdicts: dict[str, int]


class Closing(Part, frozen=True, kw_only=True):
    """How much of what could be closed is."""

    closed: MedianScore
    oracle: MedianScore
    ratio: MedianScore
    oracle_closes_nothing: int


class Coverage(Part, frozen=True, kw_only=True):
    """Whether 95 % intervals hold the truth."""

    closed: Rate
    coefficients: Rate


class Detected(Part, frozen=True, kw_only=True):
    """Shares detected and named at one size."""

    level: float
    size: float | None
    detected: Rate
    named: Rate


class Scores(Part, frozen=True, kw_only=True):
    """All scores of one method; see torchid.withheld.score."""

    false_alarms: dict[str, Rate]
    parameters: Parameters
    single: Single
    single_clear: Naming
    wrong_for_sure: Rate
    how_sure: Reliability
    joints: F1
    several: dict[str, Several]
    outside: Outside
    poor: Poor
    closing: Closing
    coverage: Coverage
    status: dict[str, dict[str, int]]
    confusion: dict[str, dict[str, int]]
    confusion_outside: dict[str, dict[str, int]]
    detection: dict[str, tuple[Detected, ...]]
    errors: tuple[str, ...]
    seconds_median: float | None


class PlantedThere(Part, frozen=True, kw_only=True):
    """A cause that is there; joints from 1."""

    name: str
    joints: tuple[int, ...]
    size: float | None


class NamedThere(Part, frozen=True, kw_only=True):
    """A cause that was named; joints from 1."""

    name: str
    joints: tuple[int, ...]
    ambiguous_with: tuple[str, ...]


class ScoredAnswer(Part, frozen=True, kw_only=True):
    """One case, for the reader who wants to know what went wrong."""

    case: str
    kind: str
    arm: str | None
    rate_hz: float | None
    colour_hz: float | None
    repeats: bool | None
    level: float | None
    planted: tuple[PlantedThere, ...]
    status: str
    named: tuple[NamedThere, ...]
    closed: float
    right: bool
    seconds: float | None


class ScoreRecord(Record, frozen=True, kw_only=True, tag="torchid.withheld.score/1"):
    """A scored set; see torchid.withheld.score."""

    seed: int
    keys_sha256: str
    cases: int
    unanswered: int
    made_with: str
    scored_with: str
    answered_with: dict[str, int]
    code: dict[str, int]
    kinds: dict[str, int]
    scores: Scores
    answers: tuple[ScoredAnswer, ...]

    def __repr__(self) -> str:
        detected = self.scores.single.detected
        return f"ScoreRecord({self.cases} cases, {detected.hits} of {detected.total} effects seen)"

    @property
    def table(self) -> Rows[ScoredAnswer]:
        """The cases."""
        return Rows(self.answers)
