"""MuJoCo, imported when it is needed."""

from typing import Any

from torchid.errors import MissingExtraError


def mujoco() -> Any:
    """The module.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        import mujoco as module
    except ImportError as error:
        raise MissingExtraError("mujoco", "mjcf", "Simulating withheld cases") from error
    return module
