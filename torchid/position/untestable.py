"""Effects that the motions of a log would not have shown, by what nothing else could have done."""

from dataclasses import replace

import torch

from torchid.effects.servo import INDEX, PARAMETERS, PER_KP, TORQUES, as_share
from torchid.position.effects import EFFECTS
from torchid.position.fit import errors, sensitivities, weights
from torchid.position.judge import Equations
from torchid.position.servo_model import Motions
from torchid.results.answer import NotTestable
from torchid.typing import Bool, Tensor

USUAL = {p.name: p.usual for p in PARAMETERS if p.usual is not None}
"""Sizes that servos have, torques as shares of kp."""


def not_testable(
    motions: Motions, known: Equations, moves: Bool[Tensor, " n"]
) -> tuple[NotTestable, ...]:
    """Effects that no joint's answer has and that, at a usual size, would move it by less than what
    calls for a cause, beside what all that is fitted could make up for.

    Args:
        motions: as the search looks at them.
        known: the answer.
        moves: joints that do.
    """
    data, windows = motions.data, motions.windows
    servos, names = known.servos, known.names
    asked = [e for e in EFFECTS if e.parameters and e.parameters[0] in USUAL]
    joint = servos.joint.repeat(len(asked), 1, 1)
    for row, effect in zip(joint, asked, strict=True):
        name = effect.parameters[0]
        size = USUAL[name] * (servos.of("kp") if name in TORQUES else 1.0)
        column = row[:, INDEX[name]]
        column += size
        for k in map(INDEX.__getitem__, effect.parameters[1:]):  # a shape that is none yet
            p = PARAMETERS[k]
            row[:, k] = torch.where(row[:, k] == p.neutral, p.start, row[:, k])
    sets = replace(servos, joint=joint, plane=servos.plane.repeat(len(joint), 1))
    s = sensitivities(data, servos, names, windows)
    change = errors(data, sets, windows) - s.residual[..., None]
    root = weights(s.residual, windows).sqrt()[..., None]
    least = motions.slight.sqrt()
    out = []
    for j in moves.nonzero().flatten().tolist():
        on = known.mask[j]
        fitted, wanted = ((x[:, :, j] * root[:, :, j]).flatten(0, 1) for x in (s.slope, change))
        fitted = fitted[:, on]
        gram = fitted.T @ fitted + known.prior[j, on].diag()
        left = wanted - fitted @ torch.linalg.solve(gram, fitted.T @ wanted)
        shares = left.square().sum(0).sqrt() / least[j]
        for effect, share in zip(asked, shares.tolist(), strict=True):
            name = effect.parameters[0]
            if (name in names and bool(on[names.index(name)])) or share >= 1:
                continue
            unit = PARAMETERS[INDEX[name]].unit
            if name in TORQUES:
                name, unit = as_share(name), PER_KP[unit]
            size = USUAL[effect.parameters[0]]
            seen = 1e3 * share * float(data.slight[j] / data.scale[j])
            reason = (
                f"{name} of {size:g} moves it by {seen:.2g} mrad that nothing else could have done"
            )
            smallest = size / share if share > 1e-3 else None
            out.append(NotTestable(effect.name, (j,), smallest, unit, reason))
    return tuple(out)
