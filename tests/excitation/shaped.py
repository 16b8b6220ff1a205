"""URDFs of arms with collision shapes."""

import numpy as np
from lxml import etree
from lxml.builder import E

from torchid.robot.library import load_robot
from torchid_bench.withheld.plant.arms import arm_named, spaced, urdf
from torchid_bench.withheld.plant.bodies import Box

TURN = {"x": "0 1.5707963267948966 0", "y": "1.5707963267948966 0 0", "z": "0 0 0"}


def collision(solid):
    """<collision> of a box or cylinder of the withheld arms."""
    if isinstance(solid, Box):
        shape, turn = E.box(size=spaced(solid.sizes)), "0 0 0"
    else:
        shape = E.cylinder(radius=str(solid.radius), length=str(solid.length))
        turn = TURN[solid.axis]
    return E.collision(E.origin(xyz=spaced(solid.centre), rpy=turn), E.geometry(shape))


def shaped_arm(name, folder, friction=0.0):
    """A withheld arm on a pedestal, drawn with the solids that its links are made of."""
    arm = arm_named(name)
    none = np.zeros(arm.n)
    root = etree.fromstring(urdf(arm, none + friction, none + friction).encode())
    root[0].append(E.collision(E.origin(xyz="0 0 -0.2"), E.geometry(E.box(size="0.25 0.25 0.4"))))
    for k, joint in enumerate(arm.joints, start=1):
        link = root.find(f"link[@name='link{k}']")
        link.extend([collision(solid) for solid in joint.solids])
    path = folder / f"{name}.urdf"
    path.write_bytes(etree.tostring(root, pretty_print=True))
    return path


def loaded(name, folder, **more):
    """The same, read."""
    return load_robot(shaped_arm(name, folder, **more))
