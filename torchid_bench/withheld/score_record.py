"""A scored set as its JSON has it: the schema torchid.withheld.score/1."""

from typing import Any

from torchid.results.record import Part, Record, Rows


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
    """A scored set; `scores` is what torchid_bench.withheld.score.scores makes of it."""

    seed: int
    keys_sha256: str
    cases: int
    unanswered: int
    made_with: str
    scored_with: str
    answered_with: dict[str, int]
    code: dict[str, int]
    kinds: dict[str, int]
    scores: dict[str, Any]
    answers: tuple[ScoredAnswer, ...]

    def __repr__(self) -> str:
        seen = self.scores["single"]["detected"]
        return f"ScoreRecord({self.cases} cases, {seen['hits']} of {seen['total']} effects seen)"

    @property
    def table(self) -> Rows[ScoredAnswer]:
        """The cases."""
        return Rows(self.answers)
