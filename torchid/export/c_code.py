"""A robot's inverse dynamics as a C99 file that needs nothing but <math.h>."""

import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from torch import Tensor

from torchid import __version__
from torchid.digits import number
from torchid.effects.c_text import JOINTS, RIGID
from torchid.effects.registry import Valued, in_rounds, nominal_effects
from torchid.export.dynamics import Dynamics, effect_text
from torchid.robot.config_files import config_folder, filled_template
from torchid.robot.model import JointType, Robot
from torchid.yaml_data import parsed_yaml

_WORDS: dict[str, str] = parsed_yaml(
    (config_folder("templates") / "c_words.yaml").read_text(encoding="utf-8")
)


class CFile(NamedTuple):
    """C source, its header, and the effects that are not in it."""

    source: str
    header: str
    left_out: tuple[Valued, ...]


class EffectCode(NamedTuple):
    """Statements of all effects, and what could not be written.

    Attributes:
        first: effects of the motion alone.
        later: effects of the torque, `loaded`, that those and the rigid body need.
        left_out: those that depend on the past, on time or on an arm that is otherwise.
    """

    first: list[str]
    later: list[str]
    left_out: tuple[Valued, ...]


def effect_code(robot: Robot, effects: Sequence[Valued], rigid: str) -> EffectCode:
    """C statements that add to tau[] the torques of the effects that are a closed form of the
    present motion.

    Args:
        robot: for units.
        effects: with coefficients.
        rigid: name of the C function of the rigid body's torque.
    """
    rounds: list[list[str]] = []
    left_out: list[Valued] = []
    for pairs in in_rounds(effects):
        lines: list[str] = []
        for effect, values in pairs:
            code = effect.c_code(values)
            if code is None:
                left_out.append((effect, values))
                continue
            named = (line.replace(RIGID, rigid).replace(JOINTS, str(robot.n)) for line in code)
            lines += [f"/* {effect_text(effect, values, robot)} */", *named]
        rounds.append(lines)
    return EffectCode(rounds[0], rounds[1], tuple(left_out))


def identifier(name: str) -> str:
    """A name that C takes."""
    found = re.sub(r"\W", "_", name, flags=re.ASCII)
    return f"robot_{found}" if not found or found[0].isdigit() else found


def c_file(dynamics: Dynamics, file_name: str) -> CFile:
    """The C file of tau = Y_R(q, dq, ddq) beta and of the effects that have a closed form.

    `<name>_rigid` is the rigid body's torque, by recursive Newton-Euler (eqs. 2.12-2.14 of the
    report), which is linear in the parameters and equals Y_R beta for any set that has the base
    parameters beta; `<name>_torque` adds the effects.

    Args:
        dynamics: what to write.
        file_name: without suffix; functions are named so, too.
    """
    robot, name = dynamics.robot, identifier(file_name)
    code = effect_code(robot, nominal_effects(robot), f"{name}_rigid")
    about = _about(dynamics, file_name, code.left_out).replace("*/", "* /").replace("/*", "/ *")
    # A line that ends in a backslash would continue in the next.
    words = [f" * {line}".rstrip().rstrip("\\").rstrip() for line in about.splitlines()]
    body, local = [f"{name}_rigid(q, dq, ddq, tau);", *code.first], []
    if code.later:
        body += [f"for (i = 0; i < {robot.n}; i++) loaded[i] = tau[i];", *code.later]
        local.append("double loaded[{n}];")
    if any(f"{name}_rigid(" in line for line in code.first + code.later):
        local.append("double moved[{n}], here[{n}], there[{n}];")
    local += ["int i;"] if local else []
    torque = "".join(f"    {line}\n" for line in [*(x.format(n=robot.n) for x in local), *body])
    given = {"name": name, "file": file_name, "n": robot.n, "about": "\n".join(words)}
    source = filled_template(
        "dynamics.c",
        **given,
        **_constants(robot),
        sign=_WORDS["sign"] if any("sign(" in line for line in code.first + code.later) else "",
        signature=_signature(name, robot.n),
        torque=torque,
    )
    return CFile(source, _header(name, robot), code.left_out)


def _about(dynamics: Dynamics, file_name: str, left_out: Sequence[Valued]) -> str:
    robot, values = dynamics.robot, dynamics.base
    units = [
        f"q[{i}] {'[m], torque [N]' if kind is JointType.PRISMATIC else '[rad], torque [N m]'}: "
        f"{name}"
        for i, (name, kind) in enumerate(zip(robot.joint_names, robot.joint_types, strict=True))
    ]
    # What LINK[][] holds.
    content, lines = _WORDS["set"].format(title=dynamics.title), list[str]()
    if values is not None:
        size = {"b": len(values.base), "p": len(values.base.parameter_names)}
        content = _WORDS["representative"].format(**size)
        rows = zip(values.base.names, values.values.tolist(), values.base.units, strict=True)
        lines += [f"  {number(value)} {unit}: {name}" for name, value, unit in rows]
    if left_out:
        lines += ["", "LEFT OUT, since they depend on the past, on time or on more than this arm:"]
        lines += [f"  {effect_text(*pair, robot)}" for pair in left_out]
    known = {"file": file_name, "robot": robot.name, "version": __version__}
    known |= {"title": dynamics.title, "units": "\n".join(units), "content": content.rstrip("\n")}
    return "\n".join([_WORDS["about"].format(**known).rstrip("\n"), *lines])


def _constants(robot: Robot) -> dict[str, object]:
    """What the C file has as constants."""
    drives = robot.drives
    pi = robot.require_parameters("an export").pi.double().tolist()
    links = [
        f"    {{{_list(map(number, row))}}}, /* {_plain(name)} */"
        for row, name in zip(pi, robot.link_names, strict=True)
    ]
    return {
        "links": robot.n_links,
        "prismatic": _list(int(d.joint_type is JointType.PRISMATIC) for d in drives),
        "parents": _list(robot.parents),
        "follows": _list(d.coordinate for d in drives),
        "ratios": _list(number(d.ratio) for d in drives),
        "offsets": _list(number(d.offset) for d in drives),
        "gravity": _list(map(number, robot.gravity.tolist())),
        "before": _poses(robot.before),
        "after": _poses(robot.after),
        "parameters": "\n".join(links),
    }


def _list(values: Iterable[object]) -> str:
    return ", ".join(map(str, values))


def _plain(name: str) -> str:
    return re.sub(r"[^\w .:-]", "_", name, flags=re.ASCII)


def _poses(poses: Tensor) -> str:
    rows = [
        f"    {{{_list(f'{{{_list(map(number, row))}}}' for row in pose[:3])}}}"
        for pose in poses.double().tolist()
    ]
    return "{\n" + ",\n".join(rows) + "\n}"


def _signature(name: str, n: int) -> str:
    signals = ", ".join(f"const double {x}[{n}]" for x in ("q", "dq", "ddq"))
    start = f"void {name}_torque("
    return f"{start}{signals},\n{' ' * len(start)}double tau[{n}])"


def _header(name: str, robot: Robot) -> str:
    torque = _signature(name, robot.n)
    return filled_template(
        "dynamics.h",
        robot=_plain(robot.name),
        upper=name.upper(),
        n=robot.n,
        rigid=torque.replace(f"{name}_torque(", f"{name}_rigid("),
        torque=torque,
    )
