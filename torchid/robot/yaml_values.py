"""Checked values of a parsed yaml: known keys, finite numbers, tensors of a given shape."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from torch import Tensor

from torchid import yaml_data
from torchid.errors import LARGEST, RobotError

_EXPONENT = "yaml reads 1e-3 as text: write 1.0e-3"


def parsed_yaml(path: Path) -> Any:
    """The content of a yaml file, or a RobotError."""
    return text_and_content(path)[1]


def text_and_content(path: Path) -> tuple[str, Any]:
    """The text of a yaml file, whose comments are no content, and its content, or a RobotError."""
    try:
        text = path.read_text(encoding="utf-8")
        return text, yaml_data.parsed_yaml(text)
    except RecursionError as error:
        raise RobotError(f"'{path}' is not valid yaml: it is nested too deeply.") from error
    except (yaml.YAMLError, ValueError, TypeError, KeyError) as error:
        # ValueError: not UTF-8, or no such date; the others are of tags that are used wrongly.
        raise RobotError(f"'{path}' is not valid yaml: {str(error).splitlines()[0]}") from error
    except OSError as error:
        raise RobotError(f"'{path}' cannot be read: {error.strerror}") from error


def known(data: Any, keys: Sequence[str], where: str) -> None:
    """Raise RobotError unless `data` is a mapping without other keys."""
    if not isinstance(data, Mapping):
        raise RobotError(f"{where}: must be a mapping.", got=data, expected=list(keys))
    for key in data:
        if key not in keys:
            raise RobotError(f"{where}: unknown key.", got=key, available=list(keys))


def number(value: Any, where: str) -> float:
    """A finite number, or a RobotError."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < LARGEST:
        hint = _EXPONENT if isinstance(value, str) else None
        got = repr(value) if isinstance(value, str) else [value] if value is None else value
        raise RobotError(f"{where}: not a finite number.", got=got, hint=hint)
    return float(value)


def numbers(data: Any, shape: tuple[int, ...], where: str, *, finite: bool = True) -> Tensor:
    """A tensor of this shape, or a RobotError; infinities only where `finite` is False."""
    try:
        tensor = torch.tensor(data, dtype=torch.float64)
    except (TypeError, ValueError, OverflowError, RuntimeError) as error:
        raise RobotError(
            f"{where}: not numbers, or rows of unequal length.", got=data, hint=_EXPONENT
        ) from error
    if tuple(tensor.shape) != shape:
        raise RobotError(
            f"{where}: wrong size.", got=tuple(tensor.shape), expected=f"{shape} for this robot"
        )
    if any(isinstance(x, bool) for x in np.array(data, dtype=object).flat):
        raise RobotError(f"{where}: yes and no are not numbers.", got=data)
    if tensor.isnan().any() or (finite and (tensor.abs() >= LARGEST).any()):
        raise RobotError(f"{where}: not all finite.", got=data)
    return tensor
