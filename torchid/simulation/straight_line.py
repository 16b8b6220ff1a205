"""Straight-line code of a calculation on small tensors: the same numbers without a call a tensor.

A step of one arm is some hundred calls of torch on a handful of numbers, each of which costs more
than its arithmetic. Here the code that is written for tensors runs once on arrays of symbols:
products with 0 and 1 vanish, what stands twice is kept once, and the rest is written out as a
Python function of plain floats. What depends on values (a branch, a solver) is not straight.
"""

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

Number = "Symbol | float | bool"


class NotStraightError(Exception):
    """The calculation asks for a value, or for an operation that is not known here."""


class Symbol:
    """A number that is not known yet, as an expression of others.

    Attributes:
        text: of the expression, with a place for each argument.
        parts: its arguments, symbols or constants.
        truth: whether it is true or false, and no number.
    """

    __slots__ = ("graph", "late", "parts", "text", "truth")

    def __init__(self, graph: "_Graph", text: str, parts: tuple, truth: bool, late: bool):
        self.graph, self.text, self.parts = graph, text, parts
        self.truth, self.late = truth, late

    def __bool__(self) -> bool:
        raise NotStraightError("a branch depends on a value")

    def __add__(self, other: Any) -> Any:
        return self if _is(other, 0.0) else self.graph.of("{} + {}", self, other)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return self if _is(other, 0.0) else self.graph.of("{} - {}", self, other)

    def __rsub__(self, other: Any) -> Any:
        return -self if _is(other, 0.0) else self.graph.of("{} - {}", other, self)

    def __mul__(self, other: Any) -> Any:
        if _is(other, 0.0):
            return 0.0
        if _is(other, 1.0):
            return self
        return -self if _is(other, -1.0) else self.graph.of("{} * {}", self, other)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        return self if _is(other, 1.0) else self.graph.of("{} / {}", self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return 0.0 if _is(other, 0.0) else self.graph.of("{} / {}", other, self)

    def __neg__(self) -> Any:
        return self.graph.of("-{}", self)


def _is(value: Any, constant: float) -> bool:
    return not isinstance(value, Symbol) and value == constant


class _Graph:
    """All expressions, each once."""

    def __init__(self) -> None:
        self.known: dict[tuple, Symbol] = {}

    def of(self, text: str, *parts: Any, truth: bool = False, late: bool = False) -> Symbol:
        key = (text, *(p if isinstance(p, Symbol) else (type(p), p) for p in parts))
        if key not in self.known:
            late = late or any(isinstance(p, Symbol) and p.late for p in parts)
            self.known[key] = Symbol(self, text, parts, truth, late)
        return self.known[key]


def _applied(text: str, known: Callable[..., Any], truth: bool = False) -> Callable[..., Any]:
    """An operation element by element: an expression of symbols, a value of constants."""

    def one(*parts: Any) -> Any:
        graph = next((p.graph for p in parts if isinstance(p, Symbol)), None)
        return known(*parts) if graph is None else graph.of(text, *parts, truth=truth)

    def every(*arrays: Any) -> np.ndarray:
        count = len(arrays)
        return np.asarray(np.frompyfunc(one, count, 1)(*arrays), dtype=object)

    return every


def _number(x: Any) -> Any:
    truth = x.truth if isinstance(x, Symbol) else isinstance(x, bool)
    return (x.graph.of("float({})", x) if isinstance(x, Symbol) else float(x)) if truth else x


_NUMBER = np.frompyfunc(_number, 1, 1)


def _choose(condition: Any, a: Any, b: Any) -> Any:
    if not isinstance(condition, Symbol):
        return a if condition else b
    same = a is b or (not isinstance(a, Symbol) and not isinstance(b, Symbol) and a == b)
    return a if same else condition.graph.of("{1} if {0} else {2}", condition, a, b)


def _where(condition: Any, a: Any, b: Any) -> np.ndarray:
    return np.asarray(np.frompyfunc(_choose, 3, 1)(condition, a, b), dtype=object)


_SIGN = _applied("({0} > 0.0) - ({0} < 0.0)", lambda x: float((x > 0) - (x < 0)))
_LARGER = _applied("{0} if {0} > {1} else {1}", max)
_SMALLER = _applied("{0} if {0} < {1} else {1}", min)


def _clamped(x: Any, low: Any = None, high: Any = None) -> Any:
    x = x if low is None else _LARGER(x, low)
    return x if high is None else _SMALLER(x, high)


def _function(name: str) -> Callable[..., Any]:
    return _applied(f"{name}({{}})", getattr(math, name))


def _power(x: Any, exponent: Any) -> Any:
    whole = not isinstance(exponent, np.ndarray) and exponent in (1, 2, 3)
    if whole:
        return math.prod([x] * int(exponent - 1), start=x)
    return _applied("{} ** {}", operator.pow)(x, exponent)


def _at(x: np.ndarray, dim: int, index: Any) -> np.ndarray:
    where: list[Any] = [slice(None)] * x.ndim
    where[dim] = index
    return np.asarray(x[tuple(where)], dtype=object)


def _sum(x: Any, dim: Any = None, keepdim: bool = False) -> np.ndarray:
    axes = None if dim is None else tuple(np.atleast_1d(dim).tolist())
    return np.asarray(np.sum(x, axis=axes, keepdims=keepdim), dtype=object)


def _squeezed(x: Any, dim: Any = None) -> np.ndarray:
    dims = range(x.ndim) if dim is None else [d % x.ndim for d in np.atleast_1d(dim)]
    return x.reshape([s for k, s in enumerate(x.shape) if k not in dims or s != 1])


def _diagonal(x: Any, offset: int = 0, dim1: int = 0, dim2: int = 1) -> np.ndarray:
    return np.diagonal(x, offset, dim1, dim2)


def _diag_embed(x: Any, offset: int = 0, dim1: int = -2, dim2: int = -1) -> np.ndarray:
    if offset or (dim1, dim2) != (-2, -1):
        raise NotStraightError("diag_embed")
    n = x.shape[-1]
    out = np.zeros((*x.shape, n), dtype=object) + 0.0
    out[..., range(n), range(n)] = x
    return out


def _filled(value: Any) -> Callable[..., np.ndarray]:
    def like(x: Any, *_: Any, **__: Any) -> np.ndarray:
        return np.full(x.shape, value, dtype=object)

    return like


def _matmul(a: Any, b: Any) -> np.ndarray:
    return np.asarray(np.matmul(a, b), dtype=object)


def _flatten(x: Any, start_dim: int = 0, end_dim: int = -1) -> np.ndarray:
    first, last = start_dim % max(x.ndim, 1), end_dim % max(x.ndim, 1)
    return x.reshape((*x.shape[:first], -1, *x.shape[last + 1 :]))


def _unflatten(x: Any, dim: int, sizes: Sequence[int]) -> np.ndarray:
    dim %= x.ndim
    return x.reshape((*x.shape[:dim], *sizes, *x.shape[dim + 1 :]))


def _sizes(given: Sequence[Any]) -> Sequence[int]:
    return given[0] if len(given) == 1 and not isinstance(given[0], int) else given


def _expand(x: Any, *given: Any) -> np.ndarray:
    sizes = _sizes(given)
    own = (1,) * (len(sizes) - x.ndim) + x.shape
    return np.broadcast_to(
        x, [s if want == -1 else want for s, want in zip(own, sizes, strict=True)]
    )


def _index(x: Any, where: Any) -> np.ndarray:
    """Of constant indices only."""
    places = where if isinstance(where, tuple) else (where,)
    constant = tuple(np.array(p.tolist()) if isinstance(p, np.ndarray) else p for p in places)
    return np.asarray(x[constant], dtype=object)


_OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": lambda a, b, alpha=1: a + b * alpha, "radd": lambda a, b: b + a,
    "sub": lambda a, b, alpha=1: a - b * alpha, "rsub": lambda a, b: b - a,
    "mul": operator.mul, "rmul": operator.mul, "multiply": operator.mul,
    "div": operator.truediv, "truediv": operator.truediv,
    "rdiv": lambda a, b: b / a, "rtruediv": lambda a, b: b / a,
    "neg": operator.neg,
    "addcmul": lambda x, a, b, value=1: x + a * b * value,
    "lerp": lambda a, b, weight: a + (b - a) * weight,
    "square": lambda x: x * x,
    "pow": _power, "rpow": lambda a, b: _power(b, a),
    "abs": _applied("abs({})", abs),
    "sign": _SIGN, "sgn": _SIGN,
    "maximum": _LARGER, "minimum": _SMALLER,
    "clamp": lambda x, min=None, max=None: _clamped(x, min, max), "clamp_min": _clamped,
    "reciprocal": lambda x: 1.0 / x,
    "remainder": _applied("{} % {}", operator.mod), "mod": _applied("{} % {}", operator.mod),
    "where": _where,
    "lt": _applied("{} < {}", operator.lt, True), "le": _applied("{} <= {}", operator.le, True),
    "gt": _applied("{} > {}", operator.gt, True), "ge": _applied("{} >= {}", operator.ge, True),
    "eq": _applied("{} == {}", operator.eq, True), "ne": _applied("{} != {}", operator.ne, True),
    **dict.fromkeys(("and", "logical_and", "bitwise_and"),
                    _applied("{} and {}", lambda a, b: a and b, True)),
    **dict.fromkeys(("or", "logical_or", "bitwise_or"),
                    _applied("{} or {}", lambda a, b: a or b, True)),
    **dict.fromkeys(("invert", "logical_not", "bitwise_not"),
                    _applied("not {}", operator.not_, True)),
    **{name: _function(name) for name in (
        "sin", "cos", "tan", "tanh", "exp", "log", "sqrt", "atan", "floor", "log1p", "expm1",
        "sinh", "cosh", "atan2",
    )},
    "matmul": _matmul, "mm": _matmul, "bmm": _matmul,
    "rmatmul": lambda a, b: _matmul(b, a),
    "sum": _sum,
    "cumsum": lambda x, dim: np.add.accumulate(x, axis=dim),
    "cat": lambda parts, dim=0: np.concatenate(parts, dim),
    "stack": lambda parts, dim=0: np.stack(parts, dim),
    "broadcast_tensors": lambda *parts: list(np.broadcast_arrays(*parts)),
    "flip": lambda x, *dims: np.flip(x, tuple(_sizes(dims))),
    "view": lambda x, *sizes: x.reshape(_sizes(sizes)),
    "reshape": lambda x, *sizes: x.reshape(_sizes(sizes)),
    "flatten": _flatten, "unflatten": _unflatten,
    "expand": _expand, "expand_as": lambda x, other: np.broadcast_to(x, other.shape),
    "transpose": np.swapaxes,
    "unsqueeze": np.expand_dims,
    "squeeze": _squeezed,
    "unbind": lambda x, dim=0: [_at(x, dim, k) for k in range(x.shape[dim])],
    "diagonal": _diagonal, "diag_embed": _diag_embed,
    "getitem": _index,
    **dict.fromkeys(("clone", "detach", "contiguous"), lambda x, **_: x),
    **dict.fromkeys(("to", "double", "type_as"), lambda x, *_, **__: _NUMBER(x)),
    "zeros_like": _filled(0.0), "ones_like": _filled(1.0),
    "full_like": lambda x, value, **_: np.full(x.shape, value, dtype=object),
    "new_zeros": lambda x, *sizes, **_: np.full(_sizes(sizes), 0.0, dtype=object),
    "new_full": lambda x, sizes, value, **_: np.full(sizes, value, dtype=object),
    "new_tensor": lambda x, values, **_: np.array(values, dtype=object),
    "T": np.transpose, "mT": lambda x: np.swapaxes(x, -1, -2),
}  # fmt: skip
"""By the name of the function, method or attribute, without underscores around it."""
_KNOWN = ("shape", "ndim", "dtype", "device", "dim", "size", "numel", "len", "repr")
"""What a tensor knows of itself without its numbers."""


class Traced(Tensor):
    """A tensor whose numbers are symbols."""

    numbers: np.ndarray

    @staticmethod
    def __new__(cls, numbers: np.ndarray) -> "Traced":
        """Of symbols and constants, in the array's shape."""
        first = numbers.flat[0] if numbers.size else 0.0
        truth = first.truth if isinstance(first, Symbol) else isinstance(first, bool)
        kind = torch.bool if truth else torch.float64
        made = torch.zeros(numbers.shape, dtype=kind).as_subclass(cls)
        made.numbers = numbers
        return made

    @classmethod
    def __torch_function__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        # Not one level below (`__torch_dispatch__`), where torch 2.13 loads sympy first.
        name = getattr(func, "__name__", "").strip("_")
        if name == "get":
            name = func.__self__.__name__
        if name in _KNOWN:
            with torch._C.DisableTorchFunctionSubclass():
                return func(*args, **(kwargs or {}))
        if name not in _OPERATIONS:
            raise NotStraightError(name)
        found = _OPERATIONS[name](*map(_array, args), **{
            key: _array(value) for key, value in (kwargs or {}).items()
        })  # fmt: skip
        if isinstance(found, list):
            return [Traced(x) for x in found]
        return Traced(np.asarray(found, dtype=object))


def _array(x: Any) -> Any:
    """Numbers of tensors; constants as they are."""
    if isinstance(x, Traced):
        return x.numbers
    if isinstance(x, Tensor):
        return np.array(x.tolist(), dtype=object).reshape(x.shape)
    if isinstance(x, list | tuple) and any(isinstance(part, Tensor) for part in x):
        return type(x)(map(_array, x))
    return x


class StraightLine:
    """A calculation as two functions of plain numbers.

    Args:
        calculation: takes a tensor for each input and returns tensors.
        inputs: shape of each.
        late: names of the inputs that change more often than the others.

    Attributes:
        shapes: of the results.

    Raises:
        NotStraightError: it branches, or has an operation that is not known here.
    """

    def __init__(
        self,
        calculation: Callable[..., Sequence[Tensor]],
        inputs: Mapping[str, tuple[int, ...]],
        late: Sequence[str] = (),
    ):
        graph = _Graph()
        given = {}
        for name, shape in inputs.items():
            count = math.prod(shape)
            symbols = [graph.of(f"{name}_{k}", late=name in late) for k in range(count)]
            numbers = np.empty(count, dtype=object)
            numbers[:] = symbols
            given[name] = Traced(numbers.reshape(shape))
        results = [_array(x) for x in calculation(**given)]
        self.shapes = [x.shape for x in results]
        asked = [number for x in results for number in x.reshape(-1).tolist()]
        names = {
            kind: [f"{n}_{k}" for n, s in inputs.items() if (n in late) is kind
                   for k in range(math.prod(s))]
            for kind in (False, True)
        }  # fmt: skip
        self._early, self._late = _written(asked, names[False], names[True])

    def early(self, *numbers: float) -> tuple[float, ...]:
        """What the inputs that are not late determine, for `late`."""
        return self._early(numbers)

    def late(self, known: tuple[float, ...], *numbers: float) -> tuple[float, ...]:
        """All results, one after the other."""
        return self._late(known, numbers)


def _written(
    asked: Sequence[Any], first: Sequence[str], second: Sequence[str]
) -> tuple[Callable, Callable]:
    """Functions that evaluate what does not depend on late inputs, and then the rest."""
    order: list[Symbol] = []
    seen: set[int] = set()
    pending = [(s, False) for s in reversed(asked) if isinstance(s, Symbol)]
    while pending:  # depth first, without recursion
        symbol, done = pending.pop()
        if done:
            order.append(symbol)
        elif id(symbol) not in seen:
            seen.add(id(symbol))
            pending.append((symbol, True))
            pending += [(p, False) for p in reversed(symbol.parts) if isinstance(p, Symbol)]
    names = {id(s): s.text if not s.parts else f"v{k}" for k, s in enumerate(order)}

    def text(value: Any) -> str:
        if isinstance(value, Symbol):
            return names[id(value)]
        value = float(value) if not isinstance(value, bool) else value
        return f"({value!r})" if math.isfinite(value) else f"float('{value}')"

    def lines(late: bool) -> list[str]:
        return [
            f" {names[id(s)]} = {s.text.format(*map(text, s.parts))}"
            for s in order
            if s.parts and s.late is late
        ]

    used = {id(p) for s in order if s.late for p in s.parts if isinstance(p, Symbol)}
    used |= {id(s) for s in asked if isinstance(s, Symbol)}
    shared = [names[id(s)] for s in order if id(s) in used and not s.late]
    source = [
        "def early(given):", *_unpacked(first, "given"), *lines(False),
        f" return ({''.join(x + ', ' for x in shared)})",
        "def late(known, given):", *_unpacked(shared, "known"), *_unpacked(second, "given"),
        *lines(True), f" return ({''.join(text(x) + ', ' for x in asked)})",
    ]  # fmt: skip
    space: dict[str, Any] = {**vars(math)}
    exec(compile("\n".join(source), "<straight line>", "exec"), space)
    return space["early"], space["late"]


def _unpacked(names: Sequence[str], source: str) -> list[str]:
    return [f" ({''.join(name + ', ' for name in names)}) = {source}"] if names else []
