"""What stands for the masses of a robot that has none: every link an even rod of one kilogram a
metre, from its joint to the next one.

Gravity then has a shape, which tells servo gains and dry friction in their ratios to it; what one
of them is in N m is left open.
"""

import torch

from torchid.robot.inertia import InertialParameters, six
from torchid.robot.model import Robot
from torchid.robot.shapes import next_origins

PER_METRE = 1.0
"""Mass of a rod [kg/m]."""
SHORTEST, THICK = 0.05, 0.02
"""Length that the shortest links are given, and radius of gyration about their own axis [m]."""


def with_rods(robot: Robot) -> Robot:
    """The robot with rods as its inertial parameters.

    >>> import torchid
    >>> arm = with_rods(torchid.load_robot("ur10e"))
    >>> [round(m, 2) for m in arm.parameters.mass.tolist()]
    [0.18, 0.61, 0.57, 0.17, 0.12, 0.12]
    """
    # Ends of each rod, in its link's frame: the axis it turns about, and where the next one begins.
    near = -(robot.after[:, :3, :3].mT @ robot.after[:, :3, 3:])[..., 0]
    far = next_origins(robot)
    along = far - near
    length = along.norm(dim=-1).clamp(min=SHORTEST)
    mass = PER_METRE * length
    # m (l^2 / 12 (1 - d d') + r^2 1).
    straight = length.square()[:, None, None] * torch.eye(3, dtype=along.dtype)
    about = (straight - along[:, :, None] * along[:, None, :]) / 12
    about = mass[:, None, None] * (about + THICK**2 * torch.eye(3, dtype=along.dtype))
    bodies = InertialParameters.from_com(mass, (near + far) / 2, six(about))
    return robot.with_parameters(bodies)
