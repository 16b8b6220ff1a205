"""Robot files that are none, or whose numbers no arm has."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from tests.robustness.bad_logs import DEEP, ESCAPE, HUGE, LONG, MARKUP

GOOD: dict[str, Any] = {
    "name": "arm",
    "dh": {"convention": "classical", "joints": [{"a": 0.2, "alpha": 1.5}, {"a": 0.2}, {"a": 0.1}]},
    "limits": {"position": [3, 3, 3], "velocity": [2, 2, 2], "acceleration": [9, 9, 9]},
    "parameters": {
        "mass": [3.0, 2.0, 1.0],
        "com": [[0.0, 0.1, 0.0]] * 3,
        "inertia_about_com": [[0.02, 0, 0, 0.02, 0, 0.02]] * 3,
    },
    "effects": [{"effect": "viscous_friction", "joint": 1, "Fv": 0.1}],
}

URDF = """<robot name="arm"><link name="base"/>
<link name="l1"><inertial><mass value="2"/><origin xyz="0 0 0.1"/>
<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>
<link name="l2"><inertial><mass value="1"/><inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0"
izz="0.02"/></inertial></link>
<joint name="j1" type="revolute"><parent link="base"/><child link="l1"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" velocity="2" effort="50"/></joint>
<joint name="j2" type="revolute"><parent link="l1"/><child link="l2"/><origin xyz="0 0 0.3"/>
<axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="2" effort="50"/></joint></robot>"""

MJCF = """<mujoco model="arm"><compiler autolimits="true"/><worldbody><body name="l1">
<inertial pos="0 0 0.1" mass="2" diaginertia="0.02 0.02 0.02"/>
<joint name="j1" axis="0 0 1" range="-2 2"/><body name="l2" pos="0 0 0.3">
<inertial pos="0 0 0.1" mass="1" diaginertia="0.02 0.02 0.02"/>
<joint name="j2" axis="0 1 0" range="-2 2"/></body></body></worldbody></mujoco>"""

FIELD = '<hfield name="h" nrow="99999" ncol="99999" size="1 1 1 1"/>'
COPIES = "<replicate count='200' offset='1 0 0'><geom size='1'/></replicate>"
ATTACH = (
    '<asset><model name="m" file="{}"/></asset>'
    '<worldbody><attach model="m" body="l1" prefix="m"/></worldbody><worldbody>'
)


def _put(path: str, value: Any) -> bytes:
    """The good robot with another value at a place: `dh.joints.0.a`."""
    data = yaml.safe_load(yaml.safe_dump(GOOD))
    *above, last = (int(p) if p.isdigit() else p for p in path.split("."))
    here = data
    for part in above:
        here = here[part]
    here[last] = value
    return yaml.safe_dump(data).encode()


def _effect(**record: Any) -> bytes:
    return _put("effects", [record])


def files() -> Iterator[tuple[str, bytes]]:
    """Names and contents of bad robots."""
    good = yaml.safe_dump(GOOD).encode()
    yield "empty.yaml", b""
    yield "words.yaml", b"just words"
    yield "list.yaml", b"[1, 2]"
    yield "binary.yaml", bytes(range(256))
    yield "zeros.yaml", bytes(500)
    yield "tab.yaml", b"name:\t[\n\t:"
    yield "deep.yaml", b"name: x\ndh: " + b"[" * 1500
    yield "deep_map.yaml", b"{a: " * 1500
    yield (
        "laughs.yaml",
        b"a0: &a0 [x, x]\n"
        + b"".join(
            b"a%d: &a%d [%s]\n" % (k, k, b", ".join([b"*a%d" % (k - 1)] * 9)) for k in range(1, 20)
        ),
    )
    yield (
        "laughing.yaml",
        b"name: x\ndh:\n  a0: &a0 [x, x]\n"
        + b"".join(
            b"  a%d: &a%d [%s]\n" % (k, k, b", ".join([b"*a%d" % (k - 1)] * 9))
            for k in range(1, 20)
        ),
    )
    yield "itself.yaml", b"name: x\ndh: &d {convention: classical, joints: [*d, *d]}"
    yield "python.yaml", b"!!python/object/apply:os.system ['true']"
    yield "date.yaml", b"name: x\ndh: 2026-99-99"
    yield "no_dh.yaml", b"name: x"
    yield "twice.yaml", good + b"placements: {joints: []}\n"
    for k, joints in enumerate(([], {}, "RRR", [1], [{}] * 3, None, [{"type": "X"}], [[]])):
        if joints != [{}] * 3:
            yield f"joints{k}.yaml", _put("dh.joints", joints)
    for k, value in enumerate(
        ("x", None, [1], float("nan"), float("inf"), 1e308, -1e308, HUGE, True, "1e-3", {"a": 1})
    ):
        yield f"a{k}.yaml", _put("dh.joints.0.a", value)
        yield f"mass{k}.yaml", _put("parameters.mass", [value, 1, 1])
        yield f"com{k}.yaml", _put("parameters.com.1", [value, 0, 0])
        yield f"inertia{k}.yaml", _put("parameters.inertia_about_com.1", [value] * 6)
        yield f"gravity{k}.yaml", _put("gravity", [0, 0, value])
        yield f"gain{k}.yaml", _put("drive_gain", [1, 1, value])
        yield f"tool{k}.yaml", _put("tool", value)
        yield f"effect{k}.yaml", _effect(effect="coulomb_friction", joint=1, Fc=value)
        yield f"shape{k}.yaml", _effect(effect="time_delay", joint=1, dtau=1.0, delay=value)
    for k, value in enumerate(("x", None, 7, [], [[1]], "R" * 4000, HUGE)):
        yield f"limits{k}.yaml", _put("limits.velocity", value or [3])
        yield f"effects{k}.yaml", _put("effects", [value])
        yield f"parameters{k}.yaml", _put("parameters", value or [1])
        yield f"basis{k}.yaml", _put("basis", value)
        yield f"bounds{k}.yaml", _put("bounds", value or [1])
    yield "crossed.yaml", _put("limits.position", [[3, -3], [1, 1], [0, 1]])
    yield "unknown_effect.yaml", _effect(effect="glue", joint=1, Fv=1)
    yield "unknown_joint.yaml", _effect(effect="viscous_friction", joint=4, Fv=1)
    yield "text_joint.yaml", _effect(effect="viscous_friction", joint="1", Fv=1)
    yield "no_coefficient.yaml", _effect(effect="viscous_friction", joint=1)
    yield "delay.yaml", _effect(effect="time_delay", joint=1, delay=-1.0)
    yield "late.yaml", _effect(effect="time_delay", joint=1, delay=1e9)
    yield "listed_effect.yaml", _effect(effect=["viscous_friction"], joint=1, Fv=1)
    yield "unknown_key.yaml", _put("colour", "red")
    for name, text in (("long", LONG), ("escape", ESCAPE), ("markup", MARKUP)):
        yield f"key_{name}.yaml", _put(text, 1)
        yield f"effect_{name}.yaml", _effect(effect=text, joint=1)
        yield f"type_{name}.yaml", _put("dh.joints.0.type", text)
        yield f"value_{name}.yaml", _put("dh.joints.0.a", text)
        yield f"{name}.urdf", URDF.replace('type="revolute"', f'type="{_xml(text)}"').encode()
        yield (
            f"link_{name}.urdf",
            URDF.replace('child link="l2"', f'child link="{_xml(text)}"').encode(),
        )
        yield f"{name}.xml", MJCF.replace("<body", f"<{_xml(text)}").encode()

    def urdf(old: str, new: str) -> bytes:
        assert old in URDF
        return URDF.replace(old, new).encode()

    yield "empty.urdf", b""
    yield "words.urdf", b"just words"
    yield "binary.urdf", bytes(range(256))
    yield "cut.urdf", URDF.encode()[:400]
    yield "other.urdf", MJCF.encode()
    yield "bare.urdf", b"<robot/>"
    yield "deep.urdf", b"<robot>" + b"<link>" * DEEP
    yield (
        "entities.urdf",
        (
            b'<!DOCTYPE r [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;"><!ENTITY c '
            b'"&b;&b;&b;&b;&b;&b;&b;&b;">]>'
            + URDF.replace('name="arm"', 'name="&c;"').encode()[:300]
        ),
    )
    yield (
        "outside.urdf",
        (b'<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot name="a">&x;</robot>'),
    )
    yield "loop.urdf", urdf('parent link="base"', 'parent link="l2"')
    yield "self.urdf", urdf('parent link="l1"', 'parent link="l2"')
    yield "twice.urdf", urdf('name="j2"', 'name="j1"')
    yield "links.urdf", urdf('<link name="l2">', '<link name="l1">')
    yield "absent.urdf", urdf('child link="l2"', 'child link="l9"')
    yield "nameless.urdf", urdf('name="j2"', "")
    yield "mimic.urdf", urdf("<axis", '<mimic joint="j1"/><axis')
    yield "planar.urdf", urdf("revolute", "planar")
    yield "crossed.urdf", urdf('lower="-3" upper="3"', 'lower="3" upper="-3"')
    yield "xacro.urdf", urdf('value="2"', 'value="${m}"')
    for k, value in enumerate(("x", "", "nan", "inf", "1e308", "-1e308", "9" * 400, "1 2")):
        yield f"mass{k}.urdf", urdf('value="2"', f'value="{value}"')
        yield f"inertia{k}.urdf", urdf('ixx="0.02"', f'ixx="{value}"')
        yield (
            f"axis{k}.urdf",
            urdf('xyz="0 1 0"', f'xyz="0 {value} 0"' if k != 4 else 'xyz="0 0 0"'),
        )
        yield f"origin{k}.urdf", urdf('xyz="0 0 0.3"', f'xyz="0 0 {value}"')

    def mjcf(old: str, new: str) -> bytes:
        assert old in MJCF
        return MJCF.replace(old, new).encode()

    yield "empty.xml", b""
    yield "words.xml", b"just words"
    yield "cut.xml", MJCF.encode()[:200]
    yield "other.xml", URDF.encode()
    yield "bare.xml", b"<mujoco/>"
    yield "deep.xml", b"<mujoco><worldbody>" + b"<body>" * 20_000
    yield "itself.xml", b'<mujoco><include file="itself.xml"/></mujoco>'
    yield "mesh.xml", mjcf("<worldbody>", '<asset><mesh file="no.stl"/></asset><worldbody>')
    yield "twice.xml", mjcf('name="j2"', 'name="j1"')
    yield "nothing.xml", b"<mujoco><worldbody><body/></worldbody></mujoco>"
    for k, count in enumerate(("1000000000", "9" * 400)):
        yield f"copies{k}.xml", mjcf("<worldbody>", f'<worldbody><replicate count="{count}"/>')
        yield f"keys{k}.xml", mjcf("<worldbody>", f'<size nkey="{count}"/><worldbody>')
    yield "field.xml", mjcf("<worldbody>", f"<asset>{FIELD}</asset><worldbody>")
    copies = f"<replicate count='200'>{COPIES}</replicate>"
    yield "bodies.xml", mjcf("<worldbody>", f"<worldbody>{copies}")
    for name in ("a", "b"):  # a model that attaches the other one
        other = f"attach_{'b' if name == 'a' else 'a'}.xml"
        yield f"attach_{name}.xml", mjcf("<worldbody>", ATTACH.format(other))
    for k, file in enumerate(("pipe.xml", "/dev/zero")):
        yield f"include{k}.xml", mjcf("<worldbody>", f'<include file="{file}"/><worldbody>')
    yield "pipes.xml", mjcf("<worldbody>", '<asset><mesh file="pipe.stl"/></asset><worldbody>')
    for k, value in enumerate(("x", "nan", "inf", "1e308", "1e200", "9" * 400)):
        yield f"mass{k}.xml", mjcf('mass="2"', f'mass="{value}"')
        yield f"pos{k}.xml", mjcf('pos="0 0 0.3"', f'pos="0 0 {value}"')
        yield f"axis{k}.xml", mjcf('axis="0 1 0"', f'axis="0 {value if k < 3 else 0} 0"')


def _xml(text: str) -> str:
    """XML has no escape character, nor markup in attributes."""
    return text.replace("\x1b", "\x9b").replace("\x07", "").replace("<", "&lt;")


def write_all(folder: Path) -> dict[str, Path]:
    """All bad robots, by a name of each."""
    found = {}
    for name, content in files():
        found[name] = folder / name
        found[name].write_bytes(content)
    found["absent"] = folder / "absent.urdf"
    found["unknown"] = Path("4r")
    found["folder"] = folder / "folder.urdf"
    found["folder"].mkdir()
    found["suffix"] = folder / "arm.step"
    for suffix in ("xml", "stl", "urdf"):
        found[f"pipe.{suffix}"] = folder / f"pipe.{suffix}"
        os.mkfifo(found[f"pipe.{suffix}"])
    return found
