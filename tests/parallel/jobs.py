"""Jobs that other processes find."""

import os
import signal
import time
from pathlib import Path

from torchid.parallel.workers import RefusedError


def root(x: float) -> float:
    return x**0.5 if x >= 0 else fail(x)


def fail(x: float) -> float:
    raise ValueError(f"no root of {x}")


def killed(x: float) -> float:
    """A number kills its process every time."""
    if x == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return x


def killed_once(job: tuple[str, int]) -> int:
    """The first time that a job is done, its process is killed."""
    folder, k = job
    mark = Path(folder) / str(k)
    if k == 2 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return k


def refuse(x: float) -> float:
    raise RefusedError("a worker has another torchid than the command.")


def state(_: int) -> tuple[str, str]:
    """Where this works, and with how many threads."""
    return os.getcwd(), os.environ["OMP_NUM_THREADS"]


def tensors(count: int) -> list[object]:
    import torch

    return [torch.full((3,), float(k)) for k in range(count)]


def counted(job: tuple[str, int]) -> int:
    """Leaves a sign in a file each time that it is done."""
    folder, k = job
    with (Path(folder) / str(k)).open("a") as file:
        file.write("x")
    time.sleep(0.5)
    return k
