"""Fields that some releases of MuJoCo have: MuJoCo itself is asked, by a small file with each."""

from dataclasses import dataclass
from functools import cache
from importlib import import_module

_FILE = (
    "<mujoco><worldbody><body><joint name='j' axis='0 1 0' {joint}/><geom size='.1'/></body>"
    "</worldbody><actuator>{actuator}</actuator></mujoco>"
)
_PID = "gaintype='pid' biastype='affine' gainprm='3 0 0' biasprm='0.5 -10 -1' input='pos'"


@dataclass(frozen=True)
class Field:
    """A field of a joint or an actuator.

    Attributes:
        found: what of an arm it says.
        field: as MJCF has it.
        without: what a file has in its place.
        joint, actuator: attributes of a joint, and an actuator, with it.
    """

    found: str
    field: str
    without: str
    joint: str = ""
    actuator: str = ""


FIELDS = {
    "damping": Field(
        "friction that grows with the square or cube of the speed", '`damping="b0 b1 b2"`',
        "torchid does not run with such a MuJoCo", joint="damping='1 2 3'",
    ),
    "delay": Field(
        "a servo's delay", "`<general delay nsample>`", "torchid does not run with such a MuJoCo",
        actuator="<general joint='j' delay='0.02' nsample='12' interp='linear'/>",
    ),
    "pid": Field(
        "a servo's limit of speed alone, its integral action and the limit of that",
        '`<general dyntype="pid">`, as `<pid slewmax ki imax>` makes it',
        "left out, the others refitted around it",
        actuator=f"<general joint='j' dyntype='pid' dynprm='2 1.5' actdim='2' {_PID}/>",
    ),
    "springyield": Field(
        "friction before sliding, with a sharp edge", "joint `springyield`",
        "nothing: no law of torchid is like it (its own is Dahl's, without an edge)",
        joint="stiffness='10' springyield='0.01'",
    ),
    "dcmotor": Field(
        "Dahl's friction (presliding hysteresis) and cogging, as torchid's laws are",
        '`<dcmotor input="none" lugre cogging>`',
        "the sidecar, which torchid adds at run time; not written yet",
        actuator="<dcmotor joint='j' input='none' resistance='1' motorconst='0' "
        "lugre='1000 1 .1 .2 .1' cogging='.1 3 0'/>",
    ),
}  # fmt: skip


@cache
def has_field(name: str) -> bool:
    """Whether the installed MuJoCo compiles a file with one of `FIELDS`."""
    mujoco, field = import_module("mujoco"), FIELDS[name]
    try:
        mujoco.MjModel.from_xml_string(_FILE.format(joint=field.joint, actuator=field.actuator))
    except ValueError:
        return False
    return True


def lacking(name: str) -> str:
    """`MuJoCo 3.11.0 has no ...`: what is said where a field is missing."""
    return f"MuJoCo {import_module('mujoco').__version__} has no {FIELDS[name].field}"
