"""What a study is made of: configs/studies/*.yaml."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta, Struct

from torchid.errors import TorchidError
from torchid.extraction.settings import Penalty, SearchSettings
from torchid.robot.config_files import config_folder
from torchid.robot.yaml_values import parsed_yaml

Positive = Annotated[float, Meta(gt=0, lt=1e9)]


@dataclass(frozen=True)
class MotionSettings:
    """A motion and how it is sampled.

    Attributes:
        duration: [s].
        rate: [Hz].
        seed: of the motion; of its noise, the next.
        noise_db: signal-to-noise ratio of white noise on the trajectory, or None.
        source: `random` or `table_5_1`, for excitation.
        count: how many trajectories, for excitation.
    """

    duration: Positive
    rate: Positive
    seed: int
    noise_db: float | None = None
    source: str = "random"
    count: int = 1


class Scenario(Struct, frozen=True, forbid_unknown_fields=True):
    """One simulation: which bounds, which loss, and the id of its best set in the report, which can
    be the name of a file."""

    id: str
    bounds: str
    penalty: Penalty

    def __post_init__(self) -> None:
        if Path(self.id).name != self.id:
            raise ValueError(f"the scenario's id {self.id!r} cannot be the name of a file")


class PayloadSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """A body at the tool, in the tool frame; inertia about its centre of mass (6)."""

    mass: Positive
    com: Annotated[tuple[float, ...], Meta(min_length=3, max_length=3)]
    inertia_about_com: Annotated[tuple[float, ...], Meta(min_length=6, max_length=6)]


@dataclass(frozen=True)
class StudySettings:
    """A whole study (sections 5.1 to 5.4).

    Attributes:
        name, title: what it is.
        robot: built-in name.
        section: where the report has it.
        effects: linear effects identified with the rigid body.
        excitation, validation, sets_motion, wrench_motion: motions.
        search: runs, stages, generations, schedule, seed; penalty by scenario.
        total_mass: interval of condition (2.31) [kg].
        geometry: group of bounds whose CoM boxes are the links' geometry.
        scenarios: six.
        payload: held at the tool in the last part.
    """

    name: str
    title: str
    robot: str
    section: str
    effects: tuple[str, ...]
    excitation: MotionSettings
    validation: MotionSettings
    sets_motion: MotionSettings
    wrench_motion: MotionSettings
    search: SearchSettings
    total_mass: tuple[float, float]
    geometry: str
    scenarios: tuple[Scenario, ...]
    payload: PayloadSettings

    def __post_init__(self) -> None:
        ids = [scenario.id for scenario in self.scenarios]
        if not ids or len(set(ids)) < len(ids):
            raise ValueError(f"scenarios need ids of their own, one at least: {ids}")

    def quick(self) -> "StudySettings":
        """The study with a small search: a fifth of the runs, stages and generations."""
        search = self.search
        return replace(
            self,
            search=replace(
                search,
                runs=max(4, search.runs // 5),
                stages=max(4, search.stages // 5),
                generations=max(10, search.generations // 5),
            ),
        )


_KEYS = [key.name for key in fields(StudySettings) if key.name != "name"]


def study_names() -> list[str]:
    """The built-in studies, in the report's order."""
    names = [path.stem for path in config_folder("studies").glob("*.yaml")]
    return sorted(names, key=lambda name: load_study(name).section)


def study_file(name: str) -> Path:
    """The file that `load_study` reads for a name or path."""
    path = config_folder("studies") / f"{name}.yaml"
    return path if path.is_file() else Path(name)


def load_study(name: str) -> StudySettings:
    """A built-in study by name, or one from a .yaml file.

    Raises:
        TorchidError: no such study, or a file that does not describe one.
    """
    path = study_file(name)
    if path.suffix not in (".yaml", ".yml") or not path.is_file():
        available = sorted(p.stem for p in config_folder("studies").glob("*.yaml"))
        raise TorchidError(f"there is no study '{name}'.", available=[*available, "all"])
    data = parsed_yaml(path)
    if not isinstance(data, Mapping) or set(data) != set(_KEYS):
        got = sorted(set(data) ^ set(_KEYS)) if isinstance(data, Mapping) else type(data).__name__
        raise TorchidError(
            f"'{path}' is not a study: keys missing or unknown.", got=got, expected=_KEYS
        )
    try:
        search = SearchSettings(**data["search"])
        for motion in ("excitation", "validation", "sets_motion", "wrench_motion"):
            MotionSettings(**data[motion])  # else keys that it does not know are passed over
        given = {**data, "name": path.stem, "search": {}}
        return replace(msgspec.convert(given, StudySettings), search=search)
    except (TypeError, ValueError) as error:
        raise TorchidError(f"'{path}' is not a study.", got=f"{error!r}") from error
