"""torchid: what a robot arm's dynamics really are, and why the simulator disagrees.

The public names load on first use, so that `import torchid` is quick and thread settings can
still be made before torch loads.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torchid.dynamics.newton_euler import inverse_dynamics
    from torchid.dynamics.regressor import regressor
    from torchid.errors import TorchidError
    from torchid.gap.diagnose import diagnose
    from torchid.identification.identify import identify
    from torchid.identification.settings import Settings
    from torchid.log.model import Log
    from torchid.log.readers import read_log
    from torchid.robot.inertia import InertialParameters
    from torchid.robot.library import load_robot
    from torchid.robot.model import Robot

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
    "diagnose": "torchid.gap.diagnose",
    "TorchidError": "torchid.errors",
}

__all__ = [
    "InertialParameters",
    "Log",
    "Robot",
    "Settings",
    "TorchidError",
    "__version__",
    "diagnose",
    "identify",
    "inverse_dynamics",
    "load_robot",
    "read_log",
    "regressor",
]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module 'torchid' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
