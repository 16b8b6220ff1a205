"""How to search for parameter sets."""

from dataclasses import dataclass
from typing import Literal, get_args

from torchid.errors import TorchidError

Schedule = Literal["linear", "geometric"]
Penalty = Literal["full", "partial"]


@dataclass(frozen=True)
class SearchSettings:
    """How to search.

    Attributes:
        runs: independent starts.
        stages: K of Algorithm 1.
        generations: of each stage.
        population: of each run; 4 + floor(3 ln D) if None.
        penalty: `full` loss phi + xi gamma, or `partial`: phi alone.
        schedule: xi_{k+1} = 10 k (`linear`, as Algorithm 1 prints it) or 10^k (`geometric`, as the
            text says: ten times more at every stage).
        seed: of starts and samples.

    Raises:
        TorchidError: a count below one, more candidates than memory holds, an unknown name, or more
            stages than the schedule `geometric` has numbers for.

    >>> SearchSettings(runs=10, stages=5).weight(2)
    20.0
    """

    runs: int = 30
    stages: int = 25
    generations: int = 100
    population: int | None = None
    penalty: Penalty = "full"
    schedule: Schedule = "linear"
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("runs", "stages", "generations", "population"):
            if (count := getattr(self, name)) is not None and count < 1:
                raise TorchidError(f"{name}: at least one is needed.", got=count)
        most_at_once = 1_000_000
        if self.runs * (self.population or 1) > most_at_once:
            raise TorchidError(
                "runs times population: all candidates of a generation are in memory at once.",
                got=self.runs * (self.population or 1),
                expected=f"at most {most_at_once}",
            )
        for name, known in (("penalty", get_args(Penalty)), ("schedule", get_args(Schedule))):
            if getattr(self, name) not in known:
                raise TorchidError(f"unknown {name}.", got=getattr(self, name), available=known)
        # Stages of the schedule `geometric`: 10^309 is no number, and gamma multiplies the weight
        most_geometric = 300
        if self.schedule == "geometric" and self.stages > most_geometric:
            raise TorchidError(
                "too many stages for the schedule 'geometric': each has ten times the weight.",
                got=self.stages,
                expected=f"at most {most_geometric}",
            )

    def weight(self, stage: int) -> float:
        """xi of stage 0, 1, ..., K - 1."""
        if stage == 0 or self.penalty == "partial":
            return 0.0
        return 10.0 * stage if self.schedule == "linear" else 10.0**stage
