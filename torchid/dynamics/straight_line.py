"""Straight-line code of a function on small tensors: the function itself, run once and recorded.

A kernel call of PyTorch costs about a microsecond and its wrapping some more, whatever it computes;
a product of two Python floats costs ten nanoseconds. Where one arm is stepped ten thousand times,
the calls are all of the time. Here a function written on tensors is run once under a dispatcher
that keeps, beside every tensor, its elements as expressions of the inputs' elements. Moving
elements about (views, stacks, sums over links) then costs nothing any more, products with 0 and 1
vanish, what is computed twice is computed once, and what is left is printed as Python source, one
assignment a line. So there is one description of the physics, and this is its fast form.

The same source runs on floats and on numpy arrays, one element an arm.

A function that branches on the values of tensors, or calls what is not known here, has no such
form. What reads values behind the dispatcher's back (`tolist`) goes unnoticed: whoever uses the
code compares it with the function first.
"""

import math
import operator
import re
import threading
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

Expression = Any
"""A float or bool that is known, or a Node."""
Mirror = np.ndarray
"""Elements of a tensor as expressions."""

_NAME = re.compile(r"\bv\d+\b")


class NoStraightLineError(Exception):
    """The function has no form without branches, or calls what is not known here."""


class Node:
    """A number that depends on the inputs: a template of source, filled with its arguments."""

    __slots__ = ("arguments", "number", "template")

    def __init__(self, number: int, template: str, arguments: tuple[Expression, ...] = ()):
        self.number = number
        self.template = template
        self.arguments = arguments

    def __bool__(self) -> bool:
        raise NoStraightLineError("a branch on a value")

    __float__ = __int__ = __index__ = __bool__


class Code(NamedTuple):
    """What a function became.

    Attributes:
        on_floats, on_arrays: take the elements of the inputs one by one, all floats or all (B,)
            arrays, and return those of the outputs in a tuple. An output that is constant is a
            float in both. On floats, ArithmeticError and ValueError are raised where tensors
            would hold infinities.
        source: of both.
    """

    on_floats: Callable[..., tuple[Any, ...]]
    on_arrays: Callable[..., tuple[Any, ...]]
    source: str


def straight_line(function: Callable[..., Iterable[Tensor]], examples: Sequence[Tensor]) -> Code:
    """Record a function.

    Args:
        function: of tensors like the examples; it returns tensors.
        examples: any values.

    Raises:
        NoStraightLineError: see the module.
    """
    recorder = _Recorder()
    inputs = [name for x in examples for name in recorder.enter(x)]
    with torch.no_grad(), recorder:
        outputs = [e for x in function(*examples) for e in recorder.mirror(x).flat]
    source = _printed(inputs, outputs)
    return Code(
        _executed(source, _ON_FLOATS),
        _executed(source, _ON_ARRAYS),
        source,
    )


class Opaque(NamedTuple):
    """A function that branches, called as a whole from straight-line code.

    Attributes:
        on_tensors: of tensors; it returns one.
        on_floats, on_arrays: the same of the elements, a tuple of floats or of arrays (B,) for each
            tensor; they return those of the result.
    """

    on_tensors: Callable[..., Tensor]
    on_floats: Callable[..., Sequence[float]]
    on_arrays: Callable[..., Sequence[np.ndarray]]

    def __call__(self, *arguments: Tensor) -> Tensor:
        """On tensors; recorded where a recording is going on."""
        recorder: _Recorder | None = getattr(_present, "recorder", None)
        return self.on_tensors(*arguments) if recorder is None else recorder.call(self, arguments)


_present = threading.local()


class _Recorder(TorchDispatchMode):
    """Keeps the elements of every tensor that is made while it is on."""

    def __init__(self) -> None:
        super().__init__()
        self._mirrors: dict[int, Mirror] = {}
        self._alive: list[Tensor] = []  # an id belongs to another tensor once its own is gone
        self._nodes: dict[tuple[Any, ...], Node] = {}
        self._inputs = 0

    def __enter__(self) -> "_Recorder":
        _present.recorder = self
        return super().__enter__()

    def __exit__(self, *exception: Any) -> None:
        _present.recorder = None
        super().__exit__(*exception)

    def enter(self, x: Tensor) -> list[str]:
        """Names of the elements of an input."""
        names = [f"x{self._inputs + k}" for k in range(x.numel())]
        self._inputs += len(names)
        self._keep(x, _mirror_of([Node(-1, name) for name in names], x.shape))
        return names

    def mirror(self, x: Any) -> Mirror:
        """The mirror of a tensor, made of its values where no input is in it."""
        if not isinstance(x, Tensor):
            return np.array(x, dtype=object)
        if id(x) not in self._mirrors:
            self._keep(x, np.asarray(x.detach().cpu().numpy().astype(object)))
        return self._mirrors[id(x)]

    def node(self, template: str, *arguments: Expression) -> Node:
        """One a number: the same of the same is the same."""
        key = (template, *(id(a) if isinstance(a, Node) else (type(a), a) for a in arguments))
        if key not in self._nodes:
            self._nodes[key] = Node(len(self._nodes), template, arguments)
        return self._nodes[key]

    def is_known(self, x: Tensor) -> bool:
        """Whether no input is in it."""
        mirror = self._mirrors.get(id(x))
        return mirror is None or _known(*mirror.flat)

    def call(self, function: Opaque, arguments: Sequence[Tensor]) -> Tensor:
        """An opaque function of recorded tensors; its values are those it really has."""
        _present.recorder = None
        try:
            out = function.on_tensors(*arguments)
        finally:
            _present.recorder = self
        name = function.on_tensors.__name__
        _ON_FLOATS[name], _ON_ARRAYS[name] = function.on_floats, function.on_arrays
        given = [self.node(f"({'{}, ' * m.size})", *m.flat) for m in map(self.mirror, arguments)]
        called = self.node(f"{name}({', '.join(['{}'] * len(given))})", *given)
        elements = [self.node(f"{{}}[{k}]", called) for k in range(out.numel())]
        self._keep(out, _mirror_of(elements, out.shape))
        return out

    def record(
        self, kernel: Any, types: Any, args: tuple[Any, ...] = (), kwargs: Any = None
    ) -> Any:
        """Run a kernel, and do with the elements what it does with the values."""
        kwargs = kwargs or {}
        name = kernel.overloadpacket.__name__
        if getattr(_present, "recorder", None) is None:  # within an opaque function
            return kernel(*args, **kwargs)
        in_place = name.endswith("_") or "out" in kwargs
        handler = _HANDLERS.get(name)
        if handler is None:
            new = name in _FACTORIES or all(map(self.is_known, _tensors(args)))
            if in_place or not new:
                raise NoStraightLineError(name)
            return kernel(*args, **kwargs)
        try:
            mirrors = handler(self, *args, **kwargs)
        except (TypeError, ValueError, IndexError, ArithmeticError) as error:
            raise NoStraightLineError(f"{name}: {error}") from error
        out = kernel(*args, **kwargs)
        if isinstance(out, Tensor):
            if not in_place:  # else the elements were written there
                self._keep(out, mirrors)
        else:
            for x, m in zip(out, mirrors, strict=True):
                self._keep(x, m)
        return out

    def _keep(self, x: Tensor, mirror: Mirror) -> None:
        if tuple(x.shape) != mirror.shape:
            raise NoStraightLineError(f"{mirror.shape} elements of a tensor {tuple(x.shape)}")
        self._mirrors[id(x)] = mirror
        self._alive.append(x)


# Not in the class, where PyTorch would wrap it in what imports its compiler: more than a second.
setattr(_Recorder, "__torch_dispatch__", _Recorder.record)  # noqa: B010


def _mirror_of(elements: Sequence[Expression], shape: Sequence[int]) -> Mirror:
    mirror = np.empty(len(elements), dtype=object)
    mirror[:] = elements
    return mirror.reshape(shape)


def _tensors(arguments: Iterable[Any]) -> Iterable[Tensor]:
    for x in arguments:
        if isinstance(x, list | tuple):
            yield from _tensors(x)
        elif isinstance(x, Tensor):
            yield x


# Arithmetic on expressions.


def _known(*expressions: Expression) -> bool:
    return not any(isinstance(e, Node) for e in expressions)


def _add(r: _Recorder, a: Expression, b: Expression) -> Expression:
    if _known(a, b):
        return a + b
    if _known(a):
        a, b = b, a
    if _known(b):
        return a if b == 0 else r.node("({} + {})", a, float(b))
    if b.template == "(-{})":
        return _subtract(r, a, b.arguments[0])
    if a.template == "(-{})":
        return _subtract(r, b, a.arguments[0])
    return r.node("({} + {})", a, b) if a.number <= b.number else r.node("({} + {})", b, a)


def _subtract(r: _Recorder, a: Expression, b: Expression) -> Expression:
    if a is b:
        return 0.0
    if _known(a, b):
        return a - b
    if _known(b):
        return _add(r, a, -b)
    if _known(a) and a == 0:
        return _negative(r, b)
    if b.template == "(-{})":
        return _add(r, a, b.arguments[0])
    return r.node("({} - {})", a, b)


def _negative(r: _Recorder, a: Expression) -> Expression:
    if _known(a):
        return -a
    if a.template == "(-{})":
        return a.arguments[0]
    if a.template == "({} - {})":
        return _subtract(r, a.arguments[1], a.arguments[0])
    return r.node("(-{})", a)


def _multiply(r: _Recorder, a: Expression, b: Expression) -> Expression:
    if _known(a, b):
        return a * b
    if _known(a):
        a, b = b, a
    if _known(b):
        b = float(b)
        if b in (0.0, 1.0, -1.0):
            return 0.0 if b == 0 else a if b == 1 else _negative(r, a)
        if a.template == "({} * {})" and _known(a.arguments[1]):
            return _multiply(r, a.arguments[0], a.arguments[1] * b)
        if a.template == "(-{})":
            return _multiply(r, a.arguments[0], -b)
        return r.node("({} * {})", a, b)
    if a.template == "(-{})":
        return _negative(r, _multiply(r, a.arguments[0], b))
    if b.template == "(-{})":
        return _negative(r, _multiply(r, a, b.arguments[0]))
    return r.node("({} * {})", a, b) if a.number <= b.number else r.node("({} * {})", b, a)


def _divide(r: _Recorder, a: Expression, b: Expression) -> Expression:
    if _known(a) and a == 0:
        return 0.0
    if not _known(b):
        return r.node("({} / {})", a, b)
    return a / b if _known(a) and b else _multiply(r, a, 1 / b if b else math.inf)


def _where(r: _Recorder, a: Expression, b: Expression, c: Expression) -> Expression:
    if _known(a):
        return b if a else c
    return b if b is c or (_known(b, c) and b == c) else r.node("where({}, {}, {})", a, b, c)


def _both(r: _Recorder, a: Expression, b: Expression) -> Expression:
    if _known(b):
        a, b = b, a
    return (b if a else False) if _known(a) else r.node("({} & {})", a, b)


def _either(r: _Recorder, a: Expression, b: Expression) -> Expression:
    if _known(b):
        a, b = b, a
    return (True if a else b) if _known(a) else r.node("({} | {})", a, b)


def _real(r: _Recorder, a: Expression) -> Expression:
    return float(a) if _known(a) else r.node("({} + 0.0)", a)


def _power(r: _Recorder, a: Expression, b: Expression) -> Expression:
    if _known(b) and b in (1, 2):
        return a if b == 1 else _multiply(r, a, a)
    return _plain("power")(r, a, b)


def _plain(name: str, template: str | None = None) -> Callable[..., Expression]:
    """A function that is known by its name alone."""

    def operation(r: _Recorder, *arguments: Expression) -> Expression:
        if _known(*arguments):
            return _ON_FLOATS[name](*arguments)
        places = ", ".join(["{}"] * len(arguments))
        return r.node(template or f"{name}({places})", *arguments)

    return operation


def _printed(inputs: Sequence[str], outputs: Sequence[Expression]) -> str:
    """One assignment a number that is used more than once, those used once within one another."""
    uses: dict[int, int] = {}
    order: list[Node] = []
    # Arguments have lower numbers than what is made of them.
    waiting = [e for e in outputs if isinstance(e, Node)]
    for node in waiting:
        uses[id(node)] = uses.get(id(node), 0) + 1
        if uses[id(node)] == 1:
            order.append(node)
            waiting.extend(a for a in node.arguments if isinstance(a, Node))
    order.sort(key=lambda node: node.number)
    text: dict[int, tuple[str, int]] = {}
    lines = []

    def shown(e: Expression) -> tuple[str, int]:
        return text[id(e)] if isinstance(e, Node) else (_number(e), 0)

    for node in order:
        parts = [shown(a) for a in node.arguments]
        source, depth = (
            node.template.format(*(p for p, _ in parts)),
            1 + max((d for _, d in parts), default=-1),
        )
        # 25: expressions within one another on one line, which Python's parser bounds
        if depth and (uses[id(node)] > 1 or depth > 25):
            lines.append(f"    v{node.number} = {source}")
            source, depth = f"v{node.number}", 0
        text[id(node)] = source, depth
    lines.append(f"    return ({', '.join(shown(e)[0] for e in outputs)},)")
    return "\n".join([f"def f({', '.join(inputs)}):", *_with_few_names(lines), ""])


def _with_few_names(lines: Sequence[str]) -> list[str]:
    """Names used again once what they held is not: Python keeps few freed floats at hand."""
    last = {name: k for k, line in enumerate(lines) for name in _NAME.findall(line)}
    free: list[str] = []
    now: dict[str, str] = {}
    out = []
    for k, line in enumerate(lines):
        target, *read = _NAME.findall(line) if " = " in line else ["", *_NAME.findall(line)]
        new = {name: now[name] for name in read}
        free += [now.pop(name) for name in dict.fromkeys(read) if last[name] == k]
        if target:
            new[target] = now[target] = free.pop() if free else f"v{len(now)}"
        out.append(_NAME.sub(lambda name: new[name[0]], line))  # noqa: B023
    return out


def _number(x: Any) -> str:
    if isinstance(x, bool):
        return str(x)
    return f"({float(x)!r})" if x < 0 else repr(float(x))


def _executed(source: str, names: dict[str, Any]) -> Callable[..., tuple[Any, ...]]:
    space = {**names, "inf": math.inf, "nan": math.nan}
    exec(compile(source, "<straight line>", "exec"), space)
    function: Callable[..., tuple[Any, ...]] = space["f"]
    return function


# The names in the source.
_FUNCTIONS = (
    "sin",
    "cos",
    "tan",
    "sinh",
    "cosh",
    "tanh",
    "exp",
    "expm1",
    "log",
    "sqrt",
    "floor",
    "isfinite",
)
_COMPARISONS = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}
_ON_FLOATS: dict[str, Callable[..., Any]] = {
    **{name: getattr(math, name) for name in (*_FUNCTIONS, "asin", "atan", "atan2")},
    **{name: getattr(operator, name) for name in (*_COMPARISONS, "mod")},
    "where": lambda condition, a, b: a if condition else b,
    "maximum": lambda a, b: a if a >= b else b,
    "minimum": lambda a, b: a if a <= b else b,
    "sign": lambda a: 1.0 if a > 0.0 else -1.0 if a < 0.0 else 0.0,
    "abs": abs,
    "negate": operator.not_,
    "power": math.pow,
}
_ON_ARRAYS: dict[str, Callable[..., Any]] = {
    **{name: getattr(np, name) for name in _FUNCTIONS},
    **{name: getattr(np, name) for name in ("where", "maximum", "minimum", "sign", "abs", "power")},
    **{"negate": np.logical_not, "asin": np.arcsin, "atan": np.arctan, "atan2": np.arctan2},
}

# What kernels do with elements.


def _elementwise(operation: Callable[..., Expression]) -> Callable[..., Mirror]:
    def handler(r: _Recorder, *arguments: Any, **options: Any) -> Mirror:
        scale = options.pop("alpha", 1)
        if options:
            raise NoStraightLineError(", ".join(options))
        if scale != 1:
            arguments = (arguments[0], _each(r, _multiply, arguments[1], scale))
        return _each(r, operation, *arguments)

    return handler


def _each(r: _Recorder, operation: Callable[..., Expression], *arguments: Any) -> Mirror:
    mirrors = [a if isinstance(a, np.ndarray) else r.mirror(a) for a in arguments]
    ufunc = np.frompyfunc(lambda *e: operation(r, *e), len(mirrors), 1)
    return _array(ufunc(*mirrors))


def _array(x: Any) -> Mirror:
    if isinstance(x, np.ndarray):
        return x
    out = np.empty((), dtype=object)
    out[()] = x
    return out


def _in_place(operation: Callable[..., Expression]) -> Callable[..., Mirror]:
    new = _elementwise(operation)

    def handler(r: _Recorder, target: Tensor, *arguments: Any, **options: Any) -> Mirror:
        mirror = r.mirror(target)
        mirror[...] = new(r, target, *arguments, **options)
        return mirror

    return handler


def _as_is(view: Callable[..., Any]) -> Callable[..., Any]:
    """A kernel that moves elements about: the same with numpy."""

    def handler(r: _Recorder, x: Tensor, *arguments: Any, **options: Any) -> Any:
        return view(r.mirror(x), *arguments, **options)

    return handler


def _joined(join: Callable[..., Mirror]) -> Callable[..., Mirror]:
    return lambda r, xs, dim=0: join([r.mirror(x) for x in xs], dim)


def _slice(
    m: Mirror, dim: int = 0, start: int | None = None, end: int | None = None, step: int = 1
) -> Mirror:
    return m[(slice(None),) * (dim % m.ndim) + (slice(start, end, step),)]


def _select(m: Mirror, dim: int, index: int) -> Mirror:
    # With the ellipsis a view, even of one element.
    key: Any = (*(slice(None),) * (dim % m.ndim), index, ...)
    return m[key]


def _expand(m: Mirror, size: Sequence[int], implicit: bool = False) -> Mirror:
    lead = len(size) - m.ndim
    return np.broadcast_to(m, [m.shape[k - lead] if s == -1 else s for k, s in enumerate(size)])


def _squeeze(m: Mirror, dim: Any = None) -> Mirror:
    dims = range(m.ndim) if dim is None else [dim] if isinstance(dim, int) else dim
    return np.squeeze(m, tuple(d % m.ndim for d in dims if m.shape[d] == 1))


def _product(r: _Recorder, a: Any, b: Any) -> Mirror:
    """Product of two matrices, or of a matrix and a vector."""
    a, b = r.mirror(a), r.mirror(b)
    if b.ndim == 1:
        return _sum(r, _each(r, _multiply, a, b), -1)
    return _sum(r, _each(r, _multiply, a[..., :, :, None], b[..., None, :, :]), -2)


def _reduced(
    operation: Callable[..., Expression], start: Expression = None
) -> Callable[..., Mirror]:
    def handler(r: _Recorder, x: Any, dim: Any = None, keepdim: bool = False, **_: Any) -> Mirror:
        m = x if isinstance(x, np.ndarray) else r.mirror(x)
        dims = range(m.ndim) if dim is None or dim == [] else [dim] if isinstance(dim, int) else dim
        for d in sorted((d % max(1, m.ndim) for d in dims), reverse=True):
            parts = [m[(slice(None),) * d + (k,)] for k in range(m.shape[d])]
            out = _array(parts[0]) if parts else _array(start)
            for part in parts[1:]:
                out = _each(r, operation, out, _array(part))
            m = np.expand_dims(out, d) if keepdim else out
        return m

    return handler


_sum = _reduced(_add, 0.0)


def _norm(
    r: _Recorder, x: Tensor, order: float = 2, dim: Any = None, keepdim: bool = False
) -> Mirror:
    if order != 2:
        raise NoStraightLineError(f"a norm of order {order}")
    return _each(r, _plain("sqrt"), _sum(r, _each(r, _multiply, x, x), dim, keepdim))


def _cross(r: _Recorder, a: Tensor, b: Tensor, dim: int = -1) -> Mirror:
    one, other = ([np.roll(r.mirror(x), -k, dim) for k in (1, 2)] for x in (a, b))
    return _each(
        r, _subtract, _each(r, _multiply, one[0], other[1]), _each(r, _multiply, one[1], other[0])
    )


def _clamp(r: _Recorder, x: Any, low: Any = None, high: Any = None) -> Mirror:
    m = r.mirror(x)
    m = m if low is None else _each(r, _plain("maximum"), m, low)
    return m if high is None else _each(r, _plain("minimum"), m, high)


def _fused(r: _Recorder, acc: Any, a: Any, b: Any, value: float = 1) -> Mirror:
    product = _each(r, _multiply, a, b)
    return _each(r, _add, acc, _each(r, _multiply, product, value))


def _copied(r: _Recorder, target: Tensor, source: Any, *_: Any) -> Mirror:
    mirror = r.mirror(target)
    mirror[...] = r.mirror(source)
    return mirror


def _cast(r: _Recorder, x: Tensor, *_: Any, dtype: torch.dtype | None = None, **__: Any) -> Mirror:
    if dtype is None or dtype == x.dtype or (x.dtype.is_floating_point and dtype == torch.float64):
        return r.mirror(x).copy()
    if not dtype.is_floating_point and not r.is_known(x):
        raise NoStraightLineError(f"a number as {dtype}")
    return _each(r, _real, x) if dtype.is_floating_point else r.mirror(x)


def _diag_embed(m: Mirror) -> Mirror:
    out = np.full((*m.shape, m.shape[-1]), 0.0, dtype=object)
    _diagonal(out, 0, -2, -1)[...] = m
    return out


def _diagonal(m: Mirror, offset: int = 0, dim1: int = 0, dim2: int = 1) -> Mirror:
    out = np.diagonal(m, offset, dim1, dim2)
    out.flags.writeable = True
    return out


def _split(m: Mirror, size: int | Sequence[int], dim: int = 0) -> list[Mirror]:
    sizes = size if isinstance(size, list | tuple) else [size] * -(-m.shape[dim] // size)
    ends = np.cumsum(sizes)
    return [_slice(m, dim, int(e - s), int(e)) for s, e in zip(sizes, ends, strict=True)]


def _unbind(m: Mirror, dim: int = 0) -> list[Mirror]:
    return [_select(m, dim, k) for k in range(m.shape[dim])]


_NAMED = (*_FUNCTIONS, "asin", "atan", "atan2", "sign", "abs", "maximum", "minimum")
_ELEMENTWISE: dict[str, Callable[..., Expression]] = {
    "add": _add, "sub": _subtract, "rsub": lambda r, a, b: _subtract(r, b, a), "neg": _negative,
    "mul": _multiply, "div": _divide, "pow": _power, "where": _where, "bitwise_and": _both,
    "logical_and": _both, "bitwise_or": _either, "logical_or": _either,
    "reciprocal": lambda r, a: _divide(r, 1.0, a), "square": lambda r, a: _multiply(r, a, a),
    "logical_not": _plain("negate"), "bitwise_not": _plain("negate"), "sgn": _plain("sign"),
    "remainder": _plain("mod", "({} % {})"),
    **{name: _plain(name) for name in _NAMED},
    **{name: _plain(name, f"({{}} {sign} {{}})") for name, sign in _COMPARISONS.items()},
}  # fmt: skip
_FACTORIES = frozenset(
    f"{kind}{of}" for kind in ("zeros", "ones", "full", "empty") for of in ("_like", "", "_strided")
) | {"new_zeros", "new_ones", "new_full", "new_empty"}  # fmt: skip
_HANDLERS: dict[str, Callable[..., Any]] = {
    **{name: _elementwise(operation) for name, operation in _ELEMENTWISE.items()},
    **{f"{name}_": _in_place(operation) for name, operation in _ELEMENTWISE.items()},
    "bmm": _product, "mm": _product, "mv": _product, "dot": _product,
    "sum": _sum, "amax": _reduced(_plain("maximum")), "amin": _reduced(_plain("minimum")),
    "any": _reduced(_either, False), "all": _reduced(_both, True),
    "linalg_vector_norm": _norm, "linalg_cross": _cross,
    "clamp": _clamp, "clamp_min": _clamp, "clamp_max": lambda r, x, high: _clamp(r, x, None, high),
    "addcmul": _fused, "copy_": _copied,
    "_to_copy": _cast, "cat": _joined(np.concatenate), "stack": _joined(np.stack),
    "view": _as_is(np.reshape), "_unsafe_view": _as_is(np.reshape), "reshape": _as_is(np.reshape),
    "_reshape_alias": _as_is(lambda m, size, _: m.reshape(size)),
    "expand": _as_is(_expand), "slice": _as_is(_slice), "select": _as_is(_select),
    "unsqueeze": _as_is(np.expand_dims), "squeeze": _as_is(_squeeze),
    "transpose": _as_is(np.swapaxes), "t": _as_is(np.transpose), "permute": _as_is(np.transpose),
    "flip": _as_is(np.flip), "clone": _as_is(lambda m, **_: m.copy()),
    "detach": _as_is(lambda m: m), "alias": _as_is(lambda m: m),
    "diag_embed": _as_is(_diag_embed), "diagonal": _as_is(_diagonal),
    "split": _as_is(_split), "split_with_sizes": _as_is(_split), "unbind": _as_is(_unbind),
    "fill_": _copied, "zero_": lambda r, x: _copied(r, x, 0.0),
}  # fmt: skip
