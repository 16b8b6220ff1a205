"""The state of a search between two stages, in a file that survives an interruption."""

import hashlib
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from torchid.errors import TorchidError
from torchid.extraction.cma.search import SearchState
from torchid.extraction.problem import Problem
from torchid.files import atomic_write
from torchid.typing import Float, Tensor

if TYPE_CHECKING:
    from torchid.extraction.settings import SearchSettings

_DAMAGED = (OSError, ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile)
"""What NumPy raises on a file that is none of its own, or half of one."""


@dataclass(frozen=True, eq=False)
class Progress:
    """Where a search is.

    Attributes:
        stage: how many stages are done.
        state: of the engine.
        phi, gamma: (R, stage) of the best so far, after each stage.
    """

    stage: int
    state: SearchState
    phi: Float[Tensor, "R K"]
    gamma: Float[Tensor, "R K"]


def save(path: Path, now: Progress, problem: Problem, settings: "SearchSettings") -> None:
    """Write the state; an earlier file is replaced only when the new one is whole.

    Raises:
        TorchidError: the file cannot be written.
    """
    arrays = now.state.to_arrays()
    with atomic_write(path, "wb") as stream:
        np.savez(
            stream,
            stage=np.asarray(now.stage),
            phi=now.phi.numpy(),
            gamma=now.gamma.numpy(),
            of=np.asarray(fingerprint(problem, settings)),
            allow_pickle=False,
            **{f"state_{name}": value for name, value in arrays.items()},
        )


def load(path: Path, problem: Problem, settings: "SearchSettings") -> Progress | None:
    """The state in the file; None if there is no file.

    Raises:
        TorchidError: not a checkpoint, or one of another problem or of other settings.
    """
    if not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        of, stage = str(arrays["of"]), int(arrays["stage"])
        phi, violated = torch.from_numpy(arrays["phi"]), torch.from_numpy(arrays["gamma"])
        state = SearchState.from_arrays(
            {k.removeprefix("state_"): v for k, v in arrays.items() if k.startswith("state_")}
        )
    except (*_DAMAGED, TorchidError) as error:
        raise TorchidError(f"'{path}' is not a checkpoint of an extraction.", got=error) from error
    if of != fingerprint(problem, settings):
        raise TorchidError(
            f"the checkpoint '{path}' belongs to another extraction.",
            got="other base parameters, bounds, conditions or settings",
            expected="the ones it was started with",
            hint="repeat the first command, or start anew without --resume",
        )
    return Progress(stage, state, phi, violated)


def fingerprint(problem: Problem, settings: "SearchSettings") -> str:
    """What a search depends on, as a SHA-256."""
    digest = hashlib.sha256(repr(settings).encode())
    c, target = problem.conditions, problem.target
    for tensor in (
        problem.box, target.weight, target.offset, target.base.grouping,
        c.com_box, c.round_centre, c.round_axes, c.round_radius, c.total_mass,
    ):  # fmt: skip
        digest.update(np.ascontiguousarray(tensor.cpu().numpy()).tobytes())
    return digest.hexdigest()
