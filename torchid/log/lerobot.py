"""LeRobot datasets, v2.1 and v3: a folder with meta/info.json and parquet files in data/.

Episodes are trajectories. Time is frame_index / fps, because the recorded float32 stamps jitter.
"""

import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from torchid.errors import LogError
from torchid.log.formats import read_parquet_columns
from torchid.log.joint_names import in_robot_order
from torchid.log.table import Request, Shape, Table
from torchid.log.units import unit_factor
from torchid.log.words import NAMES

_COUNTED = ("episode_index", "frame_index")
_PRESET = NAMES["lerobot"]


def is_lerobot(path: Path) -> bool:
    """Whether a folder is a LeRobot dataset."""
    return (path / "meta" / "info.json").is_file()


def lerobot_table(path: Path, request: Request) -> Table:
    """The table of a dataset: features as arrays, their elements as columns `feature.name`.

    q is the elements of observation.state whose names end in `.pos`, or all of it if no name says
    what it is; torque is observation.effort, or elements that end in `.effort` or `.torque`;
    u is the action.

    Raises:
        LogError: no data, or the robot's joints cannot be found in the state.
    """
    info = _info(path)
    numeric = re.compile(r"u?int\d+|float\d+|bool")
    features = {
        name: feature
        for name, feature in info["features"].items()
        if isinstance(feature, dict) and numeric.fullmatch(str(feature.get("dtype")))
        if _size(feature) > 0
    }
    files = sorted((path / "data").rglob("*.parquet"))
    if not files:
        raise LogError(f"'{path}' has no parquet files in its folder data.")
    elements = {name: _names(feature) for name, feature in features.items()}
    columns: dict[str, Shape | None] = {"t": (-1,), "traj": (-1,)}
    places: dict[str, tuple[str, list[int] | None]] = {}
    for name, names in elements.items():
        columns[name] = (-1, len(names)) if len(names) > 1 else (-1,)
        places[name] = (name, None)
        if features[name].get("names") and len(names) > 1:
            columns |= {f"{name}.{element}": (-1,) for element in names}
            places |= {f"{name}.{e}": (name, [k]) for k, e in enumerate(names)}
    chosen, joints, warnings = _joint_signals(path, elements, request)
    columns |= {key: (-1, len(index)) for key, (_, index) in chosen.items()}
    places.update(chosen)
    factor, unclear = 1.0, None
    if chosen:
        factor, said, unclear = _unit(path, info, files, chosen)
        warnings += (said,) if said else ()

    def read(wanted: Sequence[str]) -> dict[str, np.ndarray]:
        if unclear is not None and {"q", "u"} & set(wanted):
            raise unclear
        needed = [places[name][0] for name in wanted if name in places]
        table = _sorted(path, files, dict.fromkeys(needed), float(info["fps"]))
        return {
            name: table[name] if name not in places else _part(table, *places[name])
            for name in wanted
        } | {key: factor * _part(table, *places[key]) for key in ("q", "u") if key in wanted}

    kind = f"LeRobot {info.get('codebase_version', 'dataset')}"
    return Table(
        path,
        kind,
        columns,
        read,
        arrays=True,
        joints=joints,
        origins={"t": "frame_index / fps", **{key: chosen[key][0] for key in chosen}},
        warnings=warnings,
        servos=_servos(str(info.get("robot_type")), joints),
    )


def _servos(kind: str, joints: Sequence[str]) -> str:
    """The servos that LeRobot's driver of an arm drives: one name, or one a joint; none where it
    has several types and the joints go by no names."""
    for arms, types in _PRESET["servos"].items():
        if re.fullmatch(arms, kind):
            named = [next(t for j, t in types.items() if re.fullmatch(j, name)) for name in joints]
            every = set(named or types.values())
            return ",".join(every if len(every) == 1 else named)
    return ""


def _info(path: Path) -> dict[str, Any]:
    try:
        info = json.loads((path / "meta" / "info.json").read_text(encoding="utf-8"))
        if not 0 < float(info["fps"]) < math.inf or not isinstance(info["features"], dict):
            raise ValueError("fps or features are not what they should be")
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise LogError(
            f"'{path}' has a meta/info.json that cannot be used.", got=repr(error)[:200],
            expected="fps and features",
        ) from error  # fmt: skip
    return dict(info)


def _size(feature: dict[str, Any]) -> int:
    """Elements of a feature of one dimension; 0 of any other."""
    shape = feature.get("shape") or [1]
    usual = isinstance(shape, list) and len(shape) == 1 and isinstance(shape[0], int)
    # 10_000: of a feature: no robot has more joints and sensors
    return shape[0] if usual and shape[0] <= 10_000 else 0


def _names(feature: dict[str, Any]) -> list[str]:
    """Names of a feature's elements: a list, or {"motors": list}; numbers where there are none."""
    names = feature.get("names")
    while isinstance(names, dict):
        names = next(iter(names.values()), None)
    size = _size(feature)
    if isinstance(names, list) and len(names) == size:
        return [str(name) for name in names]
    return [str(k) for k in range(size)]


def _joint_signals(
    path: Path, elements: dict[str, list[str]], request: Request
) -> tuple[dict[str, tuple[str, list[int]]], tuple[str, ...], tuple[str, ...]]:
    """Feature and elements of q, dq, tau, i and u, the joints' names, and warnings."""
    if request.maps("q"):
        return {}, (), ()
    places: dict[str, tuple[str, list[int]]] = {}
    joints: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    for key, features in _PRESET["features"].items():
        for feature in features:
            named = _elements_of(key, elements.get(feature, []), feature == "observation.state")
            if not named or (key != "q" and not places):
                continue
            if key == "q":
                chosen, warnings = _in_order(path, feature, list(named), request)
                joints = tuple(chosen)
            if all(joint in named for joint in joints):
                places[key] = (feature, [named[joint] for joint in joints])
                break
    return places, joints, warnings


def _unit(
    path: Path,
    info: Mapping[str, Any],
    files: Sequence[Path],
    chosen: Mapping[str, tuple[str, list[int]]],
) -> tuple[float, str, LogError | None]:
    """Radians in a unit of q and u, what to say of it, and the error where nothing tells.

    A unit that the features name counts first. LeRobot itself writes none: its drivers recorded
    degrees before elements ended in `.pos`, and since record degrees or, of the range in the arm's
    calibration file, -100 .. 100: only degrees go beyond.
    """
    feature, index = chosen["q"]
    given = info["features"][feature]
    named = given.get("unit", given.get("units"))
    factor = unit_factor("q", named) if isinstance(named, str) else None
    if factor is not None:
        return factor, f"'{path}': q is {feature}, in {named}, as meta/info.json says", None
    kind, names = str(info.get("robot_type")), _names(given)
    arm = [k for k in index if "gripper" not in names[k].lower()]
    # Elements as a mapping names them: 0:6, or [2,0,1].
    runs = {
        key: f"{at[0]}:{at[-1] + 1}" if at == list(range(at[0], at[-1] + 1)) else str(at)
        for key, (_, at) in chosen.items()
    }
    line = ",".join(
        f"{key}={name}[:,{runs[key].replace(' ', '')}] deg"
        for key, (name, _) in chosen.items()
        if key in "qu"
    )
    if not re.fullmatch(_PRESET["bus_servos"], kind):
        what = f"'{path}': q is {feature}, and is taken for radians; LeRobot drivers record "
        return 1.0, f'{what}degrees or percent too: `columns="{line}"`', None
    tables = [read_parquet_columns(file, [feature]) for file in files]
    values = [_part(table, feature, arm) for table in tables if feature in table]
    peak = max((float(np.nanmax(np.abs(x), initial=0.0)) for x in values), default=0.0)
    what = f"'{path}': q is {feature} of a {kind}, up to {peak:.3g}"
    # 6.5: no position is beyond this where it is in radians: joints of such arms turn once at most
    if peak <= 6.5:
        return 1.0, f"{what}: taken for radians", None
    # 100.5: no position is beyond this where -100 .. 100 is the calibrated range; degrees may be.
    if not any(name.endswith(".pos") for name in names) or peak > 100.5:
        return math.pi / 180, f"{what}: taken for degrees", None
    return (
        1.0,
        "",
        LogError(
            f"{what}: meta/info.json does not say whether in degrees or of the calibrated range.",
            expected="the unit, as `use_degrees` of the arm's driver was",
            hint=f'`columns="{line}"` for degrees; for -100 .. 100 factors `*[k1,..]` in the '
            "place of `deg`: (range_max - range_min) 2 pi / (200 4096) of each joint's calibration",
        ),
    )


def _elements_of(key: str, names: Sequence[str], mixed: bool) -> dict[str, int]:
    """Joint -> position in a feature, of the elements that are positions (or velocities, ..)."""
    endings = _PRESET["endings"]
    ending = re.compile(rf"(.+)[._/]({endings[key]})", re.IGNORECASE)
    of_kind = {m[1]: k for k, name in enumerate(names) if (m := ending.fullmatch(name))}
    other = re.compile(rf".+[._/]({'|'.join(endings.values())})", re.IGNORECASE)
    if of_kind or any(other.fullmatch(name) for name in names):
        return of_kind
    # Names that say nothing: the whole of the feature, unless it is the state, which is positions.
    return {} if mixed and key != "q" else {name: k for k, name in enumerate(names)}


def _in_order(
    path: Path, feature: str, names: list[str], request: Request
) -> tuple[list[str], tuple[str, ...]]:
    """The robot's joints among the names of a feature; a dataset's own order is base to tip."""
    joints = request.joints
    if not joints:
        return names, ()
    try:
        return in_robot_order(names, joints, f"'{path}', {feature}", request.spare_joints)
    except LogError:
        arm = [name for name in names if "gripper" not in name.lower()]
        if len(arm) != len(joints):
            raise LogError(
                f"'{path}': which elements of {feature} are the robot's joints is not clear.",
                got=", ".join(names[:30]),
                expected=", ".join(joints),
                hint=f'say it: `columns="q={feature}[:,0:{len(joints)}]"`, counted from 0',
            ) from None
    return arm, (
        f"'{path}': the elements of {feature} do not have the robot's names; taken in the order of "
        f"the dataset: {', '.join(arm)}",
    )


def _sorted(
    path: Path, files: Sequence[Path], names: Sequence[str] | dict[str, None], fps: float
) -> dict[str, np.ndarray]:
    """Features of all files in the order of episodes and frames, with t and traj."""
    parts = []
    for file in files:
        try:
            parts.append(read_parquet_columns(file, [*dict.fromkeys([*_COUNTED, *names])]))
        except OSError as error:
            raise LogError(f"'{file}' cannot be read: {error.strerror or error}") from error
        missing = [name for name in (*_COUNTED, *names) if name not in parts[-1]]
        if missing:
            raise LogError(f"'{file}' has no column {missing[0]}.", available=list(parts[-1]))
    table = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    order = np.lexsort((table["frame_index"].ravel(), table["episode_index"].ravel()))
    table = {name: values[order] for name, values in table.items()}
    table["t"] = table["frame_index"].ravel() / fps
    table["traj"] = table["episode_index"].ravel()
    return table


def _part(table: dict[str, np.ndarray], feature: str, index: list[int] | None) -> np.ndarray:
    array = table[feature]
    if index is None:
        return array
    return array.reshape(len(array), -1)[:, index]
