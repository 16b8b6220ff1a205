"""Axis names of tensors, used in annotations throughout (checked while testing by jaxtyping).

T instants, n joints, L moving links (n, and one for each joint that mimics another), K candidate
parameter sets, P columns of a regressor, B base parameters. `*batch` stands for any number of
leading axes, the same in all tensors of a call; `*#batch` for leading axes that are broadcast, to
the `*batch` of the result.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from torch import Tensor

Joints = Float[Tensor, "*batch n"]
BroadcastJoints = Float[Tensor, "*#batch n"]
Numbers = BroadcastJoints | np.ndarray | Sequence[Any]
"""(..., n), one column a joint, as users have it: a tensor, an array or lists."""
JointMatrix = Float[Tensor, "*batch n n"]
Pi = Float[Tensor, "*batch 10"]
Wrenches = Float[Tensor, "*batch L 6"]
Transforms = Float[Tensor, "*batch 4 4"]
Inertia6 = Float[Tensor, "*batch 6"]
Matrix3 = Float[Tensor, "*batch 3 3"]
Vector3 = Float[Tensor, "*batch 3"]
Signals = Float[Tensor, "*batch T"]
Samples = Float[Tensor, "T n"]

__all__ = [
    "Bool",
    "BroadcastJoints",
    "Float",
    "Inertia6",
    "Int",
    "JointMatrix",
    "Joints",
    "Matrix3",
    "Numbers",
    "Pi",
    "Samples",
    "Signals",
    "Tensor",
    "Transforms",
    "Vector3",
    "Wrenches",
]
