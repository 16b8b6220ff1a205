"""The same dynamics through torch.compile: opt-in, 7 to 10 times faster than eager on a CPU.

The source is the one recursion: it is run once on symbolic tensors of a fixed chunk size (so that
the geometry's floats fold as in eager mode), and the recorded graph is compiled into one loop over
samples. Compiling takes up to a minute the first time and seconds from Inductor's disk cache; it
pays from about 1e7 samples, or with many repeats.

Inertial parameters are inputs of the compiled code: new values do not compile again. A new robot,
dtype or device does. Results carry no gradient; use the eager functions for that.
"""

import os
import shutil
import sys
from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import torch
import torch._inductor
from torch import Tensor
from torch.fx.experimental.proxy_tensor import make_fx

from torchid.dynamics.newton_euler import keep_freed_memory
from torchid.dynamics.recursion import chain_geometry, forces, kinematics, regressor_rows
from torchid.dynamics.regressor import RegressorChunk
from torchid.errors import TorchidError
from torchid.robot.inertia import PARAMETERS_PER_LINK, InertialParameters
from torchid.robot.model import Robot
from torchid.typing import BroadcastJoints, Float, Joints

TORQUE_CHUNK = 12360
REGRESSOR_CHUNK = 2056
"""Samples a compiled loop handles at a time; a shorter tail is padded. The regressor's 250 outputs
want to stay in the cache, torques are few. Not powers of two, whose strides share cache lines."""

_TOGETHER = 16
"""Chunks whose motion is transposed at a time."""

_OPTIONS: dict[str, str | int | bool | Callable[..., Any]] = {
    # One loop over the samples, with no intermediate written to memory.
    "max_fusion_size": 5000,
    # a * b + c in one instruction.
    "cpp.enable_floating_point_contract_flag": "fast",
    # The regressor's outputs are set up in C++, not in Python: a fifth of its time.
    "cpp_wrapper": True,
}
_COMPILERS = ("cl", "icx-cl") if sys.platform == "win32" else ("g++", "clang++", "c++")

Kernel = Callable[..., Tensor]


@lru_cache(maxsize=16)
def compiled_dynamics(robot: Robot, chunk: int | None = None) -> "CompiledDynamics":
    """The robot's compiled dynamics, made once per robot and chunk size.

    Args:
        robot: kinematics and gravity.
        chunk: samples the compiled loops handle at a time; by default the sizes that are fastest.

    Raises:
        TorchidError: no C++ compiler on this machine.
    """
    return CompiledDynamics(robot, chunk)


class CompiledDynamics:
    """Inverse dynamics and regressor of one robot as compiled loops (see `compiled_dynamics`).

    Each function compiles when it is first called. Any number of samples is handled in chunks of
    one size, the last one padded, so that nothing ever compiles for another length.

    Attributes:
        robot: whose dynamics it is.
    """

    def __init__(self, robot: Robot, chunk: int | None = None):
        _require_compiler()
        self.robot = robot
        self._sizes = {"torques": chunk or TORQUE_CHUNK, "regressor": chunk or REGRESSOR_CHUNK}
        self._geometry = chain_geometry(robot)
        self._kernels: dict[tuple[str, torch.dtype, torch.device], Kernel] = {}
        self._layout: list[dict[int, tuple[int | float, ...]]] = []

    @torch.no_grad()
    def inverse_dynamics(
        self,
        q: BroadcastJoints,
        dq: BroadcastJoints,
        ddq: BroadcastJoints,
        parameters: InertialParameters | None = None,
    ) -> Joints:
        """Joint torques (..., n) [N m; N]; see `torchid.dynamics.inverse_dynamics`.

        Args:
            q, dq, ddq: (..., n) [rad, rad/s, rad/s^2; m for prismatic joints].
            parameters: one set (L, 10); the robot's nominal ones if None.

        Raises:
            RobotError: no parameters given and none in the robot.
            TorchidError: a batch of parameter sets.
        """
        given = parameters or self.robot.require_parameters("inverse dynamics")
        if given.pi.ndim != 2:
            raise TorchidError(
                "the compiled inverse dynamics takes one set of parameters at a time.",
                got=f"parameters of shape {tuple(given.pi.shape)}",
                expected=f"({self.robot.n_links}, {PARAMETERS_PER_LINK})",
                hint="call it set by set, or use torchid.dynamics.inverse_dynamics",
            )
        pi = given.pi.detach().to(q).contiguous()
        q, dq, ddq = torch.broadcast_tensors(q, dq, ddq)
        batch, n = q.shape[:-1], q.shape[-1]
        pieces = [
            self._kernel("torques", q)(*motion, pi)[:, :count].T
            for motion, count in self._padded("torques", *(x.reshape(-1, n) for x in (q, dq, ddq)))
        ]
        return torch.cat(pieces).reshape(*batch, n) if pieces else torch.zeros_like(q)

    @torch.no_grad()
    def regressor_chunks(
        self, q: Float[Tensor, "M n"], dq: Float[Tensor, "M n"], ddq: Float[Tensor, "M n"]
    ) -> Iterator[RegressorChunk]:
        """The regressor of M samples in chunks, non-zeros only.

        Args:
            q, dq, ddq: (M, n) [rad, rad/s, rad/s^2; m for prismatic joints].

        Yields:
            What `torchid.dynamics.regressor.regressor_chunks` yields.
        """
        for motion, count in self._padded("regressor", q, dq, ddq):
            entries = self._kernel("regressor", q)(*motion)[:, :count]
            yield RegressorChunk(self._layout, entries[0], entries)

    def _padded(self, name: str, *signals: Tensor) -> Iterator[tuple[list[Tensor], int]]:
        """Chunks as contiguous (n, chunk) tensors, each with its number of true samples."""
        keep_freed_memory()
        size, total = self._sizes[name], signals[0].shape[0]
        for first in range(0, total, _TOGETHER * size):
            blocks = [_transposed(x[first : first + _TOGETHER * size], size) for x in signals]
            for k, motion in enumerate(zip(*blocks, strict=True)):
                yield list(motion), min(size, total - first - k * size)

    def _kernel(self, name: str, like: Tensor) -> Kernel:
        key = (name, like.dtype, like.device)
        if key not in self._kernels:
            n = self.robot.n
            motion = [like.new_zeros(n, self._sizes[name]) for _ in range(3)]
            if name == "torques":
                pi = like.new_zeros(self.robot.n_links, PARAMETERS_PER_LINK)
                self._kernels[key] = _compile(self._torques, *motion, pi)
            else:
                self._kernels[key] = _compile(self._entries, *motion)
        return self._kernels[key]

    def _torques(self, q: Tensor, dq: Tensor, ddq: Tensor, pi: Tensor) -> Tensor:
        """Torques (n, m) of motions (n, m) and parameters (L, 10)."""
        links = kinematics(self._geometry, q.unbind(0), dq.unbind(0), ddq.unbind(0))
        torques, _ = forces(self._geometry, links, [link.unbind(0) for link in pi.unbind(0)])
        full = [t if isinstance(t, Tensor) else torch.full_like(q[0], t) for t in torques]
        return torch.stack([t.expand_as(q[0]) for t in full])

    def _entries(self, q: Tensor, dq: Tensor, ddq: Tensor) -> Tensor:
        """The regressor's entries that depend on the motion (E, m); notes where each belongs."""
        found: list[Tensor] = []

        def place(entry: Tensor | float) -> int | float:
            if not isinstance(entry, Tensor):
                return entry
            found.append(entry)
            return len(found) - 1

        links = kinematics(self._geometry, q.unbind(0), dq.unbind(0), ddq.unbind(0))
        rows = regressor_rows(self._geometry, links)
        self._layout = [
            {link: tuple(place(e) for e in entries) for link, entries in row.items()}
            for row in rows
        ]
        return torch.stack(found)


def _transposed(x: Float[Tensor, "m n"], size: int) -> Float[Tensor, "k n {size}"]:
    """Chunks of `size` samples, each transposed, with zeros behind the last."""
    padded = torch.nn.functional.pad(x, (0, 0, 0, -x.shape[0] % size))
    return padded.reshape(-1, size, x.shape[1]).transpose(1, 2).contiguous()


def _compile(function: Callable[..., Tensor], *examples: Tensor) -> Kernel:
    """Record the function's operations on tensors like the examples, and compile the record.

    Recorded by make_fx and handed to Inductor, not through Dynamo: the recursion then runs as plain
    Python, constants of the geometry stay constants, and calls have no guards to check, which
    would take a third of a chunk's time.
    """
    _choose_cache_folder()
    # make_fx counts the `self` of a bound method as an input; a partial has none.
    graph = make_fx(partial(function), tracing_mode="fake")(*examples)
    options = _OPTIONS if examples[0].device.type == "cpu" else {}
    with torch.no_grad():
        return torch._inductor.compile(graph, list(examples), options=dict(options))


def _choose_cache_folder() -> None:
    """Keep compiled code per user, not in the temporary folder that a restart empties."""
    if "TORCHINDUCTOR_CACHE_DIR" not in os.environ:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        os.environ["TORCHINDUCTOR_CACHE_DIR"] = str(Path(base) / "torchid" / "inductor")


def _require_compiler() -> None:
    chosen = os.environ.get("CXX")
    if not any(shutil.which(name) for name in ([chosen] if chosen else _COMPILERS)):
        raise TorchidError(
            "compiled dynamics needs a C++ compiler, and none was found.",
            got=f"CXX={chosen}" if chosen else None,
            expected=f"one of {', '.join(_COMPILERS)} on the PATH",
            hint="install one (Debian, Ubuntu: `apt install g++`; macOS: `xcode-select --install`; "
            "Windows: Visual Studio Build Tools), or go without `compiled=True`",
        )
