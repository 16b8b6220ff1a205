"""torchid: what a robot arm's dynamics really are, and why the simulator disagrees.

The public names load on first use, so that `import torchid` is quick and thread settings can
still be made before torch loads. Their types are in __init__.pyi.
"""

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_PUBLIC = {
    "Robot": "torchid.robot.model",
    "InertialParameters": "torchid.robot.inertia",
    "load_robot": "torchid.robot.library",
    "Log": "torchid.log.model",
    "read_log": "torchid.log.readers",
    "inverse_dynamics": "torchid.dynamics.newton_euler",
    "regressor": "torchid.dynamics.regressor",
    "identify": "torchid.identification.identify",
    "Settings": "torchid.identification.settings",
    "problem_of": "torchid.extraction.from_identification",
    "extract": "torchid.extraction.extract",
    "export_dynamics": "torchid.export.export",
    "diagnose": "torchid.gap.diagnose",
    "TorchidError": "torchid.errors",
}

__all__ = [*_PUBLIC, "__version__"]  # noqa: PLE0604


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module 'torchid' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
