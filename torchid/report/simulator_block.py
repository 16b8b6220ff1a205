"""What a corrected robot's joints are in a simulator's file, as text to copy into one's own."""

from xml.sax.saxutils import quoteattr

from torchid.export.joint_dynamics import Target, split
from torchid.export.mjcf import ATTRIBUTES
from torchid.report.table import listed
from torchid.robot.model import Robot


def simulator_block(robot: Robot) -> str:
    """Attributes of the joints for MJCF and URDF; what a format has no field for is named in a
    comment, and `torchid export` puts it beside the file.

    Args:
        robot: corrected.

    >>> from torchid import load_robot
    >>> print(simulator_block(load_robot("3r_friction")).splitlines()[1].split(" damping")[0])
    <joint name="joint_1"
    """
    lines = []
    formats: tuple[Target, ...] = ("mjcf", "urdf")
    for to in formats:
        mjcf = to == "mjcf"
        joints, rest = split(robot, to)
        angles = ', of a file with <compiler angle="radian"/>' if mjcf else ""
        lines.append(f"<!-- {to.upper()}: into the joint of the same name{angles} -->")
        for name, own in zip(robot.joint_names, joints, strict=True):
            if mjcf:
                given = {key: getattr(own, attribute) for key, attribute in ATTRIBUTES.items()}
                given |= {"springref": own.rest} if own.stiffness else {}
                said = "".join(f' {key}="{value:.6g}"' for key, value in given.items() if value)
                line = f"<joint name={quoteattr(name)}{said}/>"
            else:
                said = f'damping="{own.damping:.6g}" friction="{own.friction:.6g}"'
                line = f"<joint name={quoteattr(name)}> <dynamics {said}/> </joint>"
            lines.append(line)
        # A double hyphen would end a comment.
        left = listed(list(dict.fromkeys(effect.name for effect, _ in rest))).replace("--", "-")
        lines += [f"<!-- no field for: {left} -->"] if rest else []
    return "\n".join(lines)
