"""Where the data files that come with torchid are."""

from pathlib import Path


def config_folder(name: str) -> Path:
    """configs/<name>: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    installed = package / "configs" / name
    return installed if installed.is_dir() else package.parent / "configs" / name
