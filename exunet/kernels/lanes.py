"""Vectors of runs as a type of compiled code: the text of a step then advances WIDTH runs at once.

A `Lanes` is one number in each of WIDTH runs. `lanes_of` makes arrays of them, which are arrays as any other.
`Lanes` take part in arithmetic with each other and with numbers. The operations are those of IEEE 754, lane
by lane and without contraction: each run has the bits that it has alone.

A condition on `Lanes` is true where it holds in any of the runs. What stands under it must be right for the
runs in which it does not hold, as in `if s > 0.0: s = max(s, 0.0)`; see `KernelCall.of_many`.

Importing this module imports Numba, so only compiled code and what makes it may do so.
"""

# mypy: allow-untyped-defs, allow-untyped-decorators, allow-subclassing-any, allow-untyped-calls
# (Numba demands the overloads' signatures without annotations.)

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.typeconv import Conversion
from numba.extending import intrinsic as _typed_intrinsic
from numba.extending import lower_cast, models, overload, register_model
from numba.np.arrayobj import make_array

from exunet.kernels.compile import WIDTH
from exunet.kernels.pointers import Borrowed

intrinsic: Any = _typed_intrinsic  # its stub does not know that the compiler passes the first argument

_INT = ir.IntType(32)
_VECTOR = ir.VectorType(ir.DoubleType(), WIDTH)
_BITS = ir.VectorType(ir.IntType(1), WIDTH)


class Lanes(types.Type):
    """One number in each run."""

    def __init__(self) -> None:
        super().__init__("Lanes")

    def unify(self, typingctx: Any, other: types.Type) -> types.Type | None:
        """A number becomes the same in all runs."""
        return self if isinstance(other, types.Float | types.Integer) else None

    def can_convert_from(self, typingctx: Any, other: types.Type) -> Conversion | None:
        return Conversion.safe if isinstance(other, types.Float | types.Integer) else None


class Holds(types.Type):
    """True or false in each run."""

    def __init__(self) -> None:
        super().__init__("Holds")


LANES, _HOLDS = Lanes(), Holds()


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Lanes) -> None:
        super().__init__(manager, kind, _VECTOR)


@register_model(Holds)
class _HoldsModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Holds) -> None:
        super().__init__(manager, kind, _BITS)


def _vector(context: Any, builder: Any, kind: types.Type, value: Any) -> Any:
    """A number in all runs."""
    if isinstance(kind, Lanes):
        return value
    number = context.cast(builder, value, kind, types.float64)
    first = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), number, ir.Constant(_INT, 0))
    nowhere = ir.Constant(_VECTOR, ir.Undefined)
    return builder.shuffle_vector(first, nowhere, ir.Constant(ir.VectorType(_INT, WIDTH), [0] * WIDTH))


@lower_cast(types.Float, Lanes)
@lower_cast(types.Integer, Lanes)
def _number_to_lanes(context: Any, builder: Any, fromty: Any, toty: Any, value: Any) -> Any:
    return _vector(context, builder, fromty, value)


def _has_lanes(*kinds: types.Type) -> bool:
    return any(isinstance(kind, Lanes) for kind in kinds) and all(
        isinstance(kind, Lanes | types.Float | types.Integer) for kind in kinds
    )


def _define(operators: tuple[Any, ...], result: types.Type, build: Callable[[Any, Any, Any], Any]) -> None:
    """Operators of two values of which at least one is `Lanes`."""

    @intrinsic
    def operation(typingctx: Any, a: Any, b: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            pair = zip(signature.args, args, strict=True)
            x, y = (_vector(context, builder, kind, value) for kind, value in pair)
            return build(builder, x, y)

        return result(a, b), generate

    for item in operators:

        @overload(item)
        def choose(a, b):
            return (lambda a, b: operation(a, b)) if _has_lanes(a, b) else None


_define((operator.add, operator.iadd), LANES, lambda b, x, y: b.fadd(x, y))
_define((operator.sub, operator.isub), LANES, lambda b, x, y: b.fsub(x, y))
_define((operator.mul, operator.imul), LANES, lambda b, x, y: b.fmul(x, y))
_define((operator.truediv, operator.itruediv), LANES, lambda b, x, y: b.fdiv(x, y))
_define((max,), LANES, lambda b, x, y: b.select(b.fcmp_ordered(">", y, x), y, x))
_define((min,), LANES, lambda b, x, y: b.select(b.fcmp_ordered("<", y, x), y, x))
_define((operator.gt,), _HOLDS, lambda b, x, y: b.fcmp_ordered(">", x, y))
_define((operator.ge,), _HOLDS, lambda b, x, y: b.fcmp_ordered(">=", x, y))
_define((operator.lt,), _HOLDS, lambda b, x, y: b.fcmp_ordered("<", x, y))


def _of_one(llvm: str) -> Any:
    @intrinsic
    def operation(typingctx: Any, a: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            kind = ir.FunctionType(_VECTOR, [_VECTOR])
            name = f"llvm.{llvm}.v{WIDTH}f64"
            return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), args)

        return LANES(a), generate

    return operation


_root, _absolute = _of_one("sqrt"), _of_one("fabs")


@intrinsic
def _negative(typingctx: Any, a: Any) -> Any:
    return LANES(a), lambda context, builder, signature, args: builder.fneg(args[0])


@overload(math.sqrt)
def _choose_root(a):
    return (lambda a: _root(a)) if isinstance(a, Lanes) else None


@overload(abs)
def _choose_absolute(a):
    return (lambda a: _absolute(a)) if isinstance(a, Lanes) else None


@overload(operator.neg)
def _choose_negative(a):
    return (lambda a: _negative(a)) if isinstance(a, Lanes) else None


@intrinsic
def _any(typingctx: Any, holds: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        together = builder.bitcast(args[0], ir.IntType(WIDTH))
        return builder.icmp_unsigned("!=", together, ir.Constant(ir.IntType(WIDTH), 0))

    return types.boolean(holds), generate


@overload(bool)
def _choose_any(holds):
    return (lambda holds: _any(holds)) if isinstance(holds, Holds) else None


@intrinsic
def lanes_of(typingctx: Any, array: Any) -> Any:
    """A C array (..., n, WIDTH) of floats as a `Borrowed` (..., n) of `Lanes`; in compiled code."""
    kind = Borrowed(LANES, array.ndim - 1, "C")

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        held, view = make_array(array)(context, builder, args[0]), make_array(kind)(context, builder)
        shape, strides = (cgutils.unpack_tuple(builder, part) for part in (held.shape, held.strides))
        each = ir.Constant(context.get_value_type(types.intp), WIDTH)
        view.data = builder.bitcast(held.data, view.data.type)
        view.shape = cgutils.pack_array(builder, shape[:-1])
        view.strides = cgutils.pack_array(builder, strides[:-1])
        view.itemsize = builder.mul(held.itemsize, each)
        view.nitems = builder.sdiv(held.nitems, each)
        view.meminfo, view.parent = held.meminfo, held.parent
        return view._getvalue()

    return kind(array), generate
