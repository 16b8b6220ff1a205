"""Numbers as users have them (tensors, arrays, lists), as tensors: at the doors of the library."""

import ctypes
from contextlib import suppress
from typing import Any

import numpy as np
import torch

from torchid.errors import TorchidError
from torchid.typing import Numbers, Tensor


def as_tensor(values: Any, what: str, error: type[TorchidError] = TorchidError) -> Tensor:
    """A floating tensor of what a user gives.

    A floating tensor stays as it is: its dtype and device are the user's choice. All else becomes
    float64, for torch's own default of float32 would lose half the digits of a list.

    Args:
        values: a tensor, an array, or lists of numbers.
        what: what it is called in the message.
        error: that is raised.

    Raises:
        TorchidError: no table of real numbers.
    """
    if isinstance(values, torch.Tensor):
        if values.is_complex():
            raise error(f"{what} must be real numbers.", got=str(values.dtype))
        return values if values.is_floating_point() else values.double()
    try:
        array = np.asarray(values)
        if array.dtype.kind not in "biuf":
            # Objects and strings only if each of them is a number; complex numbers are none.
            array = _floats(array)
        return torch.from_numpy(np.array(array, dtype=np.float64))
    except (TypeError, ValueError, RuntimeError) as problem:
        raise error(
            f"{what} must be a table of numbers.",
            got=type(values).__name__,
            expected="a tensor, an array or lists of numbers, all rows of one length",
        ) from problem


def _floats(array: np.ndarray) -> np.ndarray:
    # Lists of tensors may be numbers; None is none, though numpy makes nan of it.
    if array.dtype.kind != "O" or any(x is None for x in array.flat):
        raise TypeError(f"{array.dtype} is no number")
    return array.astype(np.float64)


def require_count(count: object, what: str, least: int = 1) -> None:
    """Raise TorchidError unless this is a whole number, and no larger than anybody can use."""
    # Draws that can be asked for
    most = 100_000
    if type(count) is not int or not least <= count <= most:
        wanted = f"a whole number, {least} to {most}"
        raise TorchidError(f"so many {what} cannot be drawn.", got=[count], expected=wanted)


def give_back_memory() -> None:
    """Return what was freed to the system: the GNU C library keeps it for arrays of the same size,
    and what follows on a long log makes others. Nothing where there is another library."""
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def usable_device(name: str) -> str:
    """A device that exists and has float64.

    Raises:
        TorchidError: no such device.
    """
    try:
        torch.zeros(1, dtype=torch.float64, device=name)
    except (RuntimeError, AssertionError, TypeError) as error:
        raise TorchidError(
            f"device '{name}' cannot be used.",
            got=str(error).splitlines()[0],
            available=["cpu", *(f"cuda:{k}" for k in range(torch.cuda.device_count()))],
        ) from error
    return name


def joint_signals(n: int, **signals: Numbers) -> list[Tensor]:
    """Signals (..., n) of one robot as tensors of one dtype, the widest, on one device.

    Args:
        n: number of joints.
        signals: by name; (..., n) each.

    Raises:
        TorchidError: no numbers, not one column a joint, or lengths that do not go together.
    """
    tensors = {name: as_tensor(values, name) for name, values in signals.items()}
    for name, tensor in tensors.items():
        if tensor.ndim == 0 or tensor.shape[-1] != n:
            raise TorchidError(
                f"{name} must have one column a joint.",
                got=f"shape {tuple(tensor.shape)}",
                expected=f"(..., {n})",
            )
    try:
        # Not torch.broadcast_shapes, whose first call imports sympy: more than a second.
        np.broadcast_shapes(*(tensor.shape for tensor in tensors.values()))
    except ValueError as error:
        raise TorchidError(
            f"{', '.join(tensors)} do not go together.",
            got=f"shapes {', '.join(str(tuple(tensor.shape)) for tensor in tensors.values())}",
            expected=f"as many samples of each, or one: (..., {n})",
        ) from error
    dtype = torch.float32
    for tensor in tensors.values():
        dtype = torch.promote_types(dtype, tensor.dtype)
    # What was no tensor goes where the tensors are.
    places = [tensors[k].device for k, v in signals.items() if isinstance(v, torch.Tensor)]
    where = places[0] if places else torch.device("cpu")
    return [
        tensor.to(dtype=dtype, device=tensor.device if isinstance(given, torch.Tensor) else where)
        for tensor, given in zip(tensors.values(), signals.values(), strict=True)
    ]
