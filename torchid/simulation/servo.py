"""Position servos of an arm: what they are, as numbers.

A servo turns a commanded position into a torque, and only the joint's position answers:

    J ddq + M(q) ddq + h(q, dq) = f clip(kp e + ki int e dt + kd (dx - dq) - s b dq) - (1 - s) b dq
                                  - friction + rest

f = 1 - sum of |torques| / supply is what the supply that all share has left of its voltage [2], and
with s = 0, as of a motor that is driven by a voltage, the limit of torque falls with speed, by b.
e = z(x - q). x is the set-point: the command, late by a delay, through a profile of limited
acceleration and speed and a filter of first order. z has a dead zone. The friction holds a joint at
rest with anything up to its dry part F, of the torques m of the motor and l from outside [1]:

    F = coulomb + |load_share l - motor_share m|
        + (stiction + stiction_share |l - m|) exp(-|dq / stribeck_speed|^stribeck_exponent)

[1] Duclusaud, Passault, Padois, Ly 2025, Extended friction models for the physics simulation of
servo actuators (ICRA): its models M1 to M4, and M5 where the two shares that fade are one.
[2] better-actuator-models 1.0.2, MujocoController: vin - vin_drop_resistance sum |torque| / kt.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchid.effects.servo import INDEX, NAMES, PARAMETERS, PLANE
from torchid.errors import TorchidError
from torchid.typing import Float


@dataclass(frozen=True, eq=False)
class Servos:
    """The servos of an arm with n joints, or a batch of them.

    Attributes:
        joint: (*batch, n, K) values of `PARAMETERS`, in their order.
        plane: (*batch, 5) values of `PLANE`, a horizontal plane that a point of a link may touch;
            without effect where the stiffness is 0.
        link: which link carries that point, counted from 0.
        repeated: whether a command that is sent again ends the set-point's profile at once.
    """

    joint: Float[Tensor, "*batch n K"]
    plane: Float[Tensor, "*batch 5"]
    link: int = -1
    repeated: bool = False

    @classmethod
    def neutral(cls, n: int, **values: float) -> "Servos":
        """Servos with these values on every joint, and no other effect."""
        joint = torch.tensor([[values.get(p.name, p.neutral) for p in PARAMETERS]] * n)
        return cls(joint.to(torch.float64), torch.zeros(5, dtype=torch.float64))

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.joint.shape[-2]

    def of(self, name: str) -> Float[Tensor, "*batch n"]:
        """One parameter of every joint."""
        return self.joint[..., INDEX[name]]

    def keeping(self, names: Collection[str]) -> "Servos":
        """Without the effect of any other parameter; a `plane` is one, too."""
        kept = torch.tensor([name in names for name in NAMES])
        neutral = torch.tensor([p.neutral for p in PARAMETERS], dtype=self.joint.dtype)
        plane = self.plane * ("plane" in names)
        return replace(self, joint=torch.where(kept, self.joint, neutral), plane=plane)

    def record(self) -> dict[str, object]:
        """As yaml and JSON hold them; one set, without what has no effect."""
        rows = []
        for j in range(self.n):
            row = {"joint": j + 1}
            for p, value in zip(PARAMETERS, self.joint[j].tolist(), strict=True):
                if value != p.neutral:
                    row[p.name] = value
            rows.append(row)
        out: dict[str, object] = {"joints": rows, "repeated_command_ends_profile": self.repeated}
        if self.plane[4] > 0:
            out["plane"] = {"link": self.link + 1} | dict(
                zip(PLANE, self.plane.tolist(), strict=True)
            )
        return out

    @classmethod
    def from_record(cls, data: Mapping[str, object], n: int, source: str) -> "Servos":
        """Servos of a record, as `record` writes it.

        Raises:
            TorchidError: another number of joints, an unknown parameter, or no number.
        """
        try:
            rows, plane = data["joints"], data.get("plane") or {}
            out = cls.neutral(n)
            if [row["joint"] for row in rows] != list(range(1, n + 1)):  # type: ignore[attr-defined]
                raise TorchidError(
                    f"'{source}': servos of other joints than the robot's.",
                    got=[row["joint"] for row in rows],  # type: ignore[attr-defined]
                    expected=f"1 to {n}",
                )
            for row in rows:  # type: ignore[attr-defined]
                for name in row:
                    if name != "joint":
                        out.joint[int(row["joint"]) - 1, INDEX[name]] = float(row[name])
            for k, name in enumerate(PLANE if plane else ()):
                out.plane[k] = float(plane[name])  # type: ignore[index]
            link = int(plane.get("link", 0)) - 1  # type: ignore[attr-defined]
            return cls(out.joint, out.plane, link, bool(data["repeated_command_ends_profile"]))
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise TorchidError(
                f"'{source}': its servos cannot be read.", got=repr(error), available=list(NAMES)
            ) from error
