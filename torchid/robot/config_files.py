"""Where the data files that come with torchid are, and what names a robot; without torch."""

from pathlib import Path

ROBOT_FILES = (".yaml", ".yml", ".urdf", ".xml")


def config_folder(name: str) -> Path:
    """configs/<name>: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    installed = package / "configs" / name
    return installed if installed.is_dir() else package.parent / "configs" / name


def names_built_in(name: str) -> bool:
    """Whether this is the name of a built-in robot."""
    return name in (path.stem for path in config_folder("robots").glob("*.yaml"))


def names_robot(name: str | None) -> bool:
    """Whether this names a robot: a built-in one, or a file by its suffix."""
    return name is not None and (Path(name).suffix.lower() in ROBOT_FILES or names_built_in(name))
