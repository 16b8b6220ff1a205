"""Where the data files that come with torchid are, and what names a robot; without torch."""

from pathlib import Path
from string import Template

from torchid.errors import RobotError
from torchid.files import similar_files

URDF_FILES = (".urdf", ".xacro")
ROBOT_FILES = (".yaml", ".yml", *URDF_FILES, ".xml")


def is_urdf(path: str | Path) -> bool:
    """Whether it is a URDF or a xacro of one, by its name; .urdf.xml is one of them."""
    name = Path(path).name.lower()
    return name.endswith((*URDF_FILES, ".urdf.xml"))


def config_folder(name: str) -> Path:
    """configs/<name>: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    installed = package / "configs" / name
    return installed if installed.is_dir() else package.parent / "configs" / name


def filled_template(file: str, /, **words: object) -> str:
    """The text of configs/templates/<file> with its words."""
    text = (config_folder("templates") / file).read_text(encoding="utf-8")
    return Template(text).substitute(words)


def built_in_robots() -> list[str]:
    """Names of the built-in robots."""
    return sorted(path.stem for path in config_folder("robots").glob("*.yaml"))


def names_robot(name: str | None) -> bool:
    """Whether this names a robot: a built-in one, or a file by its suffix."""
    return name is not None and (
        Path(name).suffix.lower() in ROBOT_FILES or name in built_in_robots()
    )


def robot_file(name: str | Path) -> Path:
    """The file that `load_robot` reads for a name or path."""
    text = str(name)
    return config_folder("robots") / f"{text}.yaml" if text in built_in_robots() else Path(text)


def require_robot_file(name: str | Path) -> Path:
    """The file of a robot.

    Raises:
        RobotError: it is neither a built-in robot nor a file of one that exists; files beside it
            with a similar name are proposed.
    """
    text, path = str(name), robot_file(name)
    known = path.suffix.lower() in ROBOT_FILES
    if known and path.is_file():
        return path
    near = [] if path.exists() else similar_files(path, ROBOT_FILES)
    hint = f"did you mean {near[0]}?" if near else None
    if known:
        wrong = "is no regular file" if path.exists() else "does not exist"
        raise RobotError(f"robot file '{text}' {wrong}.", available=built_in_robots(), hint=hint)
    if path.suffix.lower() == ".json":
        hint = f"a result becomes a robot by `torchid export {text} --to urdf` (or mjcf, yaml)"
    raise RobotError(
        f"unknown robot '{text}'.",
        expected=f"a built-in name or a file ({', '.join(ROBOT_FILES)})",
        available=built_in_robots(),
        hint=hint,
    )
