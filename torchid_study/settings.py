"""What a study is made of: configs/studies/*.yaml."""

from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from torchid.errors import TorchidError
from torchid.extraction.settings import Penalty, SearchSettings
from torchid.robot.config_files import config_folder
from torchid.robot.yaml_values import parsed_yaml

Positive = Annotated[float, Meta(gt=0, lt=1e9)]


class _Keys(Struct, frozen=True, forbid_unknown_fields=True):
    pass


class MotionSettings(_Keys, frozen=True):
    """A motion and how it is sampled.

    Attributes:
        duration: [s].
        rate: [Hz].
        seed: of the motion; of its noise, the next.
        noise_db: signal-to-noise ratio of white noise on the trajectory, or None.
        source: of the exciting trajectories.
        count: how many trajectories, for excitation.
    """

    duration: Positive
    rate: Positive
    seed: int
    noise_db: float | None = None
    source: Literal["random", "table_5_1"] = "random"
    count: int = 1


class Scenario(_Keys, frozen=True):
    """One simulation: which bounds, which loss, and the id of its best set in the report."""

    id: str
    bounds: str
    penalty: Penalty


class PayloadSettings(_Keys, frozen=True):
    """A body at the tool, in the tool frame; inertia about its centre of mass (6)."""

    mass: Positive
    com: Annotated[tuple[float, ...], Meta(min_length=3, max_length=3)]
    inertia_about_com: Annotated[tuple[float, ...], Meta(min_length=6, max_length=6)]


class StudySettings(_Keys, frozen=True, kw_only=True):
    """A whole study (sections 5.1 to 5.4).

    Attributes:
        name, title: what it is; its file gives the name.
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

    name: str = ""
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
    scenarios: Annotated[tuple[Scenario, ...], Meta(min_length=1)]
    payload: PayloadSettings

    def __post_init__(self) -> None:
        ids = [scenario.id for scenario in self.scenarios]
        if len(set(ids)) < len(ids):
            raise ValueError(f"scenarios need ids of their own: {ids}")


def study_names() -> list[str]:
    """The built-in studies, in the report's order, which is that of their names."""
    return sorted(path.stem for path in config_folder("studies").glob("*.yaml"))


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
        raise TorchidError(f"there is no study '{name}'.", available=[*study_names(), "all"])
    data = parsed_yaml(path)
    try:
        settings = msgspec.convert(data, StudySettings)
        SearchSettings(**data["search"])  # a dataclass passes over keys that it does not know
    except (TypeError, ValueError) as error:
        raise TorchidError(f"'{path}' is not a study.", got=str(error)) from error
    return msgspec.structs.replace(settings, name=path.stem)
