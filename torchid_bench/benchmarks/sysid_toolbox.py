"""MuJoCo's own toolbox for system identification, `mujoco.sysid`, for scripts that fit with it.

Without its extra it is an empty module. From MuJoCo 4.0 on `mujoco` is split into several packages,
and one that is upgraded in its place loses what the older one takes along.
"""

from types import ModuleType

from torchid.errors import TorchidError

EXTRA = 'pip install "mujoco[sysid]"'
"""Where MuJoCo is whole, or not there."""
ANEW = f"pip uninstall -y mujoco mujoco-core mujoco-studio; {EXTRA}"
"""Where files of it are lost, or it is older than its toolbox (3.5): an upgrade would lose them, and
a new core alone may be of another release."""


def sysid_toolbox() -> ModuleType:
    """`mujoco.sysid`, whole.

    Raises:
        TorchidError: it is not, with the line that installs what is missing.
    """
    try:
        import mujoco
    except ImportError as error:
        missing = isinstance(error, ModuleNotFoundError) and error.name == "mujoco"
        raise _not_whole(str(error), EXTRA if missing else ANEW) from error
    if not hasattr(mujoco, "MjModel"):
        raise _not_whole("a package 'mujoco' without its core", ANEW)
    try:
        from mujoco import sysid
    except ImportError as error:
        raise _not_whole(f"MuJoCo {mujoco.__version__}, which has none", ANEW) from error
    if not hasattr(sysid, "optimize"):
        raise _not_whole(f"an empty module: MuJoCo {mujoco.__version__} without its extra", EXTRA)
    assert isinstance(sysid, ModuleType)
    return sysid


def _not_whole(got: str, line: str) -> TorchidError:
    return TorchidError(
        "This script needs mujoco.sysid, MuJoCo's toolbox.", got=got, hint=f"paste: {line}"
    )
